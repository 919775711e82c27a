"""Which object tells most of the light: shadows on one sheet, and how much of the light they determine."""

from __future__ import annotations

import torch
from jaxtyping import Float
from matplotlib.figure import Figure
from torch import Tensor

from torchlight.analysis.observability import degrees_of_freedom, whitened
from torchlight.drawing.canvas import png_bytes
from torchlight.drawing.content import UNUSED
from torchlight.geometry.primitives import box, cone, cylinder
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene
from torchlight.geometry.transforms import transform
from torchlight.light.procedural import sun_and_window
from torchlight.precomputation import precompute
from torchlight.preview import to_srgb8
from torchlight.relighting import relight
from torchlight.view import standing_free

FINE, COARSE = (120, 160), (36, 48)
CENTER, SIZE = (0.0, 0.0), (150.0, 200.0)  # mm
NOISE = 0.01  # of the mean sample
MAP_HEIGHT, RAYS = 256, 4_000


def objects_picture() -> bytes:
    """Returns a PNG of five objects' shadows with the number of independent figures each tells of the light."""
    shapes = objects()
    figure = Figure(figsize=(13.6, 4.2), dpi=100, layout="constrained")
    light = sun_and_window(MAP_HEIGHT)
    for axis, (name, triangles) in zip(figure.subplots(1, len(shapes)), shapes.items(), strict=True):
        fine = Scene(triangles, Receiver(CENTER, SIZE, FINE))
        values = relight(fine, light, RAYS)
        values = values / values.max() * 0.8
        picture = torch.where(standing_free(fine), values, torch.full_like(values, UNUSED**2.2))
        axis.imshow(to_srgb8(picture.reshape(3, *FINE[::-1]).flip(1)), extent=(-75, 75, -100, 100))
        axis.set_title(f"{name}: {told(Scene(triangles, Receiver(CENTER, SIZE, COARSE))):.0f}", fontsize=11)
        axis.set_xticks([])
        axis.set_yticks([])
    return png_bytes(figure)


def told(scene: Scene) -> float:
    """Returns how many independent figures of the light the plane tells at 1 % noise: the trace of the resolution."""
    transfer = precompute(scene, resolution=16, use_cache=False)
    return degrees_of_freedom(whitened(transfer, standing_free(scene), NOISE).transport)


def objects() -> dict[str, Float[Tensor, "faces 3 3"]]:
    """Returns the objects by name, all at most 35 mm tall; millimetres."""

    def placed(part: Tensor, turn: float = 30.0, height: float = 0.0) -> Tensor:
        return transform(part, 1.0, (0.0, 0.0, turn), (0.0, 0.0, height))

    return {
        "flat box": placed(box((30.0, 20.0, 8.0))),
        "stick": placed(cylinder(2.0, 35.0)),
        "cylinder": placed(cylinder(14.0, 35.0)),
        "block": placed(box((30.0, 20.0, 35.0))),
        "cone on a wide foot": torch.cat([placed(box((40.0, 26.0, 15.0))), placed(cone(9.0, 20.0), 0.0, 15.0)]),
    }
