"""HDR-FLIP: what an observer sees when two pictures alternate, over all exposures that show something.

The package flip-evaluator (extra `flip`) computes it; here pictures are handed over and the mean is handed back.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import ConfigError

PIXELS_PER_DEGREE = 67.0  # of the observer's view: 0.7 m before a display of 3,840 pixels on 0.7 m, FLIP's default


@dataclass(frozen=True, eq=False)
class Flip:
    """The difference that an observer sees.

    Attributes:
        mean: 0 = none, 1 = black against white.
        errors: per pixel, the largest over the exposures.
        exposures: first and last, in stops.
    """

    mean: float
    errors: Float[Tensor, "height width"]
    exposures: tuple[float, float]


def evaluator() -> ModuleType:
    """Returns the package that computes FLIP; raises ConfigError where it is not installed."""
    try:
        import flip_evaluator  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise ConfigError(
            "FLIP needs the package flip-evaluator; install it: pip install 'torchlight[flip]', or leave --flip out"
        ) from error
    return flip_evaluator


def hdr_flip(
    light: Float[Tensor, "3 height width"],
    reference: Float[Tensor, "3 height width"],
    pixels_per_degree: float = PIXELS_PER_DEGREE,
) -> Flip:
    """Returns HDR-FLIP of two linear Rec.709 pictures; negative values count as 0.

    Exposures run from where the reference's brightest pixel is just seen to where its median is bright; a picture that
    is black has none.

    Raises:
        ConfigError: flip-evaluator is not installed, or the reference is black.

    References:
        Andersson et al. (2021), Visualizing errors in rendered high dynamic range images.
    """
    flip = evaluator()
    if not bool((reference > 0).any()):
        raise ConfigError("FLIP: the reference is black, so no exposure shows anything; leave --flip out")
    pictures = [
        image.detach().clamp(min=0).permute(1, 2, 0).to("cpu", torch.float32).contiguous().numpy()
        for image in (reference, light)
    ]
    errors, mean, used = flip.evaluate(*pictures, "HDR", applyMagma=False, parameters={"ppd": pixels_per_degree})
    seen = torch.as_tensor(errors).reshape(*reference.shape[-2:], -1)[..., 0]
    return Flip(float(mean), seen, (float(used["startExposure"]), float(used["stopExposure"])))
