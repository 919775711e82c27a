"""References and encodings through the scene file: what the receiver shows is found again whatever multiplies it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.testing import assert_close
from workbench import BOX, CAMERA, RECTIFIED, contents, exr, scene_file, shadow
from workbench import torchlight as run

from torchlight.errors import CalibrationError, ConfigError, FormatError
from torchlight.io.exr import write_exr
from torchlight.io.images import read_photo, write_png
from torchlight.io.response_file import write_response
from torchlight.io.scene_file import load_scene
from torchlight.observing import linearize, observe
from torchlight.photo.observation import linear_photo
from torchlight.photo.radiometry import Response, encode
from torchlight.results import light_is


def blotches(rows: int = 16) -> Tensor:
    generator = torch.Generator().manual_seed(5)
    return 0.3 + 0.7 * torch.rand(3, rows, rows, generator=generator)


def scene_with(folder: Path, text: str) -> Path:
    return scene_file(folder, RECTIFIED + text + "\n")


def level(samples: Tensor, weights: Tensor) -> Tensor:
    kept = samples[:, weights > 0].double()
    return kept / kept.mean(dim=-1, keepdim=True)


def plain(folder: Path) -> Tensor:
    """What the photograph shows without any factor, relative to its mean."""
    found = observe(linear_photo(shadow()), load_scene(scene_file(folder, RECTIFIED, "plain.yaml")))
    return level(found.samples, found.weights)


def test_photo_removes_albedo_and_vignetting_exactly(tmp_path: Path) -> None:
    exr(tmp_path / "empty.exr", 5 * blotches())
    scene = load_scene(scene_with(tmp_path, "reference: {method: photo, photo: empty.exr}"))
    found = observe(linear_photo(blotches() * shadow()), scene)
    assert_close(level(found.samples, found.weights), plain(tmp_path), rtol=1e-5, atol=0)


@pytest.mark.parametrize("rows", [16, 64])
def test_albedo_map_is_divided_out_and_makes_the_light_absolute(tmp_path: Path, rows: int) -> None:
    write_exr(tmp_path / "albedo.exr", blotches().repeat_interleave(rows // 16, 1).repeat_interleave(rows // 16, 2), {})
    scene = load_scene(scene_with(tmp_path, "reference: {method: albedo, albedo: albedo.exr}"))
    found = observe(linear_photo(blotches() * shadow()), scene)
    bare = observe(linear_photo(shadow()), load_scene(scene_file(tmp_path, RECTIFIED, "plain.yaml")))
    assert_close(found.samples, bare.samples, rtol=1e-5, atol=1e-7)
    assert_close(found.weights, bare.weights)
    assert light_is(scene) == "radiance x exposure"


def test_albedo_and_smooth(tmp_path: Path) -> None:
    rectified = RECTIFIED.replace("[16, 16]", "[32, 32]").replace("[1, 0.6, 1.2]", "[0.1, 0.1, 0.1]")
    x, y = torch.meshgrid(*[torch.linspace(-1, 1, 32)] * 2, indexing="xy")
    falloff = (0.3 * x - 0.2 * y * y).exp().expand(3, -1, -1)
    write_exr(tmp_path / "albedo.exr", blotches(32), {})
    text = "reference: {method: smooth, albedo: albedo.exr}\n"
    found = observe(linear_photo(blotches(32) * falloff), load_scene(scene_file(tmp_path, rectified + text)))
    kept = found.samples[:, found.weights > 0]
    assert_close(kept / kept.mean(dim=-1, keepdim=True), torch.ones_like(kept), rtol=1e-4, atol=0)


def test_unknown_albedo_is_left_out(tmp_path: Path) -> None:
    albedo = blotches()
    albedo[:, 0, 0] = 0
    write_exr(tmp_path / "albedo.exr", albedo, {})
    scene = load_scene(scene_with(tmp_path, "reference: {method: albedo, albedo: albedo.exr}"))
    found = observe(linear_photo(blotches() * shadow()), scene)
    assert found.weights.reshape(16, 16)[-1, 0] == 0  # row 0 of a picture is the largest y
    assert found.samples.isfinite().all()


def shifted(columns: int) -> Tensor:
    return 0.2 + 0.8 * (torch.arange(16) // 4 != columns).float().expand(3, 16, 16)


def test_stack_from_listed_photographs_and_from_those_of_the_call(tmp_path: Path) -> None:
    photos = [exr(tmp_path / f"{index}.exr", blotches() * shifted(index) * (1 + index)) for index in range(4)]
    small = RECTIFIED.replace("[1, 0.6, 1.2]", "[0.1, 0.1, 0.1]")
    listed = "reference: {method: stack, photos: [0.exr, 1.exr, 2.exr, 3.exr]}\n"
    named = observe(read_linear(photos[0]), load_scene(scene_file(tmp_path, small + listed, "listed.yaml")))
    bare = scene_file(tmp_path, small + "reference: stack\n", "bare.yaml")
    batch = torch.stack([read_photo(photo).pixels for photo in photos])
    together = observe(linear_photo(batch), load_scene(bare))
    expected = torch.where(shifted(0)[0].flip(0).flatten()[named.weights > 0] > 0.5, 1.0, 0.2)
    for samples, weights in ((named.samples, named.weights), (together.samples[0], together.weights[0])):
        kept = samples[:, weights > 0]
        assert_close(kept / kept.amax(dim=-1, keepdim=True), expected.expand_as(kept), rtol=1e-5, atol=0)
    ran = run(
        "estimate", bare, *photos, "--out", tmp_path / "out", "--no-cache", "--method", "texels", "--resolution", 4
    )
    assert ran.code == 0
    assert len([name for name in contents(tmp_path / "out") if name.endswith("result.json")]) == 4


def read_linear(path: Path):
    return linear_photo(read_photo(path).pixels)


def test_stack_of_too_few(tmp_path: Path) -> None:
    photos = [exr(tmp_path / f"{index}.exr") for index in range(2)]
    ran = run("estimate", scene_with(tmp_path, "reference: stack"), *photos, "--out", tmp_path / "out", "--no-cache")
    assert ran.code == 2
    assert "stack needs at least 3 photographs" in ran.line
    with pytest.raises(ConfigError, match="stack needs at least 3"):
        observe(read_linear(photos[0]), load_scene(scene_with(tmp_path, "reference: stack")))


def test_a_reference_of_another_size(tmp_path: Path) -> None:
    exr(tmp_path / "empty.exr", blotches())
    scene = scene_file(tmp_path, RECTIFIED + CAMERA + "reference: {method: photo, photo: empty.exr}\n")
    with pytest.raises(CalibrationError, match=r"empty\.exr: the photograph has 16 x 16 pixels") as error:
        observe(linear_photo(torch.rand(3, 72, 96)), load_scene(scene))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("encoding", ["gamma", "response"])
def test_encodings_of_the_scene_file(tmp_path: Path, encoding: str) -> None:
    codes = torch.linspace(0, 1, 256, dtype=torch.float64)
    write_response(tmp_path / "r.json", Response((codes**1.8).expand(3, -1)))
    text = {"gamma": "{encoding: gamma, gamma: 1.8}", "response": "{encoding: response, response: r.json}"}[encoding]
    scene = load_scene(scene_file(tmp_path, RECTIFIED.replace("{encoding: linear}", text)))
    pixels = (encode(shadow().clamp(0, 0.99), "gamma", 1.8) * 255).round()
    write_png(tmp_path / "p.png", pixels.byte().permute(1, 2, 0).contiguous().numpy())
    found = linearize(read_photo(tmp_path / "p.png"), scene)
    assert_close(found.radiance, (pixels / 255) ** 1.8, rtol=1e-5, atol=1e-6)


def test_a_bare_word_is_the_encoding(tmp_path: Path) -> None:
    assert load_scene(scene_file(tmp_path, RECTIFIED.replace("{encoding: linear}", "srgb"))).encoding == "srgb"


BAD = {
    "photo: {encoding: srgb, gamma: 2}": "photo.gamma: counts with 'encoding: gamma' only",
    "photo: {encoding: gamma, gamma: 0}": "photo.gamma: expected a number above 0",
    "photo: {encoding: response}": "photo.response: missing; for example",
    "photo: {encoding: response, response: none.json}": "none.json: no such file",
    "photo: {encoding: response, response: bad.json}": "not a camera response: expected JSON with red, green and blue",
    "reference: {photo: empty.exr}": "reference.method: missing; for example",
    "reference: photo": "reference.photo: missing; for example",
    "reference: albedo": "reference.albedo: missing; for example",
    "reference: {method: photo, photo: none.exr}": "reference.photo: ",
    "reference: {method: uniform, albedo: empty.exr}": "reference.albedo: counts with 'method: smooth or albedo' only",
    "reference: {method: photo, photo: empty.exr, albedo: empty.exr}": "reference.albedo: counts with",
    "reference: {method: albedo, albedo: black.png}": "reference.albedo: expected albedos in (0, 1]",
    "reference: {method: stack, photos: empty.exr}": "reference.photos: expected a list of at least three photographs",
}


@pytest.mark.parametrize("text", BAD)
def test_bad_keys_are_one_clear_line(tmp_path: Path, text: str) -> None:
    exr(tmp_path / "empty.exr")
    (tmp_path / "bad.json").write_text("[1, 2]")
    write_png(tmp_path / "black.png", np.zeros((4, 4, 3), dtype=np.uint8))
    path = scene_file(tmp_path, BOX + "receiver: {size: [4, 4], samples: [16, 16]}\n" + text + "\n")
    with pytest.raises((ConfigError, FormatError)) as error:
        load_scene(path)
    assert str(error.value).startswith(f"{path}: ")
    assert BAD[text] in str(error.value)
    assert "\n" not in str(error.value)


def test_albedo_twice_is_an_error(tmp_path: Path) -> None:
    write_exr(tmp_path / "albedo.exr", blotches(), {})
    text = RECTIFIED.replace("[16, 16]", "[16, 16], albedo: 0.5") + "reference: {method: albedo, albedo: albedo.exr}\n"
    with pytest.raises(ConfigError, match=r"reference\.albedo: receiver\.albedo is given too; keep one of them"):
        load_scene(scene_file(tmp_path, text))
