"""A Ray cluster of two workers: results as on this machine, also when a worker dies."""

from __future__ import annotations

import functools
import os
import signal
from pathlib import Path

import pytest
from batch_case import QUICK_UNCACHED, fingerprints, write_photos, write_scene

from torchlight.batch import cluster
from torchlight.batch.run import Batch, in_this_process, run_batch
from torchlight.batch.work import Report, work
from torchlight.errors import ConfigError
from torchlight.io.manifest import Entry, read_entries

pytestmark = pytest.mark.filterwarnings("default")


@pytest.fixture(scope="module")
def asked(tmp_path_factory: pytest.TempPathFactory) -> tuple[Entry, ...]:
    folder = tmp_path_factory.mktemp("cluster")
    scene = write_scene(folder / "scene.yaml")
    write_photos(folder / "photos", scene, 20)
    (folder / "photos/p005.png").write_bytes(b"not a photograph")
    return tuple(read_entries([str(folder / "photos" / "*.png")], scene))


def run(batch: Batch, engine) -> dict[str, str]:
    return {step.record.name: step.record.state for step in run_batch(batch, engine)}


def test_ray_ends_like_this_process(asked: tuple[Entry, ...], tmp_path: Path) -> None:
    pytest.importorskip("ray", reason="Ray is not installed (extra cluster)")
    expected = run(Batch(asked, tmp_path / "here", QUICK_UNCACHED), in_this_process)
    found = run(Batch(asked, tmp_path / "ray", QUICK_UNCACHED), functools.partial(cluster.on_ray, workers=2))
    assert found == expected
    assert fingerprints(tmp_path / "ray") == fingerprints(tmp_path / "here")


def test_a_worker_that_is_killed_costs_nothing(
    asked: tuple[Entry, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("ray", reason="Ray is not installed (extra cluster)")
    flag = tmp_path / "killed"

    def block_of(task, block, dense) -> Report:
        if not flag.exists():
            flag.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return work(task, block)

    run(Batch(asked, tmp_path / "here", QUICK_UNCACHED), in_this_process)
    monkeypatch.setattr(cluster, "block_of", block_of)
    run(Batch(asked, tmp_path / "ray", QUICK_UNCACHED), functools.partial(cluster.on_ray, workers=2))
    assert flag.exists()
    assert fingerprints(tmp_path / "ray") == fingerprints(tmp_path / "here")


def test_without_ray_one_line_says_so(
    asked: tuple[Entry, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "ray", None)
    with pytest.raises(ConfigError, match="Ray is not installed; pip install"):
        run(Batch(asked, tmp_path / "ray", QUICK_UNCACHED), cluster.on_ray)
