"""Observations for a DataLoader: what photographs show of the receiver's samples, as tensors of one shape."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor
from torch.utils.data import Dataset

from torchlight.batch.ending import failure
from torchlight.batch.looking import look
from torchlight.batch.scenes import Setting, setting_of
from torchlight.config import Config
from torchlight.io.images import read_photo


class Observations(Dataset[dict[str, Tensor | str]]):
    """Samples and weights of photographs of one scene.

    Item i is {"samples" [3 points] float32, "weights" [points] float32, "index", "reason"}: v = albedo E / pi with the
    scene's reference divided out, as `observe` returns it. A photograph that cannot be used has the weights 0 and says
    why in "reason"; the solvers give such an item a status of its own. Nothing but file names travels to workers: each
    loads the scene once.
    """

    def __init__(self, photos: Sequence[str | Path], scene: str | Path, config: Config | None = None) -> None:
        self._photos = [Path(photo) for photo in photos]
        self._scene = Path(scene)
        self._config = Config() if config is None else config

    def __len__(self) -> int:
        return len(self._photos)

    def __getitem__(self, index: int) -> dict[str, Tensor | str]:
        photo, setting = self._photos[index], once(self._scene, self._config)
        try:
            shown = look(setting, photo, read_photo(photo)).observation
            samples, weights, reason = shown.samples.float(), shown.weights.float(), ""
        except Exception as error:  # noqa: BLE001 (one photograph never stops the others)
            points = setting.scene.receiver.points
            samples, weights, reason = torch.zeros(3, points), torch.zeros(points), failure(error)
        return {"samples": samples, "weights": weights, "index": torch.tensor(index), "reason": reason}


@functools.lru_cache(maxsize=4)
def once(scene: Path, config: Config) -> Setting:
    """Returns what photographs of a scene are looked at with; a process keeps the last ones."""
    return setting_of(scene, config)
