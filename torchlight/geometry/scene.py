"""What casts, what receives, what looks."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.camera import Camera
from torchlight.errors import SceneError
from torchlight.geometry.receiver import Receiver


@dataclass(frozen=True, eq=False)
class Scene:
    """A known scene: occluders as one triangle soup, the receiver, and the camera if there is one.

    Attributes:
        triangles: corners of every occluder triangle in the world frame (z = 0 is the plane, +z the light's side).
        receiver: the sampled rectangle of the plane.
        camera: the calibrated camera; None when photographs are already rectified receiver images.
        units: name of the length unit, carried into results.
        encoding: how 8- and 16-bit photographs encode radiance: "srgb", "linear", or None when not stated.
        reference: how the photograph is normalised: "uniform" or "smooth".
        mask: True where a photograph's pixel may be used (photograph pixels, or receiver pixels without a camera).
    """

    triangles: Float[Tensor, "faces 3 3"]
    receiver: Receiver
    camera: Camera | None = None
    units: str = "unit"
    encoding: str | None = None
    reference: str = "uniform"
    mask: Bool[Tensor, "height width"] | None = None

    def __post_init__(self) -> None:
        if self.triangles.ndim != 3 or self.triangles.shape[1:] != (3, 3):
            raise SceneError(f"triangles: expected shape [faces, 3, 3], got {list(self.triangles.shape)}")
        if not bool(torch.isfinite(self.triangles).all()):
            raise SceneError("triangles: some vertices are NaN or infinite; clean or re-export the mesh")
