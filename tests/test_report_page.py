"""report.html of one photograph: all it says is in it, escaped, and the light in it is the light."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from pages import check_self_contained, read
from PIL import Image
from shadows import BLOCK, RECEIVER, block_transfer, patchy
from torch.testing import assert_close

from torchlight.inversion.adaptive import AdaptiveHaar
from torchlight.light.bases import Texels
from torchlight.light.environment import EnvironmentMap
from torchlight.photo.observation import Rejection
from torchlight.pipeline import Estimate, estimate, with_confidence
from torchlight.report import jpegs, panels
from torchlight.report.colours import coloured
from torchlight.report.page import photo_files
from torchlight.report.solving import angles
from torchlight.results import Provenance, select, write_result
from torchlight.synthetic import block_scene
from torchlight.transfer import Transfer

SCENE = block_scene(BLOCK, RECEIVER)
NASTY = "<script>alert('&\"x')</script>.png"
PROVENANCE = Provenance("5" * 64, "7" * 64, f"shed/{NASTY}", "adaptive", "nnls", {"solve": 1.5}, warnings=("<b>hot",))


@pytest.fixture(scope="module")
def found() -> Estimate:
    transfer = Transfer(block_transfer(8).transport.float(), 8)
    photo = (patchy(8, 2, 3) @ block_transfer(8).transport.T / torch.pi).reshape(3, 20, 20).flip(1).float()
    solved = select(estimate(photo[None], SCENE, None, AdaptiveHaar(8, 40), transfer), 0)
    return with_confidence(solved, SCENE, transfer)


@pytest.fixture(scope="module")
def photo() -> bytes:
    pixels = torch.rand(3, 30, 40, generator=torch.Generator().manual_seed(0))
    return jpegs.photograph(pixels, linear=False)


def written(folder: Path, found: Estimate, photo: bytes, provenance: Provenance = PROVENANCE) -> bytes:
    def pages(given: Estimate, result: Mapping[str, Any], scale: float) -> dict[str, bytes]:
        return photo_files(photo, RECEIVER, given, result, scale)

    write_result(folder, found, SCENE, provenance, pictures={}, pages=pages)
    return (folder / "report.html").read_bytes()


def test_the_page_needs_nothing_but_itself_and_says_what_it_should(
    tmp_path: Path, found: Estimate, photo: bytes
) -> None:
    content = written(tmp_path / "a", found, photo)
    page = read(content)
    check_self_contained(page)
    headings = {
        "What was seen",
        "The light",
        "How far it can be trusted",
        "How fine it is",
        "Numbers",
        "Where it comes",
    }
    assert all(heading in page.text for heading in headings)
    assert "<b>hot" in page.text
    assert NASTY in page.text
    assert b"<script>alert" not in content
    assert "7" * 64 in page.text
    assert len(page.every("canvas")) == 2
    assert all(canvas["aria-label"] for canvas in page.every("canvas"))
    assert len(content) < 400_000
    assert "1.5" not in re.sub(r"[\d.]+ stops", "", page.text.split("Numbers")[0][:200])  # seconds are not in it


def test_the_same_result_gives_the_same_bytes(tmp_path: Path, found: Estimate, photo: bytes) -> None:
    other = replace(PROVENANCE, seconds={"solve": 99.0})
    assert written(tmp_path / "a", found, photo) == written(tmp_path / "b", found, photo, other)
    thumbnails = [(tmp_path / name / "thumbnail.jpg").read_bytes() for name in "ab"]
    assert thumbnails[0] == thumbnails[1]
    assert jpegs.unpacked(thumbnails[0]).shape == (52, 180, 3)


def test_pages_without_confidence_or_refinement_say_so(tmp_path: Path, found: Estimate, photo: bytes) -> None:
    plain = replace(found, confidence=None, refinement=None, basis=Texels(8))
    page = read(written(tmp_path / "a", plain, photo))
    check_self_contained(page)
    assert "Not asked (--skip-confidence)" in page.text
    assert "How fine it is" not in page.text
    assert "data-threshold" not in page.every("canvas")[0]


def test_what_was_left_out_is_in_the_legend(tmp_path: Path, found: Estimate, photo: bytes) -> None:
    rejected = torch.zeros(RECEIVER.points, dtype=torch.uint8)
    rejected[:7] = int(Rejection.SPECULAR)
    seen = replace(found.observation, rejected=rejected)
    page = read(written(tmp_path / "a", replace(found, observation=seen), photo))
    assert "glint: 7 samples" in page.text
    observed, _, residual, _ = panels.receiver_pictures(seen, found.predicted, RECEIVER)
    assert observed[-1, 0].tolist() == residual[-1, 0].tolist() == [240, 228, 66]  # row 0 is the largest y


def decoded(content: bytes) -> np.ndarray:
    (source,) = re.findall(rb'data-light="data:image/png;base64,([^"]+)"', content)
    return np.asarray(Image.open(BytesIO(base64.b64decode(source))))


def test_the_light_in_the_page_is_the_light(tmp_path: Path, found: Estimate, photo: bytes) -> None:
    bright = found.light.radiance * torch.logspace(-3, 4, found.light.radiance.shape[-1])
    light = replace(found.light, radiance=bright)
    code = decoded(written(tmp_path / "a", replace(found, light=light), photo)).astype(np.float64)
    width = code.shape[1] // 2
    values = code[:, :width] / 255 * np.exp2(code[:, width:, :1] - 128)
    expected = bright.reshape(3, 256, bright.shape[-2] // 256, 512, -1).mean(dim=(2, 4)).permute(1, 2, 0).double()
    largest = expected.amax(dim=-1, keepdim=True).clamp(min=1e-30)
    error = (torch.from_numpy(values) - expected) / largest
    assert_close(error, torch.zeros_like(error), rtol=0, atol=1 / 255)
    assert found.confidence is not None
    shown = torch.from_numpy(code[:, width:, 1]) / 255
    assert_close(shown, found.confidence.observability_map(256).double(), rtol=0, atol=1 / 255)
    assert bool((code[128:, width:, 2] == 255).all())
    assert bool((code[:128, width:, 2] == 0).all())


def test_negative_and_black_light_can_be_shown() -> None:
    light = EnvironmentMap(torch.full((3, 8, 16), -1.0), nonnegative=False)
    code = panels.light_code(panels.small_light(light), None)
    assert int(code[:, :16].max()) == 0
    assert code.shape == (8, 32, 3)


def test_photographs_are_made_small_and_shown_as_they_are_seen() -> None:
    pixels = torch.zeros(3, 10, 2000)
    pixels[0] = 0.5
    stored = jpegs.unpacked(jpegs.photograph(pixels, linear=False))
    assert stored.shape == (4, 720, 3)
    assert abs(int(stored[2, 300, 0]) - 128) < 4
    shown = jpegs.unpacked(jpegs.photograph(pixels, linear=True))
    assert abs(int(shown[2, 300, 0]) - 188) < 4
    bright = jpegs.unpacked(jpegs.photograph(torch.full((3, 8, 8), 1e4), linear=True))
    assert int(bright.min()) > 250
    broken = torch.full((3, 8, 8), torch.nan)
    assert int(jpegs.unpacked(jpegs.photograph(broken, linear=True)).max()) < 4


def test_colours_and_directions() -> None:
    shares = np.array([[0.0, 1.0, np.nan]])
    picture = coloured(shares, "cividis", np.isnan(shares))
    assert picture[0].tolist() == [[0, 34, 78], [254, 232, 56], [140, 140, 140]]
    assert angles((0.0, 1.0, 1.0)) == pytest.approx((90.0, 45.0))


def test_faces_show_squares_and_fates(found: Estimate) -> None:
    assert found.refinement is not None
    picture = panels.fates_faces(found.refinement.kept[0], found.refinement.fate[0], 8)
    assert picture.shape == (384, 1024)
    assert int(picture[0, 0]) == 12  # no face
    assert int(picture[5, 400]) < 12
    shown = Image.open(BytesIO(panels.faces_png(picture))).convert("RGBA")
    assert np.asarray(shown)[5, [0, 400], 3].tolist() == [0, 255]
