from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from torch.testing import assert_close

from torchlight.errors import FormatError
from torchlight.io.rgbe import decode_hdr, hdr_size, read_hdr, write_hdr

HEADER = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n"


def random_image(height: int, width: int, decades: float = 6.0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(height * width)
    brightness = 10 ** (decades * torch.rand(1, height, width, generator=generator, dtype=torch.float64) - decades / 2)
    return brightness * torch.rand(3, height, width, generator=generator, dtype=torch.float64)


def test_a_mantissa_means_what_it_means_elsewhere() -> None:
    pixels = bytes([128, 64, 0, 129, 255, 1, 3, 136, 9, 9, 9, 0])
    image = decode_hdr(HEADER + b"-Y 1 +X 3\n" + pixels, "a.hdr")
    expected = torch.tensor([[1.0, 255.0, 0.0], [0.5, 1.0, 0.0], [0.0, 3.0, 0.0]])[:, None]
    assert_close(image, expected, rtol=0, atol=0)


@pytest.mark.parametrize("width", [1, 7, 8, 127, 128, 129, 300])
def test_round_trip_within_half_a_step(tmp_path: Path, width: int) -> None:
    image = random_image(5, width)
    write_hdr(tmp_path / "a.hdr", image)
    back = read_hdr(tmp_path / "a.hdr").double()
    error = (back - image).abs() / image.amax(dim=0)
    assert back.shape == image.shape
    assert error.max() <= 2**-8
    assert error.max() > 2**-10


def test_rounding_is_unbiased(tmp_path: Path) -> None:
    image = random_image(200, 300)
    write_hdr(tmp_path / "a.hdr", image)
    back = read_hdr(tmp_path / "a.hdr").double()
    relative = (back - image) / image.amax(dim=0)
    # the standard error of the mean of 180,000 errors of at most 2^-8 is below 5e-6
    assert_close(relative.mean().item(), 0.0, rtol=0, atol=3e-5)


def test_a_second_round_trip_changes_nothing(tmp_path: Path) -> None:
    write_hdr(tmp_path / "a.hdr", random_image(20, 30))
    once = read_hdr(tmp_path / "a.hdr")
    write_hdr(tmp_path / "b.hdr", once)
    assert_close(read_hdr(tmp_path / "b.hdr"), once, rtol=0, atol=0)


def test_rounding_up_to_the_next_exponent(tmp_path: Path) -> None:
    image = torch.tensor([255.9, 0.9999, 1.0]).reshape(1, 1, 3).expand(3, 1, 3)
    write_hdr(tmp_path / "a.hdr", image)
    assert_close(read_hdr(tmp_path / "a.hdr"), torch.tensor([256.0, 1.0, 1.0]).reshape(1, 1, 3).expand(3, 1, 3))


def test_negative_and_tiny_values_are_black(tmp_path: Path) -> None:
    write_hdr(tmp_path / "a.hdr", torch.tensor([-1.0, 0.0, 1e-41]).reshape(1, 1, 3).expand(3, 1, 3))
    assert_close(read_hdr(tmp_path / "a.hdr"), torch.zeros(3, 1, 3), rtol=0, atol=0)


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), 3e38])
def test_values_that_do_not_fit(tmp_path: Path, bad: float) -> None:
    with pytest.raises(FormatError, match=r"a\.hdr: NaN, infinite or larger"):
        write_hdr(tmp_path / "a.hdr", torch.full((3, 1, 1), bad))
    assert not (tmp_path / "a.hdr").exists()


def test_opencv_reads_the_same_values(tmp_path: Path) -> None:
    write_hdr(tmp_path / "ours.hdr", random_image(40, 60))
    runs = np.repeat(np.repeat(random_image(4, 6).permute(1, 2, 0).float().numpy(), 10, axis=0), 10, axis=1)
    assert cv2.imwrite(str(tmp_path / "theirs.hdr"), runs)
    for name in ("ours.hdr", "theirs.hdr"):
        pixels = cv2.imread(str(tmp_path / name), cv2.IMREAD_UNCHANGED)
        assert pixels is not None
        expected = torch.from_numpy(pixels[..., ::-1].copy()).permute(2, 0, 1)
        assert_close(read_hdr(tmp_path / name), expected, rtol=0, atol=0)


def test_every_orientation_shows_the_same_picture() -> None:
    rgbe = np.random.default_rng(0).integers(128, 256, (2, 3, 4), dtype=np.uint8)
    stored = {
        "-Y 2 +X 3": rgbe,
        "-Y 2 -X 3": rgbe[:, ::-1],
        "+Y 2 +X 3": rgbe[::-1],
        "+Y 2 -X 3": rgbe[::-1, ::-1],
        "+X 3 -Y 2": rgbe.transpose(1, 0, 2),
        "-X 3 -Y 2": rgbe[:, ::-1].transpose(1, 0, 2),
        "+X 3 +Y 2": rgbe[::-1].transpose(1, 0, 2),
        "-X 3 +Y 2": rgbe[::-1, ::-1].transpose(1, 0, 2),
    }
    expected = decode_hdr(HEADER + b"-Y 2 +X 3\n" + rgbe.tobytes(), "a.hdr")
    for line, pixels in stored.items():
        data = HEADER + line.encode() + b"\n" + pixels.tobytes()
        assert_close(decode_hdr(data, line), expected, rtol=0, atol=0)
        assert hdr_size(data, line) == (3, 2)


def test_runs() -> None:
    new = bytes([2, 2, 0, 8]) + bytes([136, 10]) + bytes([2, 1, 2, 134, 3]) + bytes([8, *range(8)]) + bytes([136, 136])
    image = decode_hdr(HEADER + b"-Y 1 +X 8\n" + new, "a.hdr")
    expected = torch.tensor([[10] * 8, [1, 2] + [3] * 6, list(range(8))]).float()[:, None]
    assert_close(image, expected, rtol=0, atol=0)
    old = bytes([5, 6, 7, 136, 1, 1, 1, 3, 8, 9, 10, 136])
    image = decode_hdr(HEADER + b"-Y 1 +X 5\n" + old, "a.hdr")
    assert_close(image, torch.tensor([[5, 5, 5, 5, 8], [6, 6, 6, 6, 9], [7, 7, 7, 7, 10]]).float()[:, None])
    long = bytes([5, 6, 7, 136, 1, 1, 1, 4, 1, 1, 1, 1])
    image = decode_hdr(HEADER + b"-Y 1 +X 261\n" + long, "a.hdr")
    assert_close(image, torch.tensor([5.0, 6.0, 7.0]).reshape(3, 1, 1).expand(3, 1, 261))


def test_exposure_is_divided_out() -> None:
    header = b"#?RGBE\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=2\nEXPOSURE= 4.0\nCOLORCORR= 1 2 4\n\n-Y 1 +X 1\n"
    image = decode_hdr(header + bytes([128, 128, 128, 136]), "a.hdr")
    assert_close(image.flatten(), torch.tensor([16.0, 8.0, 4.0]))


def test_every_truncation_is_noticed(tmp_path: Path) -> None:
    write_hdr(tmp_path / "a.hdr", random_image(3, 9))
    data = (tmp_path / "a.hdr").read_bytes()
    for length in range(1, len(data)):
        with pytest.raises(FormatError) as error:
            decode_hdr(data[:length], "a.hdr")
        assert str(error.value).startswith("a.hdr: ")
        assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"hello\n\n", "does not begin with"),
        (HEADER.replace(b"rgbe", b"xyze") + b"-Y 1 +X 1\n1234", "only 32-bit_rle_rgbe"),
        (HEADER + b"-Y 1 -Y 1\n1234", "expected a resolution"),
        (HEADER + b"-Y 0 +X 1\n1234", "expected 1 to"),
        (HEADER + b"-Y 99999999 +X 99999999\n1234", "expected 1 to"),
        (HEADER + b"-Y 1 +X 8\n" + bytes([2, 2, 0, 9]) + b"x" * 40, "does not match the header"),
        (HEADER + b"-Y 1 +X 8\n" + bytes([2, 2, 0, 8, 0]), "length zero"),
        (HEADER + b"-Y 1 +X 8\n" + bytes([2, 2, 0, 8, 200, 1]), "crosses the end"),
        (HEADER + b"-Y 1 +X 2\n" + bytes([1, 1, 1, 2]), "without a pixel"),
        (HEADER + b"-Y 1 +X 2\n" + bytes([9, 9, 9, 130, 1, 1, 1, 200]), "crosses the end"),
        (b"#?RADIANCE\nEXPOSURE=x\n\n-Y 1 +X 1\n1234", "not a number"),
        (b"#?RADIANCE\nEXPOSURE=0\n\n-Y 1 +X 1\n1234", "not positive"),
    ],
)
def test_broken_files(data: bytes, message: str) -> None:
    with pytest.raises(FormatError) as error:
        decode_hdr(data, "a.hdr")
    assert str(error.value).startswith("a.hdr: ")
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_known_primaries_are_stated_and_read_back(tmp_path: Path) -> None:
    image = torch.rand(3, 4, 8, generator=torch.Generator().manual_seed(0)) + 0.5
    write_hdr(tmp_path / "a.hdr", image, primaries="acescg")
    assert b"PRIMARIES= 0.713 0.293 0.165 0.83 0.128 0.044 0.32168 0.33767\n" in (tmp_path / "a.hdr").read_bytes()
    assert_close(read_hdr(tmp_path / "a.hdr"), image, atol=2.0**-7 * 1.5 * 2, rtol=0)  # rounding, times the matrix
    data = (tmp_path / "a.hdr").read_bytes()
    as_stored = decode_hdr(data.replace(b"PRIMARIES= 0.713", b"PRIMARIES= 0.613"), "a.hdr")
    assert_close(
        as_stored[0], (torch.tensor([0.613097, 0.339523, 0.047379])[:, None, None] * image).sum(0), atol=0.01, rtol=0
    )
    write_hdr(tmp_path / "b.hdr", image)
    assert b"PRIMARIES" not in (tmp_path / "b.hdr").read_bytes()


@pytest.mark.parametrize("stated", [b"0 0 0 0 0 0 0 0", b"0.713 0.293", b"red"])
def test_primaries_that_are_not_known_are_taken_as_rec709(tmp_path: Path, stated: bytes) -> None:
    image = torch.ones(3, 4, 8)
    write_hdr(tmp_path / "a.hdr", image)
    data = (tmp_path / "a.hdr").read_bytes().replace(b"# torchlight\n", b"PRIMARIES= " + stated + b"\n")
    assert_close(decode_hdr(data, "a.hdr"), image, atol=0, rtol=0)
