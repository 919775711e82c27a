"""Ground truth of synthetic data: the block's analytic shadow under a light, made once per sweep and kept on disk."""

from __future__ import annotations

import functools
import hashlib
import io
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import FormatError
from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.receiver import Receiver
from torchlight.io.atomic import make_folder, write_atomically
from torchlight.io.files import read_bytes, sha256_of
from torchlight.io.lights import read_light
from torchlight.io.sweep_data import Source
from torchlight.light.procedural import sun_and_window
from torchlight.synthetic import Rays, block_values, pixel_rays

TRUTH = "truth"
VERSION = "analytic-1"  # raise it when the numbers change
DIGEST_BYTES = 32


def truth(light: Source, block: Block, receiver: Receiver, folder: Path) -> Float[Tensor, "3 points"]:
    """Returns v = E / pi of every sample, for albedo 1, from the folder or made and kept there."""
    asked = [VERSION, light.name, light.sha256, asdict(block), receiver.center, receiver.size, receiver.samples]
    path = folder / f"{sha256_of(json.dumps(asked).encode())[:32]}.npy"
    found = kept(path, receiver)
    if found is None:
        found = block_values(block, receiver, rays_of(light.path))
        keep(path, found)
    return found


@functools.lru_cache(maxsize=1)
def rays_of(path: Path | None) -> Rays:
    """Returns the rays that stand for a light; a process keeps the last one's."""
    return pixel_rays(sun_and_window() if path is None else read_light(path))


def kept(path: Path, receiver: Receiver) -> Float[Tensor, "3 points"] | None:
    """Returns what a file holds; None where there is none, or its digest says that it was damaged."""
    if not path.is_file():
        return None
    try:
        content = read_bytes(path)
    except FormatError:
        return None
    digest, data = content[:DIGEST_BYTES], content[DIGEST_BYTES:]
    if hashlib.sha256(data).digest() != digest:
        return None
    values = torch.from_numpy(np.load(io.BytesIO(data), allow_pickle=False))
    return values if values.shape == (3, receiver.points) else None


def keep(path: Path, values: Float[Tensor, "3 points"]) -> None:
    """Writes values behind their digest, complete or not at all."""
    buffer = io.BytesIO()
    np.save(buffer, values.numpy(), allow_pickle=False)
    data = buffer.getvalue()
    make_folder(path.parent)
    write_atomically(path, hashlib.sha256(data).digest() + data)
