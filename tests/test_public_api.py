"""The names that `import torchlight as tl` offers."""

from __future__ import annotations

from importlib import import_module

import pytest

import torchlight as tl


@pytest.mark.parametrize("name", tl.__all__)
def test_every_public_name_resolves_to_what_its_module_defines(name: str) -> None:
    value = getattr(tl, name)
    home = import_module(f"torchlight.{tl._HOME[name]}")
    assert value is getattr(home, name)
    assert value.__doc__
    assert value.__module__.startswith(home.__name__.rpartition(".")[0] or "torchlight")


def test_the_lists_agree() -> None:
    assert sorted(tl._HOME) == sorted(tl.__all__)
    assert len(set(tl.__all__)) == len(tl.__all__)
    assert set(tl.__all__) <= set(dir(tl))
    assert "__name__" in dir(tl)


def test_the_names_of_the_contract_are_there() -> None:
    promised = {"load_scene", "precompute", "estimate", "relight", "solve", "EnvironmentMap"}
    promised |= {"Texels", "SphericalHarmonics", "HaarCubemap", "Ridge", "NNLS", "ProjectedAdam"}
    assert promised <= set(tl.__all__)


def test_unknown_names_are_attribute_errors() -> None:
    with pytest.raises(AttributeError, match="module 'torchlight' has no attribute 'colour'"):
        tl.colour  # noqa: B018
    assert not hasattr(tl, "_nothing")
