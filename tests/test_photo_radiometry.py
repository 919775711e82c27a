from __future__ import annotations

import pytest
import torch
from torch.testing import assert_close

from torchlight.errors import ConfigError
from torchlight.photo.radiometry import linearize, resolve_encoding, saturated


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
    for call in (lambda: linearize(torch.zeros(3, 1, 1), "gamma"), lambda: resolve_encoding("gamma", None)):
        with pytest.raises(ConfigError, match=r"photo\.encoding: expected srgb or linear, got 'gamma'"):
            call()
