"""`torchlight estimate` says in one line when it is asked for more than the scene can determine, and goes on."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from torchlight.cli import main
from torchlight.io import cache
from torchlight.io.exr import write_exr

SCENE = """
occluders: [{box: [1, 0.6, 1.2], rotation_degrees: [0, 0, 20]}]
receiver: {size: [4, 4], samples: [16, 16]}
"""


@pytest.mark.parametrize(
    ("options", "warning"),
    [
        (
            ["--method", "sh", "--degree", "6", "--solver", "ridge", "--resolution", "8"],
            "degree 6 asks for bandwidth 7",
        ),
        (["--method", "sh", "--degree", "0", "--solver", "ridge", "--resolution", "8"], None),
        (["--method", "texels", "--resolution", "16"], "768 coefficients from "),
        (["--method", "texels", "--resolution", "8", "--solver", "ridge"], "192 coefficients, but about "),
        (["--method", "texels", "--resolution", "4"], None),
        (["--resolution", "16"], None),  # the adaptive method takes no more than the shadows determine,
    ],
)
def test_the_warning(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    options: list[str],
    warning: str | None,
) -> None:
    monkeypatch.setenv(cache.FOLDER_VARIABLE, str(tmp_path / "cache"))
    monkeypatch.setattr("torchlight.precomputation.DIRECTIONS_PER_EDGE", 32)
    (tmp_path / "scene.yaml").write_text(SCENE)
    write_exr(tmp_path / "photo.exr", torch.rand(3, 16, 16, generator=torch.Generator().manual_seed(0)) + 0.5, {})
    arguments = ["estimate", str(tmp_path / "scene.yaml"), str(tmp_path / "photo.exr"), "--out", str(tmp_path / "out")]
    with pytest.raises(SystemExit) as left:
        main([*arguments, "--device", "cpu", *options])
    assert left.value.code == 0
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == (0 if warning is None else 1)
    assert all(line.startswith(f"torchlight: warning: {warning}") for line in lines)
    assert (tmp_path / "out" / "photo" / "light.exr").is_file()
