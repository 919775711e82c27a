from __future__ import annotations

import pytest
import torch
from torch.testing import assert_close

from torchlight.errors import ConfigError
from torchlight.photo.radiometry import Response, encode, linearize, resolve_encoding, saturated, tabulated


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_srgb_values_and_dtype(dtype: torch.dtype) -> None:
    stored = torch.tensor([0.0, 0.04045, 0.5, 1.0, 1.5, -0.1], dtype=dtype)
    # IEC 61966-2-1, evaluated with 20 digits
    expected = torch.tensor(
        [0.0, 0.0031308049535603714, 0.21404114048223255, 1.0, 2.5371645, -0.0077399380804953560], dtype=dtype
    )
    expected[4] = ((1.5 + 0.055) / 1.055) ** 2.4
    pixels = stored.expand(2, 3, 1, 6)
    assert_close(linearize(pixels, "srgb"), expected.expand(2, 3, 1, 6), rtol=1e-6, atol=1e-7)


def test_linear_values_stay() -> None:
    pixels = torch.rand(3, 4, 5)
    assert_close(linearize(pixels, "linear"), pixels, rtol=0, atol=0)


@pytest.mark.parametrize("bits", [8, 16])
def test_saturation_is_the_top_code_in_any_channel(bits: int) -> None:
    top = 2**bits - 1
    codes = torch.tensor([[top, 0, 0], [top - 1, top - 1, top - 1], [0, 0, top], [0, 0, 0]], dtype=torch.float64)
    pixels = (codes / top).float().T.reshape(3, 2, 2)
    expected = torch.tensor([[True, False], [True, False]])
    assert_close(saturated(pixels, bits), expected)
    assert_close(saturated(pixels.expand(5, 4, 3, 2, 2), bits), expected.expand(5, 4, 2, 2))


def test_float_photographs_saturate_at_infinity() -> None:
    pixels = torch.tensor([1.0, 1e30, float("inf"), float("nan")]).reshape(1, 1, 4).expand(3, 1, 4)
    assert_close(saturated(pixels, None), torch.tensor([[False, False, True, False]]))


def test_which_encoding_applies() -> None:
    assert resolve_encoding("srgb", 8) == "srgb"
    assert resolve_encoding("linear", 16) == "linear"
    assert resolve_encoding(None, None) == "linear"
    assert resolve_encoding("srgb", None) == "linear"


@pytest.mark.parametrize("bits", [8, 16])
def test_integer_photographs_must_say_their_encoding(bits: int) -> None:
    with pytest.raises(ConfigError) as error:
        resolve_encoding(None, bits)
    message = str(error.value)
    assert "\n" not in message
    for part in ("photo.encoding", f"{bits}-bit", "encoding: srgb", "encoding: linear"):
        assert part in message


def test_unknown_encodings() -> None:
    for call in (lambda: linearize(torch.zeros(3, 1, 1), "log"), lambda: resolve_encoding("log", None)):
        with pytest.raises(ConfigError, match=r"photo\.encoding: expected srgb or linear or .*, got 'log'"):
            call()


def test_gamma_and_its_inverse() -> None:
    pixels = torch.tensor([0.0, 0.5, 1.0, 1.5, -0.1], dtype=torch.float64).expand(3, 1, 5)
    expected = torch.tensor([0.0, 0.5**1.8, 1.0, 1.5**1.8, 0.0], dtype=torch.float64).expand(3, 1, 5)
    assert_close(linearize(pixels, "gamma", 1.8), expected)
    assert_close(linearize(pixels, "gamma"), pixels.clamp(min=0) ** 2.2)
    for encoding in ("srgb", "gamma", "linear"):
        assert_close(encode(linearize(pixels[..., :4], encoding, 1.8), encoding, 1.8), pixels[..., :4])


def test_response_is_exact_at_codes_and_linear_between() -> None:
    table = torch.tensor([[0.0, 1, 4], [0.0, 2, 4], [1.0, 2, 4]], dtype=torch.float64) / 4
    pixels = torch.tensor([0.0, 0.25, 0.5, 0.75, 1.0], dtype=torch.float64).expand(2, 3, 1, 5)
    expected = torch.tensor([[0, 0.5, 1, 2.5, 4], [0, 1, 2, 3, 4], [1, 1.5, 2, 3, 4]], dtype=torch.float64) / 4
    found = linearize(pixels, "response", response=Response(table))
    assert_close(found, expected.reshape(3, 1, 5).expand(2, 3, 1, 5))


@pytest.mark.parametrize("encoding", ["srgb", "linear", "gamma"])
def test_a_table_of_an_encoding_linearizes_as_the_encoding(encoding: str) -> None:
    pixels = (torch.arange(256, dtype=torch.float64) / 255).expand(3, 1, 256)
    found = linearize(pixels, "response", response=tabulated(encoding, 256))
    assert_close(found, linearize(pixels, encoding), rtol=1e-9, atol=1e-12)


def test_responses_that_cannot_be() -> None:
    for row in ([0.0, 1.0, 1.0], [0.0, 2.0, 1.0], [-1.0, 0.0, 1.0], [0.0, 1.0, float("nan")], [1.0]):
        with pytest.raises(ConfigError, match="response: expected"):
            Response(torch.tensor(row).expand(3, -1))
    with pytest.raises(ConfigError, match=r"photo\.response: missing"):
        linearize(torch.zeros(3, 1, 1), "response")


def test_raw_is_for_raw_files() -> None:
    assert resolve_encoding("raw", None) == "linear"
    with pytest.raises(ConfigError, match="raw, but the photograph has 8 bits and is developed already"):
        resolve_encoding("raw", 8)
