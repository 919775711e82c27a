"""`torchlight merge`: brackets of a known scene, and every way in which they cannot be merged."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from cameras import exif_block, exposure_entries, jpeg_with
from realdata import data_path
from torch import Tensor
from torch.testing import assert_close
from workbench import contents
from workbench import torchlight as run

from torchlight.io.exr import read_exr, write_exr
from torchlight.io.images import read_photo, write_png
from torchlight.io.response_file import read_response

TIMES = (8.0, 1.0, 0.125, 1 / 64)
STATED = ("--times", "8,1,1/8,1/64")


def radiance() -> Tensor:
    """A smooth picture over 12 stops."""
    x = torch.linspace(-3, 3, 80).expand(60, -1)
    y = torch.linspace(-2, 2, 60)[:, None]
    return torch.stack([(x + 0.4 * y + 0.3 * (5 * x * y).sin() - 0.5 * channel).exp() for channel in range(3)])


def bracket(folder: Path, gamma: float = 2.2, times: tuple[float, ...] = TIMES) -> list[Path]:
    files = []
    for index, time in enumerate(times):
        values = (0.1 * radiance() * time).clamp(0, 1) ** (1 / gamma)
        files.append(folder / f"p{index}.png")
        write_png(files[-1], (values * 255).round().byte().permute(1, 2, 0).contiguous().numpy())
    return files


def log_error(found: Tensor, truth: Tensor, usable: Tensor) -> Tensor:
    difference = (found / truth).log()[:, usable]
    return (difference - difference.median(dim=1, keepdim=True).values).abs()


@pytest.mark.parametrize(("response", "most"), [("gamma:2.2", 0.02), ("estimate", 0.05)])
def test_a_known_scene(tmp_path: Path, response: str, most: float) -> None:
    ran = run("merge", *bracket(tmp_path), "--out", tmp_path / "h.exr", "--response", response, *STATED)
    assert (ran.code, ran.err) == (0, "")
    found, metadata = read_exr(tmp_path / "h.exr")
    mask = cv2.imread(str(tmp_path / "h_mask.png"), cv2.IMREAD_UNCHANGED)
    assert mask is not None
    usable = torch.from_numpy(mask > 0)
    assert float(usable.float().mean()) > 0.95
    assert float(log_error(found, radiance(), usable).quantile(0.95)) < most
    assert metadata["exposures"] == list(TIMES)
    assert "4 photographs over 9.0 stops" in ran.out


def test_an_estimated_response_is_kept_and_serves_again(tmp_path: Path) -> None:
    files = bracket(tmp_path)
    assert run("merge", *files, "--out", tmp_path / "a.exr", "--response", "estimate", *STATED).code == 0
    kept = tmp_path / "a_response.json"
    assert read_response(kept).exposure.shape == (3, 256)
    assert run("merge", *files, "--out", tmp_path / "b.exr", "--response", kept, *STATED).code == 0
    assert_close(read_exr(tmp_path / "a.exr")[0], read_exr(tmp_path / "b.exr")[0], rtol=1e-6, atol=0)
    assert "b_response.json" not in contents(tmp_path)


def test_linear_files_need_no_response(tmp_path: Path) -> None:
    for index, time in enumerate((1.0, 4.0)):
        write_exr(tmp_path / f"{index}.exr", 0.1 * radiance() * time, {})
    files = (tmp_path / "0.exr", tmp_path / "1.exr")
    assert run("merge", *files, "--out", tmp_path / "h.exr", "--times", "1,4").code == 0
    assert_close(read_exr(tmp_path / "h.exr")[0], 0.1 * radiance(), rtol=1e-5, atol=0)


def with_exif(folder: Path, *, iso: tuple[int | None, ...] = (100, 100), time: tuple[int, ...] = (4, 32)) -> list[Path]:
    files = []
    for index, (speed, below) in enumerate(zip(iso, time, strict=True)):
        values = ((0.1 * radiance() * 4 / below * (speed or 100) / 100).clamp(0, 1) ** (1 / 2.2) * 255).round().byte()
        jpeg = cv2.imencode(".jpg", np.ascontiguousarray(values.permute(1, 2, 0).numpy()[..., ::-1]))[1].tobytes()
        files.append(folder / f"e{index}.jpg")
        entries = exposure_entries((1, below), (28, 10) if speed else None, speed)
        files[-1].write_bytes(jpeg_with(jpeg, exif_block(entries)))
    return files


@pytest.mark.parametrize(("iso", "time"), [((100, 100), (4, 32)), ((800, 100), (32, 32)), ((400, 100), (16, 32))])
def test_exposures_from_exif(tmp_path: Path, iso: tuple[int, int], time: tuple[int, int]) -> None:
    files = with_exif(tmp_path, iso=iso, time=time)
    ran = run("merge", *files, "--out", tmp_path / "h.exr", "--response", "gamma:2.2")
    assert (ran.code, ran.err) == (0, "")
    expected = [speed / 100 / below / 2.8**2 for speed, below in zip(iso, time, strict=True)]
    assert read_exr(tmp_path / "h.exr")[1]["exposures"] == pytest.approx(expected)


def test_what_exif_lacks_is_said(tmp_path: Path) -> None:
    files = with_exif(tmp_path, iso=(None, None))
    ran = run("merge", *files, "--out", tmp_path / "h.exr", "--response", "gamma:2.2")
    assert ran.code == 0
    assert "EXIF records no aperture and no ISO; taken as the same" in ran.line


def test_a_wrong_response_and_a_wrong_time_are_noticed(tmp_path: Path) -> None:
    files = bracket(tmp_path)
    for name, options in {
        "a": ("--response", "linear", *STATED),
        "b": ("--response", "gamma:2.2", "--times", "8,1,1/8,1/2"),
    }.items():
        ran = run("merge", *files, "--out", tmp_path / f"{name}.exr", *options)
        assert ran.code == 0
        assert "times the stated exposure; is --response right?" in ran.err


def moved(folder: Path) -> list[Path]:
    files = bracket(folder)
    pixels = read_photo(files[1]).pixels.roll((0, 5), dims=(1, 2))
    write_png(files[1], (pixels * 255).round().byte().permute(1, 2, 0).contiguous().numpy())
    return files


def another_size(folder: Path) -> list[Path]:
    files = bracket(folder)
    write_png(files[2], np.zeros((61, 80, 3), dtype=np.uint8))
    return files


def another_depth(folder: Path) -> list[Path]:
    files = bracket(folder)
    write_png(files[2], np.zeros((60, 80, 3), dtype=np.uint16))
    return files


def not_a_response(folder: Path) -> list[Path]:
    (folder / "r.json").write_text('{"red": [1, 2], "green": [1, 2], "blue": [2, 1]}')
    return bracket(folder)


GAMMA = ("--response", "gamma:2.2")
REFUSED = {
    "one photograph": (lambda f: bracket(f)[:1], (*GAMMA, *STATED), "at least two photographs"),
    "no times": (bracket, GAMMA, "p0.png: its EXIF records no exposure time; pass --times"),
    "too few times": (bracket, (*GAMMA, "--times", "1,2"), "--times: 2 times for 4 photographs"),
    "no time": (
        bracket,
        (*GAMMA, "--times", "1,2,fast,3"),
        "--times: expected seconds such as 0.5 or 1/30, got 'fast'",
    ),
    "by zero": (bracket, (*GAMMA, "--times", "1,2,1/0,3"), "got '1/0'"),
    "half an exposure": (lambda f: with_exif(f, iso=(100, None)), GAMMA, "ISO and aperture: recorded by only one of"),
    "no response": (bracket, STATED, "--response: missing, and 8-bit photographs do not say"),
    "no gamma": (bracket, ("--response", "gamma:much", *STATED), "expected gamma:NUMBER"),
    "no file": (bracket, ("--response", "none.json", *STATED), "none.json: no such file"),
    "falling": (not_a_response, ("--response", "r.json", *STATED), "rise from every code to the next"),
    "moved": (moved, (*GAMMA, *STATED), "p1.png: moved by 5, 0 pixels (x, y) against"),
    "sizes": (another_size, (*GAMMA, *STATED), "p2.png: 80 x 61 pixels, but"),
    "depths": (another_depth, (*GAMMA, *STATED), "p2.png: 16-bit, but"),
    "one exposure": (bracket, ("--response", "estimate", "--times", "1,1,1,1"), "photographs of one exposure"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused_in_one_line_and_nothing_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    make, options, message = REFUSED[name]
    files = make(tmp_path)
    monkeypatch.chdir(tmp_path)
    before = contents(tmp_path)
    ran = run("merge", *files, "--out", tmp_path / "h.exr", *options)
    assert ran.code == 2
    assert message in ran.line
    assert contents(tmp_path) == before


def test_places(tmp_path: Path) -> None:
    files = bracket(tmp_path)
    assert "expected a name that ends in .exr" in run("merge", *files, "--out", tmp_path / "h.png", *GAMMA).line
    (tmp_path / "h_mask.png").write_bytes(b"mine")
    ran = run("merge", *files, "--out", tmp_path / "h.exr", *GAMMA, *STATED)
    assert "h_mask.png: already there; pass --overwrite" in ran.line
    assert (tmp_path / "h_mask.png").read_bytes() == b"mine"
    assert run("merge", *files, "--out", tmp_path / "h.exr", *GAMMA, *STATED, "--overwrite").code == 0


def test_sixteen_bits(tmp_path: Path) -> None:
    files = []
    for index, time in enumerate(TIMES):
        values = ((0.1 * radiance() * time).clamp(0, 1) * 65535).round().int().numpy().astype(np.uint16)
        files.append(tmp_path / f"{index}.png")
        write_png(files[-1], np.ascontiguousarray(values.transpose(1, 2, 0)))
    assert run("merge", *files, "--out", tmp_path / "h.exr", "--response", "linear", *STATED).code == 0
    found = read_exr(tmp_path / "h.exr")[0]
    assert float((found / (0.1 * radiance()) - 1).abs().quantile(0.95)) < 1e-3
    ran = run("merge", *files, "--out", tmp_path / "i.exr", "--response", "estimate", *STATED)
    assert "needs 8-bit photographs, these have 16 bits" in ran.line


def test_memorial_church_agrees_with_the_published_radiance_map(tmp_path: Path) -> None:
    folder = data_path("brackets", "memorial")
    lines = [line.split() for line in (folder / "image_list.txt").read_text().splitlines() if line[0] != "#"]
    files, times = [folder / line[0] for line in lines], ",".join(line[1] for line in lines)
    ran = run("merge", *files, "--out", tmp_path / "h.exr", "--response", "estimate", "--times", times)
    assert (ran.code, ran.err) == (0, "")
    found, reference = read_exr(tmp_path / "h.exr")[0], read_photo(folder / "memorial.hdr").pixels
    for channel, truth in zip(found, reference, strict=True):
        both = (channel > 0) & (truth > 0)
        error = (channel[both] / truth[both]).log()
        assert float((error - error.median()).abs().median()) <= 0.12


def test_the_response_file_is_plain_json(tmp_path: Path) -> None:
    assert run("merge", *bracket(tmp_path), "--out", tmp_path / "a.exr", "--response", "estimate", *STATED).code == 0
    document = json.loads((tmp_path / "a_response.json").read_text())
    assert [len(document[name]) for name in ("red", "green", "blue")] == [256] * 3
    assert document["red"][255] == 1
