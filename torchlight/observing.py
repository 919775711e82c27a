"""From stored photographs to samples of the receiver: what was seen, and how far it can be trusted."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight import metrics
from torchlight.camera import project
from torchlight.errors import CalibrationError, ConfigError, SceneError, TorchlightError
from torchlight.geometry.footprints import footprint_points, subpoints_for, visible_samples
from torchlight.geometry.receiver import Receiver, sample_centers
from torchlight.geometry.scene import Scene
from torchlight.interreflection import thrown_back, without
from torchlight.io.images import Photo, read_photo
from torchlight.photo import radiometry, reference
from torchlight.photo.observation import LinearPhoto, Observation, Rejection, linear_photo
from torchlight.photo.rectification import from_camera, from_rectified
from torchlight.photo.specular import without_glints
from torchlight.transfer import Transfer, transport

COARSE = 16  # texels along a face's edge, for light that occluders throw back
COARSE_DIRECTIONS = 12  # along a texel's; with 4 what is thrown back comes out wrong by up to half


def linearize(photo: Photo, scene: Scene) -> LinearPhoto:
    """Returns a stored photograph in linear units, with the pixels that saturation leaves.

    Raises:
        ConfigError: an 8- or 16-bit photograph whose encoding the scene does not state.
    """
    encoding = radiometry.resolve_encoding(scene.encoding, photo.bits)
    response = None if scene.response is None else radiometry.Response(scene.response)
    linear = linear_photo(radiometry.linearize(photo.pixels, encoding, scene.gamma, response))
    saturated = radiometry.saturated(photo.pixels, photo.bits)
    return LinearPhoto(linear.radiance, linear.usable & ~saturated, saturated)


def placed(scene: Scene, photo: Photo, name: str) -> Scene:
    """Returns the scene with the camera of one photograph; the scene as it is where all share one, or none.

    Raises:
        CalibrationError: the photograph does not show enough of the board.
    """
    if scene.finder is None:
        return scene
    linear = photo.is_linear or scene.encoding == "linear"
    return replace(scene, camera=scene.finder(photo.pixels, linear, name), finder=None)


def observe(
    photo: LinearPhoto,
    scene: Scene,
    visible: Bool[Tensor, " points"] | None = None,
    empty: Observation | None = None,
) -> Observation:
    """Returns what photographs say about the receiver's samples, the scene's reference divided out, without glints.

    Of occluders whose albedo is stated, the light that they throw back is taken away as well (`interreflection`).

    Args:
        photo: linear photographs.
        scene: receiver, camera, mask and reference.
        visible: from `visible_part`; computed when absent, worth keeping for many photographs.
        empty: from `empty_plane`, likewise.

    Raises:
        CalibrationError: the photograph's size is not the camera's.
        SceneError: no sample is visible. A photograph of which none is usable, or none is lit, is no error here, so
            that it harms no other of its batch; `check_lit` tells.
    """
    visible = visible_part(scene) if visible is None else visible
    shown = referenced(sample_photo(photo, scene, visible), scene, visible, empty)
    return of_black_occluders(without_glints(shown, scene.receiver.samples), scene)


def of_black_occluders(observation: Observation, scene: Scene) -> Observation:
    """Returns what the photograph would show if the occluders were black; as it is where no albedo is stated.

    Raises:
        SceneError: an albedo is stated, and the occluders are not one convex object.
    """
    if scene.occluder_albedo == 0.0:
        return observation
    transfer = coarse_transport(scene.triangles, scene.receiver).to(observation.samples.device)
    return without(observation, thrown_back(observation, scene, transfer, scene.occluder_albedo))


@functools.lru_cache(maxsize=4)
def coarse_transport(triangles: Float[Tensor, "faces 3 3"], receiver: Receiver) -> Transfer:
    """Returns a transport that is good enough for what occluders throw back; the last few are kept."""
    return transport(Scene(triangles, receiver), COARSE, COARSE_DIRECTIONS)


def referenced(
    observation: Observation, scene: Scene, visible: Bool[Tensor, " points"], empty: Observation | None = None
) -> Observation:
    """Returns samples with the scene's reference divided out; the arguments are those of `observe`."""
    if scene.albedo_map is not None:
        observation = reference.divide(observation, mapped_albedo(scene, scene.albedo_map, visible))
    if scene.reference == "smooth":
        return reference.divide(observation, reference.smooth(observation, sample_centers(scene.receiver)))
    if scene.reference == "stack" and not scene.reference_photos and empty is None:
        empty = reference.stack(observation)
    empty = empty_plane(scene, visible) if empty is None else empty
    return observation if empty is None else reference.divide(observation, reference.photographed(empty, observation))


def empty_plane(
    scene: Scene, visible: Bool[Tensor, " points"], photos: Sequence[str | Path] = ()
) -> Observation | None:
    """Returns what the plane shows without the object, as the references "photo" and "stack" find it; else None.

    Args:
        scene: receiver, camera, encoding, mask and reference.
        visible: from `visible_part`.
        photos: photographs of the call, of which "stack" is made where the scene lists none.

    Raises:
        TorchlightError: a photograph cannot be read or is not of the camera's size; too few for a stack.
    """
    if scene.reference not in ("photo", "stack"):
        return None
    shown = [sampled_file(file, scene, visible) for file in scene.reference_photos or photos]
    if scene.reference == "photo":
        return shown[0]
    if not shown:
        raise ConfigError("reference: stack has no photographs; list them as reference.photos")
    return reference.stack(Observation(*(torch.stack(part) for part in zip(*map(parts_of, shown), strict=True))))


def parts_of(observation: Observation) -> tuple[Tensor, Tensor]:
    """Returns samples and weights."""
    return observation.samples, observation.weights


def sampled_file(file: str | Path, scene: Scene, visible: Bool[Tensor, " points"]) -> Observation:
    """Returns what a photograph of the scene's camera shows of the receiver's samples; errors name the file."""
    try:
        photo = read_photo(file)
        here = placed(scene, photo, str(file))
        return sample_photo(linearize(photo, here), here, visible if here is scene else visible_part(here))
    except TorchlightError as error:
        raise type(error)(str(error) if str(file) in str(error) else f"reference: {file}: {error}") from error


def mapped_albedo(
    scene: Scene, albedo: Float[Tensor, "3 rows columns"], visible: Bool[Tensor, " points"]
) -> reference.Reference:
    """Returns the albedo of every sample, the exact mean of the map over it; 0 where any of it is unknown."""
    known = LinearPhoto(albedo, (albedo > 0).all(dim=0))
    return reference.Reference(from_rectified(known, scene.receiver.samples, visible).samples)


def visible_part(scene: Scene) -> Bool[Tensor, " points"]:
    """Returns which samples a photograph of the scene can show; with no camera the scene's mask counts here.

    Raises:
        SceneError: none.
    """
    visible = visible_samples(scene)
    if scene.mask is not None and scene.camera is None and scene.finder is None:
        kept = from_rectified(
            LinearPhoto(scene.mask.float().expand(3, -1, -1), scene.mask), scene.receiver.samples, visible
        )
        visible = kept.weights > 0
    if not bool(visible.any()):
        seen = "is usable" if scene.camera is None else "that is usable"
        what = "no sample of the receiver" if scene.camera is None else "the camera sees no sample of the receiver"
        raise SceneError(f"{what} {seen}; check the pose, the receiver's place and size, and the mask")
    return visible


def sample_photo(photo: LinearPhoto, scene: Scene, visible: Bool[Tensor, " points"]) -> Observation:
    """Returns the photograph averaged over every sample's footprint, before any reference; saturated ones dropped."""
    footprints = footprint_pixels(photo, scene)
    if scene.mask is not None and scene.camera is not None:
        photo = masked(photo, scene.mask)

    def sampled(photo: LinearPhoto) -> Observation:
        if footprints is None:
            return from_rectified(photo, scene.receiver.samples, visible)
        return from_camera(photo, footprints, visible)

    observation = sampled(photo)
    if photo.saturated is None or not bool(photo.saturated.any()):
        return observation
    bounded = sampled(LinearPhoto(torch.zeros_like(photo.radiance), photo.usable | photo.saturated)).weights > 0
    lost = bounded & (observation.weights == 0)
    return replace(observation, rejected=(lost * Rejection.SATURATED.value).to(torch.uint8))


def footprint_pixels(photo: LinearPhoto, scene: Scene) -> Float[Tensor, "points sub 2"] | None:
    """Returns where the photograph shows the points of each sample's footprint; None where it is rectified.

    Raises:
        CalibrationError: the photograph's size is not the camera's.
    """
    if scene.camera is None:
        return None
    height, width = photo.radiance.shape[-2:]
    if (width, height) != scene.camera.image_size:
        raise CalibrationError(
            f"the photograph has {width} x {height} pixels but camera.image_size says "
            f"{scene.camera.image_size[0]} x {scene.camera.image_size[1]}; use the size the camera was calibrated at, "
            "not cropped, not turned"
        )
    points = footprint_points(scene.receiver, subpoints_for(scene.camera, scene.receiver))
    return project(scene.camera, points)


def masked(photo: LinearPhoto, mask: Bool[Tensor, "height width"]) -> LinearPhoto:
    """Returns the photograph without the pixels that the mask forbids; ConfigError where their sizes differ."""
    if mask.shape != photo.usable.shape[-2:]:
        (height, width), (rows, columns) = photo.usable.shape[-2:], mask.shape
        raise ConfigError(
            f"mask: {columns} x {rows} pixels, but the photograph has {width} x {height}; "
            "draw the mask over the photograph at its full size"
        )
    kept = mask.to(photo.usable.device)
    saturated = None if photo.saturated is None else photo.saturated & kept
    return LinearPhoto(photo.radiance, photo.usable & kept, saturated)


def check_lit(observation: Observation) -> None:
    """Raises SceneError where a photograph has no usable sample or is black on all of them."""
    usable = observation.weights > 0
    if not bool(usable.any(dim=-1).all()):
        raise SceneError(
            "no sample of the photograph can be used: all are masked, saturated, not finite or hidden; "
            "check the mask, the exposure and the camera's pose"
        )
    brightest = metrics.brightest(observation.samples, observation.weights)
    if bool(brightest.isnan().any()):
        raise SceneError("the photograph is black on the receiver; check that it is the right file and its exposure")
