"""What result.json and its neighbours hold, from estimates made by hand."""

from __future__ import annotations

import json
import math
import platform
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file
from torch.testing import assert_close

from torchlight.camera import Camera, Sighting
from torchlight.errors import FormatError
from torchlight.geometry.primitives import box
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene
from torchlight.light.bases import Texels
from torchlight.light.environment import EnvironmentMap
from torchlight.light.peaks import Peaks
from torchlight.photo.observation import Observation, Rejection
from torchlight.pipeline import Estimate
from torchlight.results import Provenance, found_peaks, light_is, number, select, summary, versions, write_result
from torchlight.solvers import Solution, Status

SCENE = Scene(box((1.0, 1.0, 1.0)), Receiver((0.0, 0.0), (4.0, 2.0), (2, 2)), units="cm", reference="smooth")
PROVENANCE = Provenance("5" * 64, "7" * 64, "shed/photo.png", "texels", "nnls", {"scene": 0.25, "solve": 1.5})


def by_hand(batch: tuple[int, ...] = ()) -> Estimate:
    """Two of four samples used, residuals 0.1 and 0.2 on every channel, brightest used sample 0.5."""
    observed = torch.tensor([0.5, 0.25, 9.0, 9.0]).expand(*batch, 3, 4)
    predicted = torch.tensor([0.6, 0.45, 0.0, 0.0]).expand(*batch, 3, 4)
    weights = torch.tensor([1.0, 1.0, 0.0, 0.0]).expand(*batch, 4)
    coefficients = torch.tensor([[1.0, 1e-12, 0.0, 0.0, 2.0], [0.0] * 5, [3.0, 2.0, 1.0, 0.0, 0.0]]).expand(
        *batch, 3, 5
    )
    figures = torch.tensor([1e-12, math.nan, math.inf]).expand(*batch, 3)
    status = torch.tensor([Status.CONVERGED, Status.STOPPED_SHORT, Status.CONVERGED]).expand(*batch, 3)
    solution = Solution(coefficients, status, status + 4, figures, figures, figures)
    directions = torch.tensor([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.0, 0.6, 0.8], [math.nan] * 3]).expand(*batch, 4, 3)
    peaks = Peaks(directions, torch.tensor([0.25, 0.1, 0.5, 0.0]).expand(*batch, 4))
    light = EnvironmentMap(torch.linspace(0, 1, 3 * 8 * 16).reshape(3, 8, 16).expand(*batch, 3, 8, 16))
    return Estimate(light, solution, Texels(1), Observation(observed, weights), predicted, peaks)


def test_figures_by_hand() -> None:
    found = summary(by_hand(), SCENE, PROVENANCE)
    rms = math.sqrt((0.1**2 + 0.2**2) / 2)
    assert_close(found["rms_255"], 255 * rms / 0.5, rtol=1e-5, atol=0)
    assert_close(found["rms_relative"], rms / math.sqrt((0.5**2 + 0.25**2) / 2), rtol=1e-5, atol=0)
    expected = {
        "photo": "shed/photo.png",
        "visible": 2,
        "points": 4,
        "visible_share": 0.5,
        "method": "texels",
        "resolution": 1,
        "solver": "nnls",
        "coefficients": 5,
        "nonzero": [2, 0, 3],
        "nonnegative": True,
        "status": ["converged", "stopped_short", "converged"],
        "steps": [4, 5, 4],
        "reference": "smooth",
        "units": "relative",
        "length_unit": "cm",
        "photo_sha256": "7" * 64,
        "scene_sha256": "5" * 64,
    }
    assert {key: found[key] for key in expected} == expected


def test_what_was_left_out_is_counted_by_its_reason() -> None:
    seen = by_hand((2,))
    why = [[Rejection.NONE, Rejection.SPECULAR, Rejection.ROBUST, Rejection.ROBUST], [Rejection.SATURATED] * 4]
    both = replace(seen, observation=replace(seen.observation, rejected=torch.tensor(why, dtype=torch.uint8)))
    found = [summary(select(both, item), SCENE, PROVENANCE)["rejected"] for item in (0, 1)]
    assert found == [{"saturated": 0, "specular": 1, "robust": 2}, {"saturated": 4, "specular": 0, "robust": 0}]
    unknown = summary(by_hand(), SCENE, PROVENANCE)
    assert unknown["rejected"] == {"saturated": 0, "specular": 0, "robust": 0}
    assert unknown["saturated_samples"] == "dropped"


def test_a_pose_from_a_board_is_recorded_and_another_is_not() -> None:
    pose = torch.eye(4, dtype=torch.float64)
    camera = Camera(torch.eye(3, dtype=torch.float64), pose, (4, 3), torch.zeros(5, dtype=torch.float64))
    sighting = Sighting(0.07, 56, 14, 0.02, 0.01, "a" * 64, "b" * 64)
    found = [
        summary(by_hand(), SCENE, replace(PROVENANCE, camera=given))["camera"]
        for given in (None, camera, replace(camera, sighting=sighting))
    ]
    assert found == [None, None, {"world_to_camera": pose.tolist(), **vars(sighting)}]


def test_what_json_cannot_hold_is_null() -> None:
    found = summary(by_hand(), SCENE, PROVENANCE)
    assert found["kkt_residual"] == found["gap"] == [pytest.approx(1e-12), None, None]
    json.dumps(found, allow_nan=False)
    assert [number(torch.tensor(value)) for value in (1.5, math.nan, -math.inf)] == [1.5, None, None]


def test_the_first_peak_is_the_direction_and_the_others_go_by_share() -> None:
    found = summary(by_hand(), SCENE, PROVENANCE)
    assert found["peak_direction"] == [0.0, 0.0, 1.0]
    assert found["peak_share"] == 0.25
    assert [peak["share"] for peak in found["peaks"]] == pytest.approx([0.5, 0.1])
    assert found["peaks"][0]["direction"] == pytest.approx([0.0, 0.6, 0.8])


def test_black_light_has_no_peak() -> None:
    nothing = Peaks(torch.full((2, 3), math.nan), torch.zeros(2))
    assert found_peaks(nothing) == []
    found = summary(replace(by_hand(), peaks=nothing), SCENE, PROVENANCE)
    assert (found["peak_direction"], found["peak_share"], found["peaks"]) == (None, None, [])


def test_one_photograph_of_a_batch() -> None:
    batch = by_hand((2,))
    radiance = batch.light.radiance.clone()
    radiance[1, 0, 0, 0] = -0.5
    light = EnvironmentMap(radiance, nonnegative=False)
    first, second = (select(replace(batch, light=light), item) for item in (0, 1))
    alone = by_hand()
    assert first.light.nonnegative
    assert not second.light.nonnegative
    for field in ("coefficients", "status", "steps", "kkt_residual", "gap", "relative_residual"):
        assert_close(getattr(first.solution, field), getattr(alone.solution, field), rtol=0, atol=0, equal_nan=True)
    assert_close(first.predicted, alone.predicted, rtol=0, atol=0)
    assert_close(first.observation.weights, alone.observation.weights, rtol=0, atol=0)
    assert_close(first.peaks.directions, alone.peaks.directions, rtol=0, atol=0, equal_nan=True)
    assert summary(first, SCENE, PROVENANCE) == summary(alone, SCENE, PROVENANCE)


def test_what_is_written_is_what_is_returned(tmp_path: Path) -> None:
    estimate = by_hand()
    result = write_result(tmp_path / "photo", estimate, SCENE, PROVENANCE)
    assert json.loads((tmp_path / "photo/result.json").read_text()) == result
    assert json.loads((tmp_path / "photo/timing.json").read_text()) == {"seconds": {"scene": 0.25, "solve": 1.5}}
    tensors = load_file(tmp_path / "photo/estimate.safetensors")
    assert set(tensors) == {"coefficients", "status", "samples", "weights", "predicted"}
    assert torch.equal(tensors["coefficients"], estimate.solution.coefficients)
    assert torch.equal(tensors["status"], estimate.solution.status)
    assert torch.equal(tensors["predicted"], estimate.predicted)
    assert torch.equal(tensors["samples"], estimate.observation.samples)


def test_results_are_replaced_only_when_asked(tmp_path: Path) -> None:
    write_result(tmp_path / "photo", by_hand(), SCENE, PROVENANCE)
    with pytest.raises(FormatError, match="already exists"):
        write_result(tmp_path / "photo", by_hand(), SCENE, PROVENANCE)
    other = replace(PROVENANCE, method="haar")
    assert write_result(tmp_path / "photo", by_hand(), SCENE, other, overwrite=True)["method"] == "haar"
    assert json.loads((tmp_path / "photo/result.json").read_text())["method"] == "haar"
    assert [path.name for path in tmp_path.iterdir()] == ["photo"]


def test_what_the_light_is_relative_to() -> None:
    assert light_is(SCENE) == "radiance x albedo x exposure"
    known = replace(SCENE, receiver=replace(SCENE.receiver, albedo=(0.5, 0.5, 0.5)))
    assert light_is(known) == "radiance x exposure"


def test_versions(monkeypatch: pytest.MonkeyPatch) -> None:
    assert versions()["python"] == platform.python_version()
    assert versions()["torch"] == version("torch")
    monkeypatch.setattr("torchlight.results.LIBRARIES", ("torch", "no-such-distribution"))
    assert versions()["no-such-distribution"] == "absent"
