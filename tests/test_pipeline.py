"""The whole story on a small scene: light found from its own shadow, what is cached, what is refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close
from workbench import SUN, degrees_between

from torchlight import precomputation
from torchlight.camera import Camera
from torchlight.errors import (
    CalibrationError,
    ConfigError,
    SceneError,
    ShapeError,
    TorchlightError,
    TorchlightWarning,
)
from torchlight.geometry import primitives
from torchlight.geometry.analytic_shadow import Block, block_irradiance
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene
from torchlight.geometry.transforms import transform
from torchlight.inversion.adaptive import AdaptiveHaar
from torchlight.inversion.nodes import NodeColumns
from torchlight.inversion.quadtree import pyramid, quadtree, texel_nodes, within
from torchlight.io import cache
from torchlight.io.images import Photo
from torchlight.light import cubemap
from torchlight.light.bases import HaarCubemap, SphericalHarmonics, Texels
from torchlight.light.peaks import peak_direction
from torchlight.light.procedural import sun_and_window
from torchlight.observing import check_lit, linearize, observe, visible_part
from torchlight.photo.observation import LinearPhoto, linear_photo
from torchlight.pipeline import estimate, resolve_method
from torchlight.precomputation import Progress, columns_for, deepened, precompute, transport_key
from torchlight.solvers import NNLS, Ridge, Status
from torchlight.synthetic import block_values, pixel_rays, receiver_image
from torchlight.transfer import Transfer, transport

BLOCK = Block((1.0, 0.6, 1.2), 20.0, (0.3, -0.2))
RECEIVER = Receiver((0.0, 0.0), (4.0, 4.0), (20, 20))
BASIS = Texels(4)
COUNT = cubemap.texel_count(4)


def block_scene(receiver: Receiver = RECEIVER) -> Scene:
    triangles = transform(
        primitives.box(BLOCK.size), 1.0, (0.0, 0.0, BLOCK.rotation_degrees), (*BLOCK.translation, 0.0)
    )
    return Scene(triangles, receiver)


@pytest.fixture(scope="module")
def transfer() -> Transfer:
    return transport(block_scene(), 4, 24)


def random_texels(seed: int) -> Tensor:
    """Heavy-tailed radiance at the visible texels, three channels of one colour but for a tenth."""
    generator = torch.Generator().manual_seed(seed)
    grey = torch.exp(1.5 * torch.randn(1, COUNT, generator=generator, dtype=torch.float64))
    return grey * (1 + 0.1 * torch.rand(3, COUNT, generator=generator, dtype=torch.float64))


def photograph(texels: Tensor, receiver: Receiver = RECEIVER) -> Tensor:
    """The rectified photograph of the block by its analytic shadow, on 19 x 19 directions per texel."""
    cells = cubemap.texel_cells(4, 19)
    fluxes = (texels.T[:, None, :] * cubemap.cell_cosine_weights(cells)[..., None]).reshape(-1, 3)
    values = block_irradiance(BLOCK, cubemap.cell_directions(cells).reshape(-1, 3), fluxes, receiver) / math.pi
    columns, rows = receiver.samples
    return values.reshape(3, rows, columns).flip(1)


def brightest_texel(texels: Tensor) -> Tensor:
    weights = cubemap.cosine_weights(4, 1)[:, 0]
    luminance = torch.tensor([0.2126, 0.7152, 0.0722], dtype=torch.float64) @ texels
    return cubemap.texel_directions(4, 5)[cubemap.visible_texels(4)][(luminance * weights).argmax()]


# --- light from a shadow -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("basis", [Texels(4), HaarCubemap(4)])
def test_light_is_found_from_its_own_shadow(transfer: Transfer, basis: Texels | HaarCubemap) -> None:
    texels = random_texels(1)
    found = estimate(photograph(texels), block_scene(), basis, transfer=transfer)
    assert (found.solution.status == Status.CONVERGED).all()
    assert_close(found.rms_255.item(), 0.0, rtol=0, atol=0.3)  # 0.09 to 0.14 over six seeds: the truth has other rays
    assert found.light.nonnegative
    towards = peak_direction(found.peaks).double()
    assert math.degrees(torch.acos((towards @ brightest_texel(texels)).clamp(max=1)).item()) < 8
    recovered = basis.synthesis(found.solution.coefficients).double()
    flux = cubemap.cosine_weights(4, 1)[:, 0]
    error = ((recovered - texels).abs() @ flux) / (texels @ flux)
    assert error.max() < 0.1  # 0.03 to 0.05 over six seeds


def test_harmonics_explain_what_they_can(transfer: Transfer) -> None:
    photo = photograph(random_texels(1))
    rms = [
        estimate(photo, block_scene(), SphericalHarmonics(degree, 4), Ridge(), transfer).rms_255.item()
        for degree in (1, 3)
    ]
    assert rms == sorted(rms, reverse=True)
    assert rms[0] > 2 * rms[-1] > 0


def test_albedo_is_divided_out_of_the_light_and_put_back_into_the_prediction(transfer: Transfer) -> None:
    photo = photograph(random_texels(2))
    albedo = (0.8, 0.5, 0.25)
    dim = photo * torch.tensor(albedo, dtype=torch.float64)[:, None, None]
    plain = estimate(photo, block_scene(), BASIS, transfer=transfer)
    found = estimate(dim, block_scene(replace(RECEIVER, albedo=albedo)), BASIS, transfer=transfer)
    assert_close(found.solution.coefficients, plain.solution.coefficients, rtol=1e-4, atol=1e-4)
    ratio = torch.tensor(albedo, dtype=found.predicted.dtype)[:, None]
    assert_close(found.predicted, plain.predicted * ratio, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("batch", [(2,), (2, 1)])
def test_a_batch_gives_what_each_photograph_gives_alone(transfer: Transfer, batch: tuple[int, ...]) -> None:
    photos = torch.stack([photograph(random_texels(seed)) for seed in (3, 4)])
    photos[1, :, 4, 5] = math.nan
    found = estimate(photos.reshape(*batch, 3, 20, 20), block_scene(), BASIS, transfer=transfer)
    assert found.light.radiance.shape[:-2] == (*batch, 3)
    assert found.peaks.directions.shape[:-2] == batch
    assert found.rms_255.shape == batch
    for k, photo in enumerate(photos):
        alone = estimate(photo, block_scene(), BASIS, transfer=transfer)
        assert_close(found.predicted.reshape(2, 3, 400)[k], alone.predicted, rtol=1e-5, atol=1e-6)
        assert torch.equal(found.observation.weights.reshape(2, 400)[k], alone.observation.weights)
        assert_close(found.rms_255.reshape(2)[k], alone.rms_255, rtol=1e-3, atol=1e-4)


def test_a_smooth_fall_off_does_not_turn_into_light(transfer: Transfer) -> None:
    """A sun through a lens that darkens towards the edges: with `reference: smooth` the residual stays small."""
    texels = torch.full((3, COUNT), 1e-3, dtype=torch.float64)
    texels[:, 40] = 10.0
    photo = photograph(texels)
    axis = torch.linspace(-1, 1, 20, dtype=torch.float64)
    darkened = photo * torch.exp(-0.3 * (axis[:, None] ** 2 + axis**2))
    plain = estimate(darkened, block_scene(), BASIS, transfer=transfer).rms_255
    smooth = estimate(darkened, replace(block_scene(), reference="smooth"), BASIS, transfer=transfer).rms_255
    assert smooth < 0.3 * plain


# --- the default: few Haar functions, chosen by the photograph -----------------------------------------------------


def test_without_a_basis_the_photograph_chooses_its_functions() -> None:
    """Truth by the analytic shadow; the light is explained, found again and nowhere negative."""
    texels = random_texels(1)
    method = AdaptiveHaar()
    columns = columns_for(block_scene(), method.basis, method, use_cache=False)
    assert isinstance(columns, NodeColumns)
    assert (columns.coarse.resolution, columns.tree.resolution) == (16, 128)
    found = estimate(photograph(texels), block_scene(), transfer=columns)
    assert found.basis == HaarCubemap(128)
    assert found.refinement is not None
    assert (found.refinement.functions <= 450).all()
    assert (found.solution.status == Status.CONVERGED).all()
    assert found.light.nonnegative
    assert 0 < found.rms_255 < 0.3
    tree, coarse = quadtree(128), quadtree(4)
    sums = pyramid(found.basis.synthesis(found.solution.coefficients).double(), 128)
    recovered = sums[:, within(coarse, tree)[texel_nodes(coarse)]] / 32**2
    flux = cubemap.cosine_weights(4, 1)[:, 0]
    error = ((recovered - texels).abs() @ flux) / (texels @ flux)
    assert error.max() < 0.05
    assert (found.refinement.functions < 60).all()  # 48 texels
    assert columns.kept == 0  # nothing finer than the dense transport was asked for


def test_a_sun_is_cast_for_once_and_found_where_it_is() -> None:
    """The light is 1 degree wide, a texel of the dense transport 6; by the analytic shadow, 8 bits."""
    values = block_values(BLOCK, RECEIVER, pixel_rays(sun_and_window(64)))
    photo = receiver_image((values / values.max() * 250).round() / 250, RECEIVER)
    method = AdaptiveHaar()
    columns = columns_for(block_scene(), method.basis, method, use_cache=False)
    found = estimate(photo, block_scene(), transfer=columns)
    assert found.rms_255 < 0.5
    assert degrees_between(peak_direction(found.peaks), SUN) < 2
    assert isinstance(columns, NodeColumns)
    before = columns.kept
    assert before > 0
    again = estimate(photo, block_scene(), transfer=columns)
    assert columns.kept == before
    assert torch.equal(again.solution.coefficients, found.solution.coefficients)


def test_the_prediction_is_that_of_the_coefficients() -> None:
    method = AdaptiveHaar(8, 40)
    columns = columns_for(block_scene(), method.basis, method, use_cache=False)
    dense = precompute(block_scene(), 8, use_cache=False)
    found = estimate(photograph(random_texels(2)), block_scene(), solver=method, transfer=columns)
    shown = found.solution.coefficients @ dense.project(method.basis).to(found.solution.coefficients).T / math.pi
    assert_close(found.predicted, shown, rtol=1e-5, atol=1e-5)
    same = estimate(photograph(random_texels(2)), block_scene(), solver=method, transfer=dense)
    assert_close(same.solution.coefficients, found.solution.coefficients, rtol=1e-5, atol=1e-5)


def test_a_coarse_transport_is_deepened_for_the_adaptive_method() -> None:
    """What `precompute` returns serves the default method as `columns_for` does."""
    values = block_values(BLOCK, RECEIVER, pixel_rays(sun_and_window(64)))
    photo = receiver_image((values / values.max() * 250).round() / 250, RECEIVER)
    method = AdaptiveHaar(64)
    columns = columns_for(block_scene(), method.basis, method, use_cache=False)
    dense = precompute(block_scene(), 16, use_cache=False)
    expected = estimate(photo, block_scene(), solver=method, transfer=columns)
    found = estimate(photo, block_scene(), solver=method, transfer=dense)
    assert torch.equal(found.solution.coefficients, expected.solution.coefficients)
    assert found.refinement is not None
    assert (found.solution.coefficients != 0).sum() > 100


def test_what_is_left_open_is_filled_in() -> None:
    usual = (HaarCubemap(128), AdaptiveHaar())
    assert resolve_method(None, None) == usual
    assert resolve_method(HaarCubemap(128), AdaptiveHaar()) == usual
    assert resolve_method(None, AdaptiveHaar(64)) == (HaarCubemap(64), AdaptiveHaar(64))
    assert resolve_method(Texels(8), None) == (Texels(8), NNLS())
    assert resolve_method(Texels(8), Ridge()) == (Texels(8), Ridge())


def test_methods_that_do_not_fit_are_refused(transfer: Transfer) -> None:
    one_line(ConfigError, "leave the basis away", lambda: resolve_method(Texels(8), AdaptiveHaar(8)))
    one_line(ConfigError, "leave the basis away", lambda: resolve_method(HaarCubemap(4), AdaptiveHaar(8)))
    one_line(ConfigError, "Ridge needs a basis", lambda: resolve_method(None, Ridge()))
    photo, columns = torch.ones(3, 20, 20), deepened(block_scene(), transfer, 8)
    one_line(
        ConfigError,
        "NNLS needs a dense transport",
        lambda: estimate(photo, block_scene(), HaarCubemap(8), transfer=columns),
    )
    one_line(
        ShapeError,
        "max_resolution is 16, the columns' 8",
        lambda: estimate(photo, block_scene(), solver=AdaptiveHaar(16), transfer=columns),
    )


def test_other_methods_take_the_dense_transport_of_their_basis(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[int] = []

    def noted(scene: Scene, n: int, s: int, progress: Progress | None = None, device: object = "cpu") -> Transfer:
        seen.append(n)
        return Transfer(torch.zeros(scene.receiver.points, cubemap.texel_count(n)), n)

    monkeypatch.setattr(precomputation, "transport", noted)
    assert isinstance(columns_for(small_scene(), Texels(8), NNLS(), use_cache=False), Transfer)
    for resolution in (4, 16, 64):
        method = AdaptiveHaar(resolution)
        assert isinstance(columns_for(small_scene(), method.basis, method, use_cache=False), NodeColumns)
    assert seen == [8, 4, 16, 16]


def test_squares_are_cast_from_the_scene_when_asked_for(transfer: Transfer) -> None:
    """Four quarters make the square; and the contours of the scene are found when first needed."""
    columns = deepened(block_scene(), transfer, 16)
    tree = columns.tree
    parents = within(columns.coarse, tree)[columns.coarse.supports.shape[0] :]
    parents = parents[tree.level[parents] == 2][::7]
    quarters = tree.children[tree.support_of[parents]]
    found = columns.finer(quarters.reshape(-1)).reshape(len(parents), 4, -1).sum(dim=1)
    place = torch.full_like(tree.level, -1).index_copy(0, columns.node, torch.arange(len(columns.node)))
    expected = columns.dense[place[parents]]
    assert (found - expected).abs().max() < 0.03 * expected.max()  # 24 and 2 x 24 directions along a square
    assert ((found - expected).abs().mean() < 1e-3 * expected.mean()).item()


# --- what is refused -----------------------------------------------------------------------------------------------


def camera_above(image_size: tuple[int, int] = (80, 80)) -> Camera:
    """A camera at height 10 that shows exactly the receiver, 20 pixels per unit, rows towards -y."""
    pose = torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0], dtype=torch.float64))
    pose[2, 3] = 10.0
    intrinsics = torch.tensor([[200.0, 0, 39.5], [0, 200, 39.5], [0, 0, 1]], dtype=torch.float64)
    return Camera(intrinsics, pose, image_size, torch.zeros(5, dtype=torch.float64))


def one_line(error: type[TorchlightError], pattern: str, call: Callable[[], object]) -> None:
    with pytest.raises(error, match=pattern) as caught:
        call()
    assert "\n" not in str(caught.value)
    assert type(caught.value) is error


def test_a_black_photograph_is_refused() -> None:
    one_line(
        SceneError,
        "the photograph is black",
        lambda: check_lit(observe(linear_photo(torch.zeros(3, 20, 20)), block_scene())),
    )


def test_a_photograph_without_a_usable_sample_is_refused() -> None:
    photo = torch.full((3, 20, 20), math.nan)
    one_line(SceneError, "no sample of the photograph", lambda: check_lit(observe(linear_photo(photo), block_scene())))


def test_one_failed_photograph_of_a_batch_is_noticed() -> None:
    photos = torch.ones(2, 3, 20, 20)
    photos[1] = math.nan
    one_line(SceneError, "no sample of the photograph", lambda: check_lit(observe(linear_photo(photos), block_scene())))


def test_a_mask_that_forbids_everything_is_refused() -> None:
    mask = torch.zeros(20, 20, dtype=torch.bool)
    one_line(SceneError, "and the mask", lambda: visible_part(replace(block_scene(), mask=mask)))
    with_camera = replace(block_scene(), camera=camera_above(), mask=torch.zeros(80, 80, dtype=torch.bool))
    one_line(SceneError, "check the mask", lambda: check_lit(observe(linear_photo(torch.ones(3, 80, 80)), with_camera)))


def test_a_photograph_of_another_size_than_the_camera_s_is_refused() -> None:
    scene = replace(block_scene(), camera=camera_above())
    pattern = "the photograph has 60 x 40 pixels but camera.image_size says 80 x 80"
    one_line(CalibrationError, pattern, lambda: observe(linear_photo(torch.ones(3, 40, 60)), scene))


def test_a_mask_of_another_size_than_the_photograph_is_refused() -> None:
    scene = replace(block_scene(), camera=camera_above(), mask=torch.ones(80, 40, dtype=torch.bool))
    pattern = "mask: 40 x 80 pixels, but the photograph has 80 x 80"
    one_line(ConfigError, pattern, lambda: observe(linear_photo(torch.ones(3, 80, 80)), scene))


@pytest.mark.parametrize("pose", ["below", "away"])
def test_a_camera_that_sees_no_receiver_is_refused(pose: str) -> None:
    camera = camera_above()
    matrix = torch.eye(4, dtype=torch.float64)
    matrix[2, 3] = 10.0 if pose == "below" else -10.0
    scene = replace(block_scene(), camera=replace(camera, world_to_camera=matrix))
    one_line(SceneError, "the camera sees no sample of the receiver", lambda: visible_part(scene))


def test_an_8_bit_photograph_must_say_how_it_is_encoded() -> None:
    photo = Photo(torch.rand(3, 4, 4), 8, "", is_linear=False)
    one_line(ConfigError, "photo.encoding: missing", lambda: linearize(photo, block_scene()))


# --- what a photograph contributes ---------------------------------------------------------------------------------


def test_saturated_pixels_and_pixels_that_are_no_numbers_are_not_usable() -> None:
    pixels = torch.full((3, 2, 3), 0.5)
    pixels[0, 0, 0], pixels[2, 1, 1] = 1.0, 254 / 255
    found = linearize(Photo(pixels, 8, "", is_linear=False), replace(block_scene(), encoding="srgb"))
    assert found.usable.tolist() == [[False, True, True], [True, True, True]]
    assert_close(found.radiance[1, 1, 2].item(), ((0.5 + 0.055) / 1.055) ** 2.4, rtol=1e-5, atol=0)
    pixels[1, 0, 1], pixels[1, 0, 2] = math.nan, math.inf
    floats = linearize(Photo(pixels, None, "", is_linear=True), block_scene())
    assert floats.usable.tolist() == [[True, False, False], [True, True, True]]


def test_a_mask_counts_in_the_photograph_s_pixels_with_a_camera_whoever_made_the_photo() -> None:
    mask = torch.ones(80, 80, dtype=torch.bool)
    mask[:, :16] = False  # 4 of 20 columns of samples
    scene = replace(block_scene(), triangles=torch.zeros(0, 3, 3), camera=camera_above())
    free = observe(linear_photo(torch.ones(3, 80, 80)), scene).weights.reshape(20, 20)
    for photo in (linear_photo(torch.ones(3, 80, 80)), LinearPhoto(torch.ones(3, 80, 80), torch.ones(80, 80).bool())):
        found = observe(photo, replace(scene, mask=mask)).weights.reshape(20, 20)
        assert torch.equal(found[:, :4], torch.zeros(20, 4))
        assert torch.equal(found[:, 5:], free[:, 5:])
    assert free.sum() >= 18 * 18


def test_a_mask_counts_in_the_receiver_s_pixels_without_a_camera() -> None:
    """The mask may have another size than the photograph; row 0 is the largest y in both."""
    mask = torch.ones(40, 60, dtype=torch.bool)
    mask[:4, :] = False  # the uppermost 2 of 20 rows of samples
    scene = replace(block_scene(), triangles=torch.zeros(0, 3, 3), mask=mask)
    found = observe(linear_photo(torch.ones(3, 20, 20)), scene).weights.reshape(20, 20)
    assert torch.equal(found[:18], torch.ones(18, 20))
    assert torch.equal(found[18:], torch.zeros(2, 20))


def test_a_camera_and_a_rectified_image_show_the_same_samples() -> None:
    photo = photograph(random_texels(5))
    seen = photo.repeat_interleave(4, dim=1).repeat_interleave(4, dim=2)
    through = observe(linear_photo(seen), replace(block_scene(), camera=camera_above()))
    flat = observe(linear_photo(photo), block_scene())
    both = (through.weights > 0) & (flat.weights > 0)
    assert both.float().mean() > 0.5
    assert_close(through.samples[:, both], flat.samples[:, both], rtol=0, atol=1e-9)


# --- precomputation ------------------------------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(cache.FOLDER_VARIABLE, str(tmp_path / "cache"))
    return tmp_path / "cache"


def small_scene() -> Scene:
    return block_scene(replace(RECEIVER, samples=(5, 4)))


def test_a_transport_is_computed_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[int] = []

    def counted(scene: Scene, resolution: int, subsamples: int, *rest: object) -> Transfer:
        calls.append(subsamples)
        return transport(scene, resolution, subsamples)

    monkeypatch.setattr(precomputation, "transport", counted)
    first, second = (precompute(small_scene(), 2, 4) for _ in range(2))
    assert torch.equal(first.transport, second.transport)
    assert second.resolution == 2
    assert calls == [4]
    assert len(list(folder.iterdir())) == 1
    precompute(small_scene(), 2, 3)
    assert calls == [4, 3]


def test_without_a_cache_nothing_is_read_or_written(folder: Path) -> None:
    precompute(small_scene(), 2, 2, use_cache=False)
    assert not folder.exists()


@pytest.mark.parametrize("damage", [b"", b"not a safetensors file", None])
def test_a_damaged_file_is_computed_again_with_a_warning(folder: Path, damage: bytes | None) -> None:
    expected = precompute(small_scene(), 2, 2).transport
    (file,) = folder.iterdir()
    stored = file.read_bytes()
    file.write_bytes(stored[:-1] + bytes([stored[-1] ^ 1]) if damage is None else damage)
    with pytest.warns(TorchlightWarning, match="ignored and computed again"):
        found = precompute(small_scene(), 2, 2).transport
    assert torch.equal(found, expected)
    assert torch.equal(precompute(small_scene(), 2, 2).transport, expected)


@pytest.mark.parametrize(("resolution", "subsamples"), [(16, 12), (64, 3), (128, 2)])
def test_the_default_sampling_has_192_directions_along_a_face(
    monkeypatch: pytest.MonkeyPatch, resolution: int, subsamples: int
) -> None:
    seen: list[tuple[int, int]] = []

    def noted(scene: Scene, n: int, s: int, progress: Progress | None = None, device: object = "cpu") -> Transfer:
        seen.append((n, s))
        return Transfer(torch.zeros(1, cubemap.texel_count(n)), n)

    monkeypatch.setattr(precomputation, "transport", noted)
    precompute(small_scene(), resolution, use_cache=False)
    assert seen == [(resolution, subsamples)]


def test_the_key_ignores_what_the_transport_does_not_depend_on() -> None:
    scene = small_scene()
    key = transport_key(scene, 2, 2)
    same = [
        replace(scene, camera=camera_above()),
        replace(scene, mask=torch.ones(3, 3, dtype=torch.bool)),
        replace(scene, reference="smooth", encoding="srgb", units="mm"),
        replace(scene, receiver=replace(scene.receiver, albedo=(0.5, 0.5, 0.5))),
    ]
    assert {transport_key(other, 2, 2) for other in same} == {key}


def test_the_key_changes_with_everything_the_transport_depends_on(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = small_scene()
    moved = scene.triangles + torch.tensor([1e-9, 0.0, 0.0], dtype=torch.float64)
    keys = [
        transport_key(scene, 2, 2),
        transport_key(scene, 4, 2),
        transport_key(scene, 2, 4),
        transport_key(replace(scene, triangles=moved), 2, 2),
        transport_key(replace(scene, receiver=replace(scene.receiver, center=(0.1, 0.0))), 2, 2),
        transport_key(replace(scene, receiver=replace(scene.receiver, size=(4.0, 4.1))), 2, 2),
        transport_key(replace(scene, receiver=replace(scene.receiver, samples=(4, 5))), 2, 2),
    ]
    monkeypatch.setattr(precomputation, "ALGORITHM", "transport-next")
    keys.append(transport_key(scene, 2, 2))
    assert len(set(keys)) == len(keys)
