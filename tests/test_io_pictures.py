"""Pictures stored as the photograph was."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch.testing import assert_close

from torchlight.errors import ConfigError
from torchlight.io.exif import Exif
from torchlight.io.exr import read_exr
from torchlight.io.images import Photo, read_photo
from torchlight.io.pictures import Storage, Untouched, storage_of, write_picture
from torchlight.photo.radiometry import Response, apply_response, inverse_response, linearize, tabulated


def ramp() -> torch.Tensor:
    return torch.linspace(0, 1, 3 * 16 * 16, dtype=torch.float64).reshape(3, 16, 16)


@pytest.mark.parametrize("encoding", ["srgb", "linear", "gamma"])
@pytest.mark.parametrize("bits", [8, 16])
def test_what_is_written_reads_back_as_the_same_light(tmp_path: Path, encoding: str, bits: int) -> None:
    clipped = write_picture(tmp_path / "a.png", ramp(), Storage(encoding, bits, 2.0), {})
    photo = read_photo(tmp_path / "a.png")
    assert clipped == 0
    assert photo.bits == bits
    back = linearize(photo.pixels.double(), encoding, 2.0)
    assert_close(back, ramp(), rtol=0, atol=1.2 / 2**bits)  # half a code, where the curve is at its steepest


def test_a_measured_response_is_inverted() -> None:
    response = Response(torch.stack([torch.linspace(0, 1, 256).double() ** power for power in (1.5, 2.0, 2.5)]))
    stored = ramp()
    assert_close(inverse_response(apply_response(stored, response), response), stored, rtol=0, atol=1e-9)
    like_srgb = tabulated("srgb", 256)
    assert_close(
        inverse_response(ramp(), like_srgb), Storage("srgb").stored(ramp()), rtol=0, atol=2e-3
    )  # straight between codes


def test_untouched_pixels_keep_their_codes(tmp_path: Path) -> None:
    codes = torch.randint(0, 256, (3, 8, 8), generator=torch.Generator().manual_seed(0)).float() / 255
    changed = torch.zeros(8, 8, dtype=torch.bool)
    changed[2:4] = True
    write_picture(tmp_path / "a.png", torch.full((3, 8, 8), 2.0), Storage(), {}, Untouched(codes, changed))
    back = read_photo(tmp_path / "a.png").pixels
    assert torch.equal(back[:, ~changed], codes[:, ~changed])
    assert (back[:, changed] == 1).all()


def test_light_beyond_white_is_kept_in_exr_and_counted_in_png(tmp_path: Path) -> None:
    bright = torch.full((3, 2, 2), 0.5)
    bright[0, 0, 0] = 7.0
    assert write_picture(tmp_path / "a.exr", bright, Storage(), {"values": "linear"}) == 0
    assert read_exr(tmp_path / "a.exr")[0].max() == 7.0
    assert write_picture(tmp_path / "a.png", bright, Storage(), {}) == 0.25


def test_alpha_is_refused_where_it_cannot_be(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"expected a name that ends in .png or .exr, which hold alpha"):
        write_picture(tmp_path / "a.jpg", torch.zeros(4, 2, 2), Storage(), {})


def test_float_photographs_become_srgb() -> None:
    photo = Photo(torch.zeros(3, 2, 2), None, "", True, Exif())
    found = storage_of(photo, "gamma", 2.2, None)
    assert (found.encoding, found.bits) == ("srgb", 8)
    deep = storage_of(Photo(photo.pixels, 16, "", False, Exif()), "gamma", 2.4, None)
    assert (deep.encoding, deep.bits, deep.gamma) == ("gamma", 16, 2.4)
