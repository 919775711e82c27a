"""Photographs in a program of one's own: as an iterator and as a dataset."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest
import torch
from batch_case import QUICK, write_photos, write_scene
from torch.utils.data import DataLoader

import torchlight as tl
from torchlight.batch.dataset import Observations
from torchlight.batch.iterate import estimate
from torchlight.errors import SceneError


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scene(tmp_path_factory.mktemp("iterate") / "scene.yaml")


@pytest.fixture(scope="module")
def photos(scene: Path) -> list[Path]:
    files = write_photos(scene.parent / "photos", scene, 11)
    files[4].write_bytes(b"not a photograph")
    return files


def test_photographs_come_in_order_and_a_bad_one_is_data(scene: Path, photos: list[Path]) -> None:
    found = list(estimate(photos, scene, QUICK))
    assert [one.photo for one in found] == photos
    assert [one.estimate is None for one in found] == [index == 4 for index in range(11)]
    assert "p004.png" in found[4].reason
    alone = tl.estimate(
        tl.linearize(tl.read_photo(photos[9]), tl.load_scene(scene)), tl.load_scene(scene), tl.Texels(2)
    )
    assert found[9].estimate is not None
    assert torch.equal(found[9].estimate.light.radiance, alone.light.radiance)


def test_photographs_may_be_endless(scene: Path, photos: list[Path]) -> None:
    endless = estimate(itertools.cycle(photos), scene, QUICK)
    assert [one.photo for one in itertools.islice(endless, 30)] == [photos[index % 11] for index in range(30)]


def test_a_wrong_scene_is_an_exception(tmp_path: Path, photos: list[Path]) -> None:
    (tmp_path / "s.yaml").write_text("occluders: []\nreceiver: {size: [1, 1], samples: [8, 8]}")
    with pytest.raises(SceneError):
        next(estimate(photos, tmp_path / "s.yaml", QUICK))


def test_spawned_workers_show_what_this_process_does(scene: Path, photos: list[Path]) -> None:
    dataset = Observations(photos, scene)
    loader = DataLoader(dataset, batch_size=4, num_workers=1, multiprocessing_context="spawn")
    batches = list(loader)
    samples = torch.cat([batch["samples"] for batch in batches])
    weights = torch.cat([batch["weights"] for batch in batches])
    assert torch.equal(torch.cat([batch["index"] for batch in batches]), torch.arange(11))
    for index in (0, 10):
        shown = tl.observe(tl.linearize(tl.read_photo(photos[index]), tl.load_scene(scene)), tl.load_scene(scene))
        assert torch.equal(samples[index], shown.samples)
        assert torch.equal(weights[index], shown.weights)
    assert float(weights[4].abs().sum()) == 0.0
    assert "p004.png" in [reason for batch in batches for reason in batch["reason"]][4]
