"""Shapes are checked in every test: annotations of the package are enforced by beartype."""

from __future__ import annotations

from jaxtyping import install_import_hook

install_import_hook("torchlight", "beartype.beartype")
