"""Sweep files: read strictly; every error names file and key in one line."""

from __future__ import annotations

from pathlib import Path

import pytest
from sweep_case import DATA, GRID, write_sweep

from torchlight.errors import ConfigError
from torchlight.io.sweep_data import SUN_AND_WINDOW, Synthetic, identity
from torchlight.io.sweep_file import Choices, Interval, read_sweep

READY = sorted((Path(__file__).parent.parent / "configs" / "sweeps").glob("*.yaml"))


def test_there_are_ready_sweeps() -> None:
    assert {path.stem for path in READY} == {"methods", "threshold", "receiver"}


@pytest.mark.parametrize("path", READY, ids=lambda path: path.stem)
def test_ready_sweeps_can_be_read(path: Path, tmp_path: Path) -> None:
    (tmp_path / "probes").mkdir()
    for name in ("adams_place_bridge_1k.hdr", "aerodynamics_workshop_1k.hdr"):
        (tmp_path / "probes" / name).write_text(name)
    sweep = read_sweep(path, tmp_path)
    assert isinstance(sweep.data, Synthetic)
    assert len(sweep.data.held_out) == 2


def test_a_file_says_what_is_tried(tmp_path: Path) -> None:
    text = "seed: 7\nsearch: {kind: random, trials: 5}\n"
    text += "axes: {light.method: [texels, sh], adaptive.functions: {low: 20, high: 450, log: true}}\n" + DATA
    sweep = read_sweep(write_sweep(tmp_path, text))
    assert sweep.axes == {"light.method": Choices(("texels", "sh")), "adaptive.functions": Interval(20, 450, True)}
    assert isinstance(sweep.data, Synthetic)
    assert sweep.data.seed == sweep.seed == 7
    config, data = sweep.at({"light.method": "sh", "data.noise": 0.25, "data.samples": 12})
    assert config.light.method == "sh"
    assert isinstance(data, Synthetic)
    assert (data.noise, data.samples) == (0.25, 12)


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ("axes:", "axis:", "axis: unknown key; did you mean 'axes'?"),
        ("light.resolution: [2, 4]", "light.resolutoin: [2]", "did you mean 'light.resolution'?"),
        ("[2, 4]", "[2, fine]", "light.resolution: expected an integer, got 'fine'"),
        ("[2, 4]", "{low: 2, high: 4}", "a grid takes listed values"),
        ("[2, 4]", "[2, 2]", "lists a value twice"),
        ("[2, 4]", "[]", "expected a list of values"),
        ("[0.0, 0.01, 0.02]", "[0.0, 1.5]", "expected a share of the brightest sample in [0, 1), got 1.5"),
        ("kind: grid", "kind: net", "search.kind: expected grid or random or optuna"),
        ("kind: grid", "kind: grid, trials: 4", "search.trials: unknown key; known keys: kind"),
        ("kind: grid", "kind: random", "search.trials: missing; for example 'trials: 40'"),
        ("kind: grid", "kind: optuna, trials: 4, minimize: rms", "search.minimize: expected held_out_rms_255 or"),
        ("sky.exr", "nothing.exr", "no file matches 'nothing.exr'"),
        ("[sky.exr]", "[]", "expected at least one light"),
        ("rotation_degrees: 69, translation: [0.3, 0.2]", "rotation_degrees: 20", "holds the pose that is photograph"),
        ("samples: 8", "samples: 1", "expected 2 to 1024 samples along a side, got 1"),
        ("  synthetic:", "  synthetics:", "did you mean 'synthetic'?"),
    ],
)
def test_what_is_wrong_is_one_line_with_file_and_key(tmp_path: Path, before: str, after: str, said: str) -> None:
    assert GRID.count(before) == 1
    path = write_sweep(tmp_path, GRID.replace(before, after))
    with pytest.raises(ConfigError) as caught:
        read_sweep(path)
    assert said in str(caught.value)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_photographs_have_no_noise_to_sweep(tmp_path: Path) -> None:
    (tmp_path / "scene.yaml").write_text("a scene")
    (tmp_path / "a.png").write_text("a photograph")
    text = GRID.partition("data:\n")[0] + "data: {photographs: {scene: scene.yaml, photos: ['*.png']}}\n"
    with pytest.raises(ConfigError, match=r"data\.noise: photographs are as they are"):
        read_sweep(write_sweep(tmp_path, text))


def test_data_are_the_same_wherever_their_files_lie(tmp_path: Path) -> None:
    one, other = (read_sweep(write_sweep(tmp_path / name)).data for name in ("one", "other"))
    assert one != other
    assert identity(one) == identity(other)


def test_the_built_in_sky_needs_no_file(tmp_path: Path) -> None:
    data = read_sweep(write_sweep(tmp_path, GRID.replace("sky.exr", SUN_AND_WINDOW))).data
    assert isinstance(data, Synthetic)
    assert data.lights[0].path is None
