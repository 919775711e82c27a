"""The colour maps of pages are Matplotlib's."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
import pytest

from torchlight.report import colours


@pytest.mark.parametrize("name", colours.used())
def test_tables_are_those_of_matplotlib(name: str) -> None:
    expected = 255 * mpl.colormaps[name](np.linspace(0, 1, 256))[:, :3]
    assert np.array_equal(colours.table(name), expected.round().astype(np.uint8))


def test_nothing_is_grey() -> None:
    shown = colours.coloured(np.array([[0.0, 1.0]]), colours.SEQUENTIAL, np.array([[True, False]]))
    assert shown[0].tolist() == [list(colours.NOTHING), colours.table(colours.SEQUENTIAL)[255].tolist()]
