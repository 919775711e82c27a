"""Shapes are checked in every test: annotations of the package are enforced by beartype."""

from __future__ import annotations

import gc

import elsewhere
import pytest
import torch
from jaxtyping import install_import_hook

install_import_hook("torchlight", "beartype.beartype")
elsewhere.register()  # before the first gradient: then torch counts the devices that there are

gc.disable()  # what is made until all tests are known stays; to look it through takes a quarter of the time


def pytest_collection_finish() -> None:
    gc.freeze()  # nor is it looked through while they run
    gc.enable()


def cuda() -> torch.device:
    if not torch.cuda.is_available():
        pytest.skip("no CUDA device")
    return torch.device("cuda")


@pytest.fixture(params=["cpu", "elsewhere", "cuda"])
def device(request: pytest.FixtureRequest) -> torch.device:
    """Where to compute: on the CPU, on a device that is not there, on a GPU where there is one."""
    if request.param == "cpu":
        return torch.device("cpu")
    return cuda() if request.param == "cuda" else elsewhere.register()
