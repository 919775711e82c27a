"""Small pictures of a report, as arrays: the receiver's samples, the light as numbers that a page can expose, maps."""

from __future__ import annotations

from io import BytesIO

import cv2
import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from torchlight.analysis.confidence import Confidence
from torchlight.drawing.content import DIVERGING
from torchlight.fates import COLOURS, texel_fates, unfolded
from torchlight.fit import MIN_SCALE_255, REJECTED
from torchlight.geometry.receiver import Receiver
from torchlight.inversion.quadtree import quadtree, spread
from torchlight.inversion.refinement import Fate, needed
from torchlight.light.environment import LUMINANCE, EnvironmentMap, luminance
from torchlight.photo.observation import Observation
from torchlight.preview import to_srgb8
from torchlight.report.colours import NOTHING, SEQUENTIAL, coloured
from torchlight.report.jpegs import jpeg, unpacked

LIGHT_ROWS = 256
BIAS = 128  # of exponents
LEAST, MOST = -3.0, 1.0  # decades of the deviation's picture
THUMBNAIL_QUALITY = 72
THUMBNAIL_ROWS, THUMBNAIL_COLUMNS = 52, 180
FACES_PIXELS = 1024


# --- the receiver ----------------------------------------------------------------------------------------------------


def receiver_pictures(
    observation: Observation, predicted: Float[Tensor, "3 points"], receiver: Receiver
) -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.uint8], float]:
    """Returns the observed, the predicted and the residual receiver, and the residual's limit, as in fit.png."""
    columns, rows = receiver.samples
    used = (observation.weights > 0).cpu()
    samples, shown = observation.samples.cpu(), predicted.cpu()
    white = float(samples[:, used].max()) if bool(used.any()) else 1.0
    difference = luminance(shown - samples) * (255.0 / white)
    limit = (
        max(MIN_SCALE_255, float(torch.quantile(difference[used].abs().double(), 0.998))) if bool(used.any()) else 1.0
    )
    grid = used.reshape(rows, columns).flip(0).numpy()
    left = observation.rejections.cpu().reshape(rows, columns).flip(0).numpy()
    pictures = []
    for values in (samples, shown):
        picture = to_srgb8((values / white).reshape(3, rows, columns).flip(1))
        picture[~grid] = NOTHING
        pictures.append(picture)
    share = (difference / limit / 2 + 0.5).reshape(rows, columns).flip(0).double().numpy()
    residual = coloured(share, DIVERGING, ~grid)
    for picture in (pictures[0], residual):
        for why, (colour, _) in REJECTED.items():
            picture[left == why] = rgb(colour)
    return pictures[0], pictures[1], residual, limit


def rgb(colour: str) -> tuple[int, int, int]:
    """Returns the numbers of "#rrggbb"."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


# --- the light -------------------------------------------------------------------------------------------------------


def small_light(light: EnvironmentMap) -> Float[Tensor, "3 height width"]:
    """Returns a light's radiance with at most 256 rows, means over pixels; negative values are set to 0."""
    factor = max(1, light.height // LIGHT_ROWS)
    return torch.nn.functional.avg_pool2d(light.radiance.detach().cpu().clamp(min=0)[None].float(), factor)[0]


def light_code(radiance: Float[Tensor, "3 height width"], confidence: Confidence | None) -> NDArray[np.uint8]:
    """Returns a light as 8-bit numbers that light.js reads: RGB mantissas, and to their right exponent + 128,

    observability and whether the pixel was not observed. A value is mantissa / 255 x 2^exponent; its error at most
    half a mantissa step, 1 / 255 of the pixel's brightest channel.
    """
    values = radiance.double().permute(1, 2, 0).numpy()
    brightest = values.max(axis=-1)
    exponent = np.where(brightest > 0, np.ceil(np.log2(np.maximum(brightest, 1e-38))), -BIAS).clip(-BIAS, BIAS - 1)
    mantissa = (values / np.exp2(exponent)[..., None] * 255).round().clip(0, 255)
    beside = np.zeros((*brightest.shape, 3))
    beside[..., 0] = exponent + BIAS
    height = radiance.shape[-2]
    beside[(height + 1) // 2 :, :, 2] = 255
    if confidence is not None:
        beside[..., 1] = 255 * confidence.observability_map(height).numpy()
        beside[..., 2] = 255 * confidence.unseen_map(height).numpy()
    return np.concatenate([mantissa, beside], axis=1).round().astype(np.uint8)


def thumbnail(photo: bytes, radiance: Float[Tensor, "3 height width"], scale: float) -> bytes:
    """Returns a JPEG of a photograph and, beside it, the upper half of its light: a row's picture in a table.

    Args:
        photo: as `jpegs.photograph` gives it.
        radiance: of the light.
        scale: the factor from radiance to linear picture values.
    """
    stored = unpacked(photo)
    rows, columns = THUMBNAIL_ROWS, THUMBNAIL_COLUMNS // 2
    factor = min(rows / stored.shape[0], columns / stored.shape[1])
    size = (max(1, round(stored.shape[1] * factor)), max(1, round(stored.shape[0] * factor)))
    sheet = np.full((rows, 2 * columns, 3), 128, dtype=np.uint8)
    left, top = (columns - size[0]) // 2, (rows - size[1]) // 2
    sheet[top : top + size[1], left : left + size[0]] = cv2.resize(stored, size, interpolation=cv2.INTER_AREA)
    upper = to_srgb8(radiance[:, : radiance.shape[1] // 2].double() * scale)
    sheet[:, columns:] = cv2.resize(upper, (columns, rows), interpolation=cv2.INTER_AREA)
    return jpeg(sheet, THUMBNAIL_QUALITY)


# --- what is known of it ---------------------------------------------------------------------------------------------


def observability_picture(confidence: Confidence, height: int = LIGHT_ROWS) -> NDArray[np.uint8]:
    """Returns R_ii above the plane, from 0 to 1."""
    half = height // 2
    unseen = confidence.unseen_map(height)[:half].numpy()
    return coloured(confidence.observability_map(height)[:half].numpy(), SEQUENTIAL, unseen)


def deviation_picture(confidence: Confidence, radiance: Float[Tensor, "3 height width"]) -> NDArray[np.uint8]:
    """Returns the luminance's deviation over its mean above the plane, in decades from 0.001 to 10."""
    half = radiance.shape[-2] // 2
    weights = torch.tensor(LUMINANCE, dtype=torch.float64)[:, None, None]
    deviation = torch.linalg.vector_norm(weights * confidence.deviation_map(2 * half)[:, :half].double(), dim=0)
    mean = luminance(radiance[:, :half].flatten(1)).mean().clamp(min=1e-30)
    decades = (deviation / mean).clamp(min=1e-30).log10().numpy()
    return coloured((decades - LEAST) / (MOST - LEAST), SEQUENTIAL, ~np.isfinite(decades))


def fates_faces(kept: Tensor, fate: Tensor, resolution: int) -> NDArray[np.uint8]:
    """Returns the unfolded faces of one channel: squares of constant light by their fate, outlined.

    Numbers of `faces_palette`: the fate, that plus the number of fates on an outline, twice that where no face is.
    """
    tree = quadtree(resolution)
    leaves = tree.leaves(needed(tree, kept))
    numbers = torch.zeros(tree.size, dtype=torch.float64)
    numbers[leaves] = leaves.double() + 1
    larger = max(1, FACES_PIXELS // (4 * resolution))
    squares = unfolded(spread(numbers, resolution), resolution).nan_to_num(0).int().numpy()
    values = unfolded(texel_fates(tree, fate).double(), resolution).nan_to_num(2 * len(Fate)).byte().numpy()
    squares, picture = _enlarged(squares, larger), _enlarged(values, larger)
    edges = np.zeros(squares.shape, dtype=bool)
    edges[1:] |= squares[1:] != squares[:-1]
    edges[:, 1:] |= squares[:, 1:] != squares[:, :-1]
    picture[edges & (squares > 0)] += len(Fate)
    return picture


def faces_png(numbers: NDArray[np.uint8]) -> bytes:
    """Returns the picture of `fates_faces` as PNG; transparent where no face is."""
    from PIL import Image

    image, buffer = Image.fromarray(numbers), BytesIO()
    image.putpalette(faces_palette().tobytes())
    image.save(buffer, format="PNG", transparency=2 * len(Fate))
    return buffer.getvalue()


def faces_palette() -> NDArray[np.uint8]:
    """Returns the colours of fates, those of their outlines, which are darker, and one for where no face is."""
    fates = np.array([rgb(COLOURS[value]) for value in Fate])
    return np.concatenate([fates, 0.45 * fates, [NOTHING]]).round().astype(np.uint8)


def _enlarged(values: NDArray, factor: int) -> NDArray:
    return values.repeat(factor, axis=0).repeat(factor, axis=1)
