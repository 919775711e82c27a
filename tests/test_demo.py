"""The demonstration on a small receiver: it finds the light, relights another pose, and writes what it names."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from torch.testing import assert_close
from workbench import SUN, degrees_between

from torchlight import demo
from torchlight.errors import FormatError, SceneError
from torchlight.io.lights import read_light
from torchlight.light.environment import EnvironmentMap
from torchlight.light.peaks import environment_peaks, peak_direction
from torchlight.light.procedural import sun_and_window


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, demo.Outcome, list[tuple[int, int]]]:
    folder = tmp_path_factory.mktemp("demo") / "new" / "out"
    calls: list[tuple[int, int]] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TORCHLIGHT_CACHE", str(folder / "cache"))
        patch.setattr(demo, "RECEIVER", replace(demo.RECEIVER, samples=(20, 20)))
        outcome = demo.run_demo(folder, sun_and_window(64), lambda done, total: calls.append((done, total)))
    return folder, outcome, calls


def test_the_light_explains_the_photograph_and_relights_another_pose(
    ran: tuple[Path, demo.Outcome, list[tuple[int, int]]],
) -> None:
    folder, outcome, calls = ran
    assert 0 < outcome.fit_rms_255 < 2  # 1.0 at 20 x 20 samples: the sun is narrower than a texel
    assert 0 < outcome.relit_rms_255 < 8
    assert outcome.seconds > 0
    assert calls[-1][0] == calls[-1][1]
    found = read_light(folder / "light.exr")
    assert degrees_between(peak_direction(environment_peaks(found)), SUN) < 3


def test_every_file_it_names_is_there_and_no_other(ran: tuple[Path, demo.Outcome, list[tuple[int, int]]]) -> None:
    folder, outcome, _ = ran
    assert sorted(path.name for path in outcome.files) == sorted(path.name for path in folder.iterdir())
    for path in outcome.files:
        if path.suffix == ".png":
            picture = cv2.imread(str(path))
            assert picture is not None
            assert picture.std() > 5
    photo = cv2.imread(str(folder / "photo.png"))
    assert photo is not None
    assert photo.shape == (20, 20, 3)
    assert 245 <= np.sort(photo.reshape(-1))[-30] <= 250  # exposed just below saturation


def test_black_ground() -> None:
    radiance = demo.above_horizon(torch.ones(3, 6, 12))
    assert_close(radiance.sum(dim=(0, 2)), torch.tensor([36.0, 36, 36, 0, 0, 0]))


def test_bad_places_and_lights_are_refused_before_the_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*arguments: object) -> None:
        raise AssertionError

    monkeypatch.setattr(demo, "columns_for", never)
    (tmp_path / "file").write_text("")
    with pytest.raises(FormatError, match="file"):
        demo.run_demo(tmp_path / "file", sun_and_window(8))
    with pytest.raises(SceneError, match="black"):
        demo.run_demo(tmp_path / "out", EnvironmentMap(torch.zeros(3, 8, 16)))


def test_the_two_poses_differ() -> None:
    assert demo.FIRST_POSE.rotation_degrees != demo.SECOND_POSE.rotation_degrees
    assert demo.FIRST_POSE.size == demo.SECOND_POSE.size
