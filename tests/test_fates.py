"""The drawing of fates: every square where it belongs, every support counted once."""

from __future__ import annotations

from io import BytesIO

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor
from torch.testing import assert_close

from torchlight import fates
from torchlight.inversion.quadtree import indicators, quadtree
from torchlight.inversion.refinement import Fate, Refinement, constants, inherited, needed
from torchlight.light import cubemap

SIZE = 8
TREE = quadtree(SIZE)


def some_light(seed: int) -> tuple[Tensor, Tensor]:
    """Returns functions in use and consistent fates: random wavelets, everything else below threshold or unseen."""
    generator = torch.Generator().manual_seed(seed)
    kept = constants(TREE) | (torch.rand(3 * SIZE**2, generator=generator) < 0.05)
    fate = torch.full_like(TREE.supports, int(Fate.BELOW_THRESHOLD))
    fate[torch.rand(len(fate), generator=generator) < 0.2] = int(Fate.UNSEEN)
    divided = needed(TREE, kept)
    fate[divided] = int(Fate.RESOLVED)
    return kept, inherited(TREE, fate, divided)


@pytest.mark.parametrize("resolution", [2, 8])
def test_every_texel_is_shown_once_and_where_its_face_is(resolution: int) -> None:
    index = torch.arange(3.0 * resolution**2)
    shown = fates.unfolded(index, resolution)
    assert shown.shape == (3 * resolution // 2, 4 * resolution)
    assert sorted(shown[~shown.isnan()].tolist()) == index.tolist()


def test_touching_faces_share_their_directions() -> None:
    directions = cubemap.texel_directions(SIZE, 5)[cubemap.visible_texels(SIZE)]
    shown = fates.unfolded(directions.T.contiguous(), SIZE)
    for dim in (-1, -2):
        steps = torch.linalg.vector_norm(shown.diff(dim=dim), dim=0)
        assert float(steps[~steps.isnan()].max()) < 3 / SIZE


def test_outlines_enclose_exactly_the_texels_of_their_node() -> None:
    nodes = torch.arange(TREE.size)
    lit = fates.unfolded(indicators(TREE, nodes), SIZE)
    for node, border in zip(nodes.tolist(), fates.outlines(TREE, nodes), strict=True):
        rows, columns = (lit[node] == 1).nonzero(as_tuple=True)
        left, right = columns.min() / SIZE, (columns.max() + 1) / SIZE
        top, bottom = fates.HEIGHT - rows.min() / SIZE, fates.HEIGHT - (rows.max() + 1) / SIZE
        assert_close(border[:, 0], torch.stack([left, right, right, left, left]).double())
        assert_close(border[:, 1], torch.stack([top, top, bottom, bottom, top]).double())


@pytest.mark.parametrize("seed", range(4))
def test_the_counts_are_those_of_the_roots_and_of_the_quarters_of_what_is_divided(seed: int) -> None:
    kept, fate = some_light(seed)
    counts = fates.fate_counts(TREE, kept, fate)
    divided = needed(TREE, kept)
    assert counts.shape == (3, len(Fate))
    for level in range(3):
        here = TREE.level[TREE.supports] == level
        above = TREE.level[TREE.supports] == level - 1
        roots = {0: 1, 1: 8}.get(level, 0)
        assert int(counts[level].sum()) == roots + 4 * int(divided[above].sum())
        assert int(counts[level, Fate.RESOLVED]) == int(divided[here].sum())


def test_texels_show_the_smallest_support_that_holds_them() -> None:
    _, fate = some_light(0)
    shown = fates.texel_fates(TREE, fate)
    for support in (TREE.level[TREE.supports] == 2).nonzero()[:, 0].tolist():
        inside = indicators(TREE, TREE.supports[support][None])[0] > 0
        assert shown[inside].tolist() == [int(fate[support])] * 4


def test_the_picture_holds_the_colours_of_the_fates_that_occur_and_no_others() -> None:
    light = [some_light(seed) for seed in range(3)]
    kept, fate = (torch.stack(parts) for parts in zip(*light, strict=True))
    regions = torch.tensor([int(TREE.leaves(needed(TREE, k)).shape[0]) for k in kept])
    png = fates.fates_picture(Refinement(kept, fate, regions), SIZE)
    pixels = np.asarray(Image.open(BytesIO(png)))[..., :3].reshape(-1, 3)
    found = {"#{:02X}{:02X}{:02X}".format(*pixel) for pixel in np.unique(pixels, axis=0)}
    occurring = {fates.COLOURS[Fate(value)] for value in fate.unique().tolist()}
    assert found & set(fates.COLOURS.values()) == occurring


def test_every_fate_has_its_own_colour_and_name() -> None:
    assert set(fates.COLOURS) == set(fates.NAMES) == set(Fate)
    assert len(set(fates.COLOURS.values())) == len(Fate)


def test_colours_differ_in_grey_too() -> None:
    grey = []
    for colour in fates.COLOURS.values():
        red, green, blue = (int(colour[k : k + 2], 16) for k in (1, 3, 5))
        grey.append(0.2126 * red + 0.7152 * green + 0.0722 * blue)
    assert np.diff(sorted(grey)).min() > 8
