"""Layers: exact over the photograph, straight and premultiplied alike."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.testing import assert_close

from torchlight.insertion.compositing import Layer, layer_of, over, premultiplied_of
from torchlight.insertion.unmixing import visible_part


def made(seed: int = 0) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Photograph, object, coverage and ratio, with pixels that nothing covers and nothing darkens."""
    generator = torch.Generator().manual_seed(seed)
    photo, thing, ratio = torch.rand(3, 3, 5, 6, generator=generator, dtype=torch.float64)
    coverage = torch.rand(5, 6, generator=generator, dtype=torch.float64)
    coverage[:2], ratio[:, 1:3] = 0.0, 1.0
    coverage[4, 5] = 1.0
    return photo, 3 * thing, coverage, ratio


def test_the_layer_over_the_photograph_is_the_composite() -> None:
    photo, thing, coverage, ratio = made()
    composite = over(layer_of(photo, thing, coverage, ratio), photo)
    assert_close(composite, coverage * thing + (1 - coverage) * photo * ratio)


def test_where_nothing_changed_the_photograph_is_bit_identical() -> None:
    photo, thing, coverage, ratio = (part.float() for part in made(1))
    composite = over(layer_of(photo, thing, coverage, ratio), photo)
    assert torch.equal(composite[:, 1], photo[:, 1])
    assert not torch.equal(composite[:, 0], photo[:, 0])


def test_straight_and_premultiplied_say_the_same() -> None:
    layer = layer_of(*made(2))
    assert_close(premultiplied_of(layer.straight), layer.premultiplied)
    assert (layer.straight[:, 1] == 0).all()  # no colour where there is no layer


def test_a_grey_shadow_is_black_with_alpha_and_a_coloured_one_keeps_its_colour() -> None:
    photo = torch.full((3, 1, 2), 0.5, dtype=torch.float64)
    nothing = torch.zeros(1, 2, dtype=torch.float64)
    ratio = torch.tensor([[[0.25, 0.5]], [[0.25, 0.25]], [[0.25, 0.25]]], dtype=torch.float64)
    layer = layer_of(photo, torch.zeros_like(photo), nothing, ratio)
    assert_close(layer.alpha, torch.tensor([[0.75, 0.75]], dtype=torch.float64))
    assert layer.colour[:, 0, 0].tolist() == [0.0, 0.0, 0.0]
    assert_close(layer.colour[:, 0, 1], torch.tensor([0.125, 0.0, 0.0], dtype=torch.float64))


def test_a_photograph_that_is_not_finite_stays_so_only_where_it_shows() -> None:
    photo = torch.full((3, 1, 1), torch.inf, dtype=torch.float64)
    layer = Layer(torch.zeros(3, 1, 1, dtype=torch.float64), torch.zeros(1, 1, dtype=torch.float64))
    assert over(layer, photo).isinf().all()


def test_half_a_pixel_of_plane_that_is_covered_leaves_the_old_object_s_half() -> None:
    # columns: plane, plane, half and half, old object, old object; the new object covers the plane's half
    plane, old = 0.8, 0.1
    photo = torch.tensor([plane, plane, (plane + old) / 2, old, old], dtype=torch.float64).expand(3, 5, 5).clone()
    before = torch.tensor([0.0, 0.0, 0.5, 1.0, 1.0], dtype=torch.float64).expand(5, 5)
    after = torch.tensor([0.0, 0.0, 1.0, 1.0, 1.0], dtype=torch.float64).expand(5, 5)
    shown = photo * visible_part(photo, before, after)
    assert_close(shown[:, :, 2], torch.full((3, 5), old, dtype=torch.float64))
    assert torch.equal(shown[:, :, [0, 1, 3, 4]], photo[:, :, [0, 1, 3, 4]])
    bright = layer_of(photo, torch.ones_like(photo), torch.full((5, 5), 0.5).double(), 1.5 * torch.ones_like(photo))
    assert_close(over(bright, photo), 0.5 + 0.75 * photo)  # exact where what remains is brighter, too


def test_nothing_is_unmixed_where_the_two_are_not_known() -> None:
    photo = torch.rand(3, 4, 4).double()
    nowhere = torch.full((4, 4), torch.nan).double()
    half = torch.full((4, 4), 0.5).double()
    assert torch.equal(visible_part(photo, nowhere, nowhere), torch.ones_like(photo))
    assert torch.equal(visible_part(photo, half, 0.2 * half), torch.ones_like(photo))
