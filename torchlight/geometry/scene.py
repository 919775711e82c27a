"""What casts, what receives, what looks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.camera import Camera
from torchlight.errors import SceneError
from torchlight.geometry.receiver import Receiver
from torchlight.light_plane import LightPlane


@dataclass(frozen=True, eq=False)
class Scene:
    """A known scene: occluders as one triangle soup, the receiver, and the camera if there is one.

    Attributes:
        triangles: corners of every occluder triangle in the world frame (z = 0 is the plane, +z the light's side).
        receiver: the sampled rectangle of the plane.
        camera: the calibrated camera; None when photographs are already rectified receiver images.
        units: name of the length unit, carried into results.
        encoding: how 8- and 16-bit photographs encode radiance: "srgb", "linear", "gamma", "response", "raw" (RAW files
            only), or None when not stated.
        gamma: exponent of the encoding "gamma".
        response: relative exposure of every stored code, of the encoding "response".
        reference: how the photograph is normalised: "uniform", "smooth", "stack", "photo" or "albedo".
        reference_photos: the empty plane's photograph of "photo", those of "stack"; none = those of the call.
        finder: (pixels, whether they are linear, name) -> the camera of one photograph, where every photograph has its
            own pose (`placed` in the pipeline); None otherwise.
        albedo_map: the receiver's albedo, seen from above as a rectified photograph; 0 where unknown.
        occluder_albedo: how much light the occluders throw back, gloss included; 0 = black, or not to be accounted for.
        mask: True where a photograph's pixel may be used (photograph pixels, or receiver pixels without a camera).
        light_plane: where all light stands; None = far away.
        occluder_matt: whether the occluders are matt and of one colour, so that their pixels tell of the light.
    """

    triangles: Float[Tensor, "faces 3 3"]
    receiver: Receiver
    camera: Camera | None = None
    units: str = "unit"
    encoding: str | None = None
    reference: str = "uniform"
    mask: Bool[Tensor, "height width"] | None = None
    gamma: float = 2.2
    response: Float[Tensor, "3 codes"] | None = None
    reference_photos: tuple[Path, ...] = ()
    albedo_map: Float[Tensor, "3 rows columns"] | None = None
    finder: Callable[[Float[Tensor, "3 height width"], bool, str], Camera] | None = None
    occluder_albedo: float = 0.0
    light_plane: LightPlane | None = None
    occluder_matt: bool = False

    def __post_init__(self) -> None:
        if self.triangles.ndim != 3 or self.triangles.shape[1:] != (3, 3):
            raise SceneError(f"triangles: expected shape [faces, 3, 3], got {list(self.triangles.shape)}")
        if not bool(torch.isfinite(self.triangles).all()):
            raise SceneError("triangles: some vertices are NaN or infinite; clean or re-export the mesh")
        if self.light_plane is not None and len(self.triangles) > 0:
            self.light_plane.check_above(float(self.triangles[..., 2].max()))
        if self.light_plane is not None and self.occluder_albedo > 0:
            raise SceneError(
                "light.height and occluder_albedo cannot be combined: what the occluders throw back is known for "
                "distant light only; leave one of them out"
            )


def shadowing(scene: Scene) -> Scene:
    """Returns the scene whose distant light throws the shadows that this one's light does (`light_plane`)."""
    if scene.light_plane is None:
        return scene
    return replace(scene, triangles=scene.light_plane.stretch(scene.triangles), light_plane=None)
