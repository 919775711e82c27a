"""`torchlight estimate` from its command line: what comes out, and what a failure says and leaves behind."""

from __future__ import annotations

import hashlib
import json
import math
import pickle
import subprocess
import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenEXR
import pytest
import torch
from safetensors.torch import load_file
from torch import Tensor
from torch.testing import assert_close
from workbench import BLOCK, CAMERA, LINEAR, RECTIFIED, SUN, Ran, contents, degrees_between, exr, png, scene_file
from workbench import torchlight as run

from torchlight import precomputation, results
from torchlight.io.cache import entries
from torchlight.io.lights import read_light
from torchlight.io.scene_file import load_scene
from torchlight.light import cubemap
from torchlight.light.bases import SphericalHarmonics
from torchlight.light.environment import luminance, power
from torchlight.marking import GROUND, GROUND_LINE
from torchlight.solvers.solution import Status

FILES = [
    "confidence.exr", "estimate.safetensors", "fit.png", "light.exr", "light.hdr", "light.png", "report.html",
    "result.json", "thumbnail.jpg", "timing.json",
]  # fmt: skip
CHANGED = RECTIFIED.replace


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(autouse=True)
def one_cache(shared: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Most tests share a few transports, so that rays are cast once."""
    monkeypatch.setenv("TORCHLIGHT_CACHE", str(shared))


def estimate(scene: Path, *photos: Path, out: Path, options: tuple[object, ...] = ()) -> Ran:
    """Texels unless the options say otherwise: what has no choices to make; test_cli_adaptive has the default."""
    method = () if {"--method", "--basis"} & set(options) else ("--method", "texels")
    return run("estimate", scene, *photos, "--out", out, "--resolution", 4, *method, *options)


def strict_json(path: Path) -> dict[str, Any]:
    def refuse(word: str) -> None:
        raise ValueError(f"{word} is not JSON")

    return json.loads(path.read_text(), parse_constant=refuse)


# --- what comes out ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Made:
    scene: Path
    photo: Path
    folder: Path
    ran: Ran
    result: dict[str, Any]
    tensors: dict[str, Tensor]


def make(folder: Path, cache: Path, *options: object) -> Made:
    scene, photo = scene_file(folder), png(folder / "block.png")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TORCHLIGHT_CACHE", str(cache))
        ran = estimate(scene, photo, out=folder / "out", options=options)
    assert (ran.code, ran.err) == (0, "")
    made = folder / "out" / "block"
    result, tensors = strict_json(made / "result.json"), load_file(made / "estimate.safetensors")
    return Made(scene, photo, made, ran, result, tensors)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, shared: Path) -> Made:
    return make(tmp_path_factory.mktemp("texels"), shared)


@pytest.fixture(scope="module")
def ridge(tmp_path_factory: pytest.TempPathFactory, shared: Path) -> Made:
    return make(tmp_path_factory.mktemp("ridge"), shared, "--method", "sh", "--degree", 2, "--solver", "ridge")


def test_one_folder_with_its_files_and_nothing_else(made: Made) -> None:
    assert contents(made.folder.parent) == ["block", *(f"block/{name}" for name in FILES)]


def channels_of(path: Path) -> dict[str, Tensor]:
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: torch.from_numpy(channel.pixels.copy()) for name, channel in file.channels().items()}


@pytest.mark.parametrize("which", ["made", "ridge"])
def test_confidence_lies_beside_the_light_pixel_by_pixel(which: str, request: pytest.FixtureRequest) -> None:
    here: Made = request.getfixturevalue(which)
    planes = channels_of(here.folder / "confidence.exr")
    height = read_light(here.folder / "light.exr").height
    assert sorted(planes) == ["deviation.B", "deviation.G", "deviation.R", "observability"]
    assert {plane.shape for plane in planes.values()} == {(height, 2 * height)}
    upper, lower = planes["observability"][: height // 2], planes["observability"][height // 2 :]
    assert 0 < upper.min() < upper.max() <= 1
    assert int(lower.count_nonzero()) == 0
    for name in "RGB":
        deviation = planes[f"deviation.{name}"]
        assert bool(deviation[: height // 2].isfinite().all())
        assert bool((deviation[: height // 2] > 0).all())
        assert bool(deviation[height // 2 :].isinf().all())
    told = here.result["confidence"]
    assert 0 < told["determined_share"] <= 1
    assert told["texels_per_edge"] == 4
    assert told["noise"] >= 0.999 * 0.4 / 255
    assert here.result["fill"] == "none"


def test_the_floor_is_filled_where_asked_and_nothing_else(made: Made, tmp_path: Path) -> None:
    plain = read_light(made.folder / "light.exr").radiance
    half = plain.shape[-2] // 2
    assert int(plain[:, half:].count_nonzero()) == 0
    for fill in ("constant", "smooth"):
        out = tmp_path / fill
        ran = estimate(made.scene, made.photo, out=out, options=("--fill", fill, "--skip-pictures"))
        assert (ran.code, ran.err) == (0, "")
        filled = read_light(out / "block/light.exr").radiance
        assert torch.equal(filled[:, :half], plain[:, :half])
        assert bool((filled[:, half:] > 0).all())
        result = strict_json(out / "block/result.json")
        assert result["fill"] == fill
        same = ("rms_255", "preview_clipped_flux", "peak_direction", "confidence")
        assert {key: result[key] for key in same} == {key: made.result[key] for key in same}


def test_confidence_and_report_can_be_left_out(made: Made, tmp_path: Path) -> None:
    options = ("--skip-confidence", "--skip-report")
    assert estimate(made.scene, made.photo, out=tmp_path / "out", options=options).code == 0
    left = {"confidence.exr", "report.html", "thumbnail.jpg"}
    assert contents(tmp_path / "out/block") == [name for name in FILES if name not in left]
    assert strict_json(tmp_path / "out/block/result.json")["confidence"] is None
    ran = estimate(made.scene, made.photo, out=tmp_path / "no", options=("--skip-confidence", "--fill", "smooth"))
    assert ran.code == 2
    assert "--skip-confidence" in ran.line


def test_rms_is_that_of_the_stored_coefficients(made: Made) -> None:
    scene = load_scene(made.scene)
    transport = precomputation.precompute(scene, 4, use_cache=False).transport.double().numpy()
    predicted = made.tensors["coefficients"].double().numpy() @ transport.T / math.pi
    observed, used = made.tensors["samples"].double().numpy(), made.tensors["weights"].numpy() > 0
    residual = (predicted - observed)[:, used]
    rms = 255 * np.sqrt(np.mean(residual**2)) / observed[:, used].max()
    assert_close(made.result["rms_255"], rms, rtol=1e-5, atol=0)
    relative = np.sqrt(np.mean(residual**2) / np.mean(observed[:, used] ** 2))
    assert_close(made.result["rms_relative"], relative, rtol=1e-5, atol=0)
    assert_close(made.tensors["predicted"].double().numpy(), predicted, rtol=1e-5, atol=1e-6)
    assert f"RMS {rms:.2f} of 255" in made.ran.out


def test_samples_are_the_photographs(made: Made) -> None:
    stored = cv2.imread(str(made.photo))
    assert stored is not None
    linear = torch.from_numpy(stored[::-1, :, ::-1].astype(np.float32) / 255).permute(2, 0, 1).reshape(3, -1)
    used = made.tensors["weights"] > 0
    assert_close(made.tensors["samples"][:, used], linear[:, used], rtol=0, atol=1e-6)


def test_visible_points_and_their_ratio(made: Made) -> None:
    visible = int((made.tensors["weights"] > 0).sum())
    assert 0 < visible < 256
    found = {key: made.result[key] for key in ("visible", "points", "visible_share")}
    assert found == {"visible": visible, "points": 256, "visible_share": visible / 256}
    assert f"{visible} of 256 samples visible ({visible / 256:.1%})" in made.ran.out


def test_method_solver_and_certificates(made: Made) -> None:
    coefficients = made.tensors["coefficients"]
    assert coefficients.shape == (3, 48)
    assert made.tensors["status"].tolist() == [Status.CONVERGED] * 3
    largest = coefficients.amax(dim=-1, keepdim=True)
    expected = {
        "method": "texels",
        "resolution": 4,
        "solver": "nnls",
        "coefficients": 48,
        "nonzero": (coefficients > 1e-9 * largest).sum(dim=-1).tolist(),
        "nonnegative": True,
        "status": ["converged"] * 3,
    }
    assert {key: made.result[key] for key in expected} == expected
    assert all(0 < count < 48 for count in made.result["nonzero"])
    assert all(0 <= value <= 1e-9 for value in made.result["kkt_residual"])
    assert all(0 <= value <= 1e-10 for value in made.result["gap"])
    assert len(made.result["kkt_residual"]) == len(made.result["gap"]) == len(made.result["steps"]) == 3


def test_where_it_comes_from(made: Made) -> None:
    assert made.result["photo"] == str(made.photo)
    assert made.result["photo_sha256"] == hashlib.sha256(made.photo.read_bytes()).hexdigest()
    assert made.result["scene_sha256"] == hashlib.sha256(made.scene.read_bytes()).hexdigest()
    assert made.result["units"] == "relative"
    assert made.result["length_unit"] == "mm"
    assert made.result["light_is"] == "radiance x albedo x exposure"
    assert made.result["reference"] == "uniform"
    assert "Z up, row 0 = zenith, image centre looks along +X" in made.result["convention"]
    for name in ("torchlight", "torch", "kornia", "numpy", "trimesh", "OpenEXR"):
        assert made.result["versions"][name] == version(name)


def test_the_peak_is_the_mean_flux_within_12_degrees_of_the_brightest_texel(made: Made) -> None:
    texels = luminance(made.tensors["coefficients"].double())
    directions = cubemap.texel_directions(4, 5)[cubemap.visible_texels(4)].double().numpy()
    cells = cubemap.texel_cells(4, 1)
    flux = (texels * cubemap.cell_cosine_weights(cells)[:, 0].double()).numpy()
    near = directions @ directions[flux.argmax()] >= math.cos(math.radians(12))
    mean = flux[near] @ cubemap.cell_directions(cells)[:, 0].double().numpy()[near]
    assert degrees_between(made.result["peak_direction"], mean) < 0.01
    assert_close(np.linalg.norm(made.result["peak_direction"]).item(), 1.0, rtol=0, atol=1e-5)
    assert_close(made.result["peak_share"], flux[near].sum() / flux.sum(), rtol=1e-5, atol=0)
    assert degrees_between(made.result["peak_direction"], SUN) < 12  # towards the light; texels are 22 degrees wide
    shares = [peak["share"] for peak in made.result["peaks"]]
    assert shares == sorted(shares, reverse=True)
    assert sum(shares) + made.result["peak_share"] <= 1 + 1e-6


def test_no_other_keys_and_times_by_stage(made: Made) -> None:
    assert set(made.result) == {
        *("photo", "rms_255", "rms_relative", "visible", "points", "visible_share", "method", "resolution", "solver"),
        *(
            "coefficients",
            "nonzero",
            "nonnegative",
            "negative_flux",
            "status",
            "steps",
            "kkt_residual",
            "gap",
            "peak_direction",
        ),
        *("peak_share", "peaks", "reference", "units", "light_is", "length_unit", "convention", "photo_sha256"),
        *("scene_sha256", "versions", "preview_clipped_flux", "functions", "regions", "fates", "exposure"),
        *("near_light", "occluder_albedo", "light_plane", "placement", "camera", "rejected", "saturated_samples"),
        *("noise", "warnings", "confidence", "fill"),
    }
    seconds = strict_json(made.folder / "timing.json")["seconds"]
    assert list(seconds) == ["scene", "transport", "photograph", "solve"]
    assert all(value >= 0 for value in seconds.values())


def test_the_light_is_a_float32_exr_with_its_meaning(made: Made) -> None:
    with OpenEXR.File(str(made.folder / "light.exr"), separate_channels=True) as file:
        header, channels = dict(file.header()), file.channels()
        pixels = {name: channel.pixels for name, channel in channels.items()}
    assert sorted(pixels) == ["B", "G", "R"]
    assert all(plane.dtype == np.float32 and plane.shape == (256, 512) for plane in pixels.values())
    assert_close(np.ravel(header["chromaticities"]).tolist(), [0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329])
    assert "envmap" not in header
    assert header["compression"] == OpenEXR.ZIP_COMPRESSION
    metadata = json.loads(header["torchlight"])
    assert metadata == {
        "convention": "torchlight",
        "units": "relative",
        "nonnegative": True,
        "light_is": "radiance x albedo x exposure",
        "fill": "none",
        "method": "texels",
        "resolution": 4,
        "photo_sha256": made.result["photo_sha256"],
        "scene_sha256": made.result["scene_sha256"],
    }


def test_the_map_holds_the_power_of_the_coefficients(made: Made) -> None:
    """Exact area weights."""
    areas = cubemap.solid_angles(4).flatten().repeat(5)[cubemap.visible_texels(4)]
    expected = made.tensors["coefficients"].double() @ areas
    assert_close(power(read_light(made.folder / "light.exr")).double(), expected, rtol=1e-5, atol=0)


def test_the_other_pictures(made: Made) -> None:
    exact, rgbe = read_light(made.folder / "light.exr").radiance, read_light(made.folder / "light.hdr").radiance
    assert_close(rgbe, exact, rtol=0, atol=exact.max().item() / 100)
    preview = cv2.imread(str(made.folder / "light.png"), cv2.IMREAD_UNCHANGED)
    assert preview is not None
    assert (preview.shape[1:], preview.dtype) == ((512, 3), np.uint8)
    assert 256 < preview.shape[0] < 350  # with a legend
    below = {tuple(colour) for colour in preview[128:256].reshape(-1, 3).tolist()}
    assert below == {GROUND, GROUND_LINE}
    fit = cv2.imread(str(made.folder / "fit.png"))
    assert fit is not None
    assert fit.shape[1] > 2 * fit.shape[0]
    assert 0 <= made.result["preview_clipped_flux"] <= 1
    assert f"{made.result['preview_clipped_flux']:.0%} of the flux clipped in light.png" in made.ran.out


def test_negative_values_are_kept_and_said(ridge: Made) -> None:
    with OpenEXR.File(str(ridge.folder / "light.exr")) as file:
        metadata = json.loads(dict(file.header())["torchlight"])
    assert metadata["nonnegative"] is False
    assert ridge.result["nonnegative"] is False
    assert 0.1 < ridge.result["negative_flux"] < 0.9
    radiance = read_light(ridge.folder / "light.exr").radiance
    assert radiance.min() < -0.01 * radiance.max()
    assert read_light(ridge.folder / "light.hdr").radiance.min() == 0
    assert (radiance[:, 128:] == 0).all()
    assert (ridge.result["method"], ridge.result["solver"], ridge.result["coefficients"]) == ("sh", "ridge", 9)


def test_harmonics_by_nnls_are_nowhere_negative_at_texels(tmp_path: Path, shared: Path) -> None:
    made = make(tmp_path, shared, "--method", "sh", "--degree", 4)
    radiance = SphericalHarmonics(4, 4).synthesis(made.tensors["coefficients"].double())
    assert radiance.min() >= -1e-5 * radiance.max()
    assert made.result["solver"] == "nnls"
    assert made.result["status"] == ["converged"] * 3


def test_haar_and_texels_tell_the_same_story(tmp_path: Path, shared: Path, made: Made) -> None:
    haar = make(tmp_path, shared, "--basis", "haar")
    assert haar.result["method"] == "haar"
    assert_close(haar.result["rms_255"], made.result["rms_255"], rtol=1e-4, atol=0)
    assert_close(haar.result["peak_direction"], made.result["peak_direction"], rtol=0, atol=1e-4)
    assert haar.result["nonnegative"] is True


def test_albedo_makes_the_light_radiance_times_exposure(tmp_path: Path, made: Made) -> None:
    scene = scene_file(tmp_path, CHANGED("samples: [16, 16]", "samples: [16, 16], albedo: 0.5"))
    assert estimate(scene, png(tmp_path / "block.png"), out=tmp_path / "out").code == 0
    result = strict_json(tmp_path / "out/block/result.json")
    assert (result["units"], result["light_is"]) == ("relative", "radiance x exposure")
    ours = load_file(tmp_path / "out/block/estimate.safetensors")["coefficients"]
    assert_close(ours, 2 * made.tensors["coefficients"], rtol=1e-3, atol=1e-3)


def test_some_nan_pixels_cost_their_samples_only(tmp_path: Path, made: Made) -> None:
    image = torch.full((3, 16, 16), 0.5)
    image[1, 0, 3] = math.nan  # row 0 is the largest y
    ran = estimate(scene_file(tmp_path), exr(tmp_path / "nan.exr", image), out=tmp_path / "out")
    assert ran.code == 0
    weights = load_file(tmp_path / "out/nan/estimate.safetensors")["weights"]
    lost = torch.nonzero(weights != made.tensors["weights"])
    assert lost.tolist() == [[15 * 16 + 3]]


# --- where results go ----------------------------------------------------------------------------------------------


def test_existing_results_need_overwrite(tmp_path: Path) -> None:
    scene, photo, out = scene_file(tmp_path), png(tmp_path / "a.png"), tmp_path / "out"
    assert estimate(scene, photo, out=out).code == 0
    before = (out / "a/result.json").stat().st_mtime_ns
    again = estimate(scene, photo, out=out)
    assert again.code == 2
    assert "--overwrite" in again.line
    assert str(out / "a") in again.line
    assert (out / "a/result.json").stat().st_mtime_ns == before
    assert estimate(scene, photo, out=out, options=("--overwrite", "--method", "haar")).code == 0
    assert strict_json(out / "a/result.json")["method"] == "haar"
    assert [path.name for path in out.iterdir()] == ["a"]


def test_overwrite_leaves_folders_that_are_no_results(tmp_path: Path) -> None:
    out = tmp_path / "out"
    (out / "a").mkdir(parents=True)
    (out / "a/thesis.tex").write_text("years of work")
    ran = estimate(scene_file(tmp_path), png(tmp_path / "a.png"), out=out, options=("--overwrite",))
    assert ran.code == 2
    assert str(out / "a") in ran.line
    assert contents(out) == ["a", "a/thesis.tex"]


@pytest.mark.parametrize("names", [("a/x.png", "b/x.png"), ("a/x.png", "a/x.jpg"), ("x.png", "x.png")])
def test_colliding_stems_are_refused_before_anything_is_read(tmp_path: Path, names: tuple[str, str]) -> None:
    ran = estimate(tmp_path / "none.yaml", *(tmp_path / name for name in names), out=tmp_path / "out")
    assert ran.code == 2
    assert all(str(tmp_path / name) in ran.line for name in names)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["..png", "...png"])
def test_a_photograph_cannot_name_the_output_folder_itself(tmp_path: Path, name: str) -> None:
    ran = estimate(scene_file(tmp_path), png(tmp_path / name), out=tmp_path / "out", options=("--overwrite",))
    assert ran.code == 2
    assert name in ran.line


@pytest.mark.parametrize("out", ["file", "file/below", "dangling"])
def test_an_output_folder_that_cannot_be_is_refused_before_work(tmp_path: Path, out: str) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere")
    ran = estimate(tmp_path / "none.yaml", tmp_path / "a.png", out=tmp_path / out)
    assert ran.code == 2
    assert str(tmp_path / out) in ran.line


def test_an_unwritable_place_is_refused_before_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.access", lambda place, mode: False)
    ran = estimate(scene_file(tmp_path), png(tmp_path / "a.png"), out=tmp_path / "new/out")
    assert ran.code == 2
    assert "permission" in ran.line
    assert not (tmp_path / "new").exists()


def test_odd_names_are_only_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    scene_file(tmp_path, CHANGED("units: mm", "units: '$\\frac'"), "my scene.yaml")
    names = ("日本 1.png", "a$b$\\frac.png", ".hidden.png", "x.y.png")
    photos = [png(tmp_path / name).relative_to(tmp_path) for name in names]
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "real")
    ran = estimate(Path("my scene.yaml"), *photos, out=Path("link/../link/new"))
    assert (ran.code, ran.err) == (0, "")
    assert {path.name for path in (tmp_path / "real/new").iterdir()} == {Path(name).stem for name in names}


# --- when things go wrong -----------------------------------------------------------------------------------------


def test_one_bad_photograph_leaves_the_others_complete(tmp_path: Path) -> None:
    good = [png(tmp_path / "a.png"), png(tmp_path / "c.png", 0.5 * torch.ones(3, 16, 16))]
    ran = estimate(scene_file(tmp_path), good[0], tmp_path / "b.png", good[1], out=tmp_path / "out")
    assert ran.code == 1
    first, last = ran.err.splitlines()
    assert first == f"torchlight: {tmp_path / 'b.png'}: no such file; check the name and the folder"
    assert last == f"torchlight: 1 of 3 photographs failed; the others are complete in {tmp_path / 'out'}"
    expected = [name for stem in "ac" for name in (stem, *(f"{stem}/{file}" for file in FILES))]
    assert contents(tmp_path / "out") == expected


def test_a_photograph_in_a_batch_gives_what_it_gives_alone(tmp_path: Path, made: Made) -> None:
    photos = [png(tmp_path / "block.png"), png(tmp_path / "grey.png", 0.5 * torch.ones(3, 16, 16))]
    assert estimate(scene_file(tmp_path), *photos, out=tmp_path / "out").code == 0
    together = strict_json(tmp_path / "out/block/result.json")
    assert_close(together["rms_255"], made.result["rms_255"], rtol=1e-5, atol=0)
    assert together["nonzero"] == made.result["nonzero"]


def test_ctrl_c_keeps_finished_photographs_and_nothing_half(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write, calls = results.write_atomically, []

    def interrupted(path: Path, data: bytes) -> None:
        calls.append(path)
        if len(calls) == 6:  # a's folder takes five calls and the JSON files; this is inside b's
            raise KeyboardInterrupt
        write(path, data)

    monkeypatch.setattr(results, "write_json", lambda path, content: path.write_text(json.dumps(content)))
    monkeypatch.setattr(results, "write_atomically", interrupted)
    photos = [png(tmp_path / f"{stem}.png") for stem in "abc"]
    ran = estimate(scene_file(tmp_path), *photos, out=tmp_path / "out")
    assert ran.code == 130
    assert "interrupted" in ran.line
    assert calls[5].parent.name.startswith(".b.partial-")
    assert contents(tmp_path / "out") == ["a", *(f"a/{name}" for name in FILES)]


def test_ctrl_c_while_casting_rays_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*arguments: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setenv("TORCHLIGHT_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(precomputation, "transport", interrupted)
    ran = estimate(scene_file(tmp_path), png(tmp_path / "a.png"), out=tmp_path / "out")
    assert ran.code == 130
    assert "interrupted" in ran.line
    assert contents(tmp_path) == ["a.png", "scene.yaml"]


def full_disk(*arguments: object) -> None:
    raise OSError(28, "No space left on device")


def test_a_full_disk_leaves_no_half_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    photo = png(tmp_path / "a.png")
    assert estimate(scene_file(tmp_path), photo, out=tmp_path / "before").code == 0  # the transport is cached
    monkeypatch.setattr("os.fsync", full_disk)
    ran = estimate(scene_file(tmp_path), photo, out=tmp_path / "out")
    assert ran.code == 1
    assert "the disk is full" in ran.line
    assert "a.png" in ran.line
    assert contents(tmp_path / "out") == []


@pytest.mark.parametrize("file", ["estimate.safetensors", "result.json", "fit.png"])
def test_a_disk_that_fills_late_leaves_no_half_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, file: str
) -> None:
    photo = png(tmp_path / "a.png")
    assert estimate(scene_file(tmp_path), photo, out=tmp_path / "before").code == 0  # the transport is cached
    write_bytes = Path.write_bytes

    def limited(self: Path, data: bytes) -> int:
        return write_bytes(self, data) if file not in self.name else full_disk() or 0

    monkeypatch.setattr(Path, "write_bytes", limited)
    ran = estimate(scene_file(tmp_path), photo, out=tmp_path / "out")
    assert ran.code == 1
    assert "the disk is full" in ran.line
    assert contents(tmp_path / "out") == []


@pytest.mark.parametrize("setting", [("TORCHLIGHT_CACHE", "scene.yaml"), ("TORCHLIGHT_CACHE_LIMIT", "100")])
def test_a_cache_that_cannot_be_costs_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, setting: tuple[str, str]
) -> None:
    name, value = setting
    monkeypatch.setenv("TORCHLIGHT_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv(name, str(tmp_path / value) if name == "TORCHLIGHT_CACHE" else value)
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        ran = estimate(scene_file(tmp_path), png(tmp_path / "a.png"), out=tmp_path / "out")
    assert ran.code == 0
    assert ran.line.startswith("torchlight: warning: not cached: ")
    assert name in ran.line


def test_the_second_call_casts_no_ray(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TORCHLIGHT_CACHE", str(tmp_path / "cache"))
    scene, photo = scene_file(tmp_path), png(tmp_path / "a.png")
    assert estimate(scene, photo, out=tmp_path / "one", options=("--no-cache",)).code == 0
    assert entries() == ()
    assert estimate(scene, photo, out=tmp_path / "two").code == 0
    assert len(entries()) == 1
    monkeypatch.setattr(precomputation, "transport", full_disk)
    assert estimate(scene, photo, out=tmp_path / "three").code == 0
    first, third = (load_file(tmp_path / f"{name}/a/estimate.safetensors")["coefficients"] for name in ("one", "three"))
    assert torch.equal(first, third)


# --- bad input: one line that names the file or key, exit 2, no folder --------------------------------------------


def truncated(path: Path, share: float = 0.6) -> Path:
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    return path


def jpeg(path: Path) -> Path:
    noise = np.random.default_rng(0).integers(0, 255, (64, 64, 3), dtype=np.uint8)
    assert cv2.imwrite(str(path), noise)
    return path


def corrupt(path: Path) -> Path:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(bytes(data))
    return path


def written(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


BAD_PHOTOS: dict[str, tuple[Callable[[Path], Path], str]] = {
    "missing": (lambda folder: folder / "p.png", "p.png: no such file"),
    "a folder": (lambda folder: folder, "expected a file, got a folder"),
    "a device": (lambda folder: Path("/dev/zero"), "/dev/zero: not a regular file"),
    "empty": (lambda folder: written(folder / "p.png", b""), "p.png: the file is empty"),
    "truncated PNG": (lambda folder: truncated(png(folder / "p.png")), "p.png: truncated or corrupt PNG"),
    "truncated JPEG": (lambda folder: truncated(jpeg(folder / "p.jpg")), "p.jpg: truncated or corrupt JPEG"),
    "corrupt PNG": (lambda folder: corrupt(png(folder / "p.png")), "p.png: truncated or corrupt PNG"),
    "text named .png": (lambda folder: written(folder / "p.png", b"a picture of a pencil"), "p.png: its content is"),
    "truncated EXR": (lambda folder: truncated(exr(folder / "p.exr")), "p.exr"),
    "black": (lambda folder: png(folder / "p.png", torch.zeros(3, 16, 16)), "p.png: the photograph is black"),
    "all NaN": (lambda folder: exr(folder / "p.exr", torch.full((3, 16, 16), math.nan)), "p.exr: no sample"),
    "saturated": (lambda folder: png(folder / "p.png", torch.ones(3, 16, 16)), "p.png: no sample"),
}


@pytest.mark.parametrize("case", BAD_PHOTOS)
def test_bad_photographs(tmp_path: Path, case: str) -> None:
    build, says = BAD_PHOTOS[case]
    ran = estimate(scene_file(tmp_path), build(tmp_path), out=tmp_path / "out")
    assert ran.code == 2
    assert says in ran.line
    assert not (tmp_path / "out").exists()


def mesh(content: bytes) -> Callable[[Path], str]:
    def build(folder: Path) -> str:
        (folder / "m.ply").write_bytes(content)
        return CHANGED("box: [1, 0.6, 1.2]", "mesh: m.ply")

    return build


def mask(image: np.ndarray, scene: str) -> Callable[[Path], str]:
    def build(folder: Path) -> str:
        assert cv2.imwrite(str(folder / "mask.png"), image)
        return scene + "mask: mask.png\n"

    return build


def fixed(text: str) -> Callable[[Path], str]:
    return lambda folder: text


PLY = b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
FACE = b"element face 1\nproperty list uchar int vertex_indices\nend_header\n"


class Code:
    """What a pickle may hold: a call that unpickling makes."""

    def __reduce__(self) -> tuple[object, ...]:
        return exec, ("raise RuntimeError('the pickle was executed')",)


PICKLE = pickle.dumps(Code())
SEEN = RECTIFIED + CAMERA

BAD_SCENES: dict[str, tuple[Callable[[Path], str], str]] = {
    "no encoding": (fixed(CHANGED(LINEAR, "")), "photo.encoding: missing"),
    "wrong size": (fixed(SEEN), "camera.image_size"),
    "camera looks away": (fixed(SEEN.replace("-0.8137334712067350, 7", "-0.8137334712067350, -7")), "camera sees no"),
    "camera looks elsewhere": (fixed(SEEN.replace("[1, 0, 0, 0]", "[1, 0, 0, 900]")), "camera sees no"),
    "no faces": (mesh(PLY.replace(b"3", b"0") + FACE.replace(b"1", b"0", 1)), "m.ply"),
    "NaN vertices": (mesh(PLY + FACE + b"0 0 1\n1 nan 1\n0 1 1\n3 0 1 2\n"), "m.ply: some vertices are NaN"),
    "a pickle": (mesh(PICKLE), "m.ply"),
    "a pickle after a header": (mesh(PLY + FACE + PICKLE), "m.ply"),
    "no mesh": (fixed(CHANGED("box: [1, 0.6, 1.2]", "mesh: none.ply")), "none.ply: no such file"),
    "YAML tags": (fixed("!!python/object/apply:os.system ['true']\n"), "the tag"),
    "not YAML": (fixed("units: [mm\noccluders: }\n"), "not valid YAML"),
    "not a scene": (fixed("just words\n"), "scene.yaml"),
    "only a comment": (fixed("# nothing\n"), "scene.yaml: the file holds no scene"),
    "empty": (fixed(""), "scene.yaml: the file is empty"),
    "unknown key": (fixed(RECTIFIED + "colour: red\n"), "colour"),
    "NaN in K": (fixed(SEEN.replace("[[102,", "[[.nan,")), "camera.K"),
    "everything masked": (mask(np.zeros((16, 16), np.uint8), RECTIFIED), "mask"),
    "everything masked, camera": (mask(np.zeros((72, 96), np.uint8), SEEN), "mask"),
    "mask of another size": (mask(np.full((16, 16), 255, np.uint8), SEEN), "mask"),
    "too many samples": (fixed(CHANGED("[16, 16]", "[1000000, 1000000]")), "receiver.samples"),
    "no samples": (fixed(CHANGED("[16, 16]", "[0, 16]")), "receiver.samples"),
    "receiver too small": (fixed(CHANGED("[16, 16]", "[2, 2]")), "no sample of the receiver"),
}


@pytest.mark.parametrize("case", BAD_SCENES)
def test_bad_scenes(tmp_path: Path, case: str) -> None:
    build, says = BAD_SCENES[case]
    ran = estimate(scene_file(tmp_path, build(tmp_path)), png(tmp_path / "p.png"), out=tmp_path / "out")
    assert ran.code == 2
    assert says in ran.line
    assert not (tmp_path / "out").exists()


def test_a_transport_beyond_the_budget_is_refused_before_any_ray(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("torchlight.batch.scenes.visible_part", full_disk)
    scene = scene_file(tmp_path, CHANGED("[16, 16]", "[1000, 1000]"))
    ran = run(
        "estimate", scene, png(tmp_path / "p.png"), "--out", tmp_path / "out", "--method", "texels", "--resolution", 32
    )
    assert ran.code == 2
    assert "receiver.samples" in ran.line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--resolution", 3), "resolution"),
        (("--resolution", 0), "resolution"),
        (("--resolution", -1), "resolution"),
        (("--resolution", 1024), "resolution"),
        (("--method", "adaptive", "--resolution", 1), "resolution"),
        (("--method", "sh", "--resolution", 0), "resolution"),
        (("--method", "haar", "--resolution", 1), "resolution"),
        (("--method", "sh", "--degree", -1), "degree"),
        (("--method", "sh", "--degree", 100), "degree"),
        (("--method", "sh", "--solver", "adam"), "--solver adam"),
        (("--device", "cuda"), "--device cuda"),
    ],
)
def test_bad_options(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: tuple[object, ...], says: str) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    ran = estimate(scene_file(tmp_path), png(tmp_path / "p.png"), out=tmp_path / "out", options=options)
    assert ran.code == 2
    assert says in ran.line
    assert not (tmp_path / "out").exists()


def test_no_photograph(tmp_path: Path) -> None:
    ran = estimate(scene_file(tmp_path), out=tmp_path / "out")
    assert ran.code == 2
    assert "no photograph" in ran.line


@pytest.mark.parametrize(
    "options", [("--resolution", 1), ("--resolution", 2, "--method", "haar"), ("--solver", "adam")]
)
def test_small_and_approximate_methods_work(tmp_path: Path, options: tuple[object, ...]) -> None:
    ran = estimate(scene_file(tmp_path), png(tmp_path / "p.png"), out=tmp_path / "out", options=options)
    assert ran.code == 0
    assert (tmp_path / "out/p/light.exr").is_file()


@pytest.mark.parametrize(("samples", "pixels"), [("1, 1", 1), ("1, 16", 5), ("16, 16", 1), ("16, 16", 33)])
def test_tiny_receivers_and_photographs_work(tmp_path: Path, samples: str, pixels: int) -> None:
    scene = scene_file(tmp_path, CHANGED("[16, 16]", f"[{samples}]").replace("[1, 0.6, 1.2]", "[0.1, 0.1, 0.5]"))
    photo = png(tmp_path / "p.png", torch.full((3, pixels, pixels), 0.5))
    assert estimate(scene, photo, out=tmp_path / "out").code == 0


# --- the real command ----------------------------------------------------------------------------------------------


def test_the_installed_command_says_one_line_and_exits_2(tmp_path: Path) -> None:
    command = Path(sys.executable).with_name("torchlight")
    call = [command, "estimate", tmp_path / "none.yaml", tmp_path / "p.png", "--out", tmp_path / "out"]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr == f"torchlight: {tmp_path / 'none.yaml'}: no such file; check the name and the folder\n"
    assert done.stdout == ""
    assert list(tmp_path.iterdir()) == []


def test_the_block_of_the_tests_is_the_block_of_the_scene(tmp_path: Path) -> None:
    triangles = load_scene(scene_file(tmp_path)).triangles.reshape(-1, 3)
    turn = math.radians(BLOCK.rotation_degrees)
    local = (
        triangles[:, :2] @ torch.tensor([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]]).double()
    )
    assert_close(local.abs().amax(dim=0), torch.tensor([0.5, 0.3], dtype=torch.float64))
    assert triangles[:, 2].max() == 1.2


def test_a_photograph_of_another_pose_is_said_to_be_badly_explained(tmp_path: Path) -> None:
    scene_file(tmp_path, RECTIFIED.replace("[0, 0, 20]", "[0, 0, 75]"))
    ran = run("estimate", tmp_path / "scene.yaml", png(tmp_path / "photo.png"), "--out", tmp_path / "out")
    assert ran.code == 0
    assert "no light explains the photograph well (RMS" in ran.err
    said = json.loads((tmp_path / "out/photo/result.json").read_text())
    assert any("is it this scene's?" in line for line in said["warnings"])
    assert said["rms_255"] > 5


def test_a_photograph_of_another_shape_is_said_to_be_stretched(tmp_path: Path) -> None:
    scene_file(tmp_path)
    picture = cv2.imread(str(png(tmp_path / "photo.png")), cv2.IMREAD_COLOR)
    assert picture is not None
    for name, width in (("wide.png", 48), ("square.png", 20)):
        cv2.imwrite(str(tmp_path / name), cv2.resize(picture, (width, 16)))
    ran = run(
        "estimate", tmp_path / "scene.yaml", tmp_path / "wide.png", tmp_path / "square.png", "--out", tmp_path / "out"
    )
    assert ran.code == 0
    assert f"{tmp_path / 'wide.png'}: 48 x 16 pixels are spread over a receiver of 4 x 4" in ran.err
    assert "square.png: 20" not in ran.err
