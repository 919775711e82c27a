"""What docs/*.md say about files is true: scenes load, results have the keys shown, links and figures exist."""

from __future__ import annotations

import csv
import functools
import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from torch import Tensor

from torchlight.errors import ConfigError
from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene
from torchlight.inversion.adaptive import AdaptiveHaar
from torchlight.io import scene_file
from torchlight.io.occluders import _PLACEMENT_KEYS, _SHAPES
from torchlight.io.photo_keys import ENCODINGS, PHOTO_KEYS, REFERENCE_KEYS, REFERENCES
from torchlight.io.scene_file import load_scene
from torchlight.photo.observation import linear_photo
from torchlight.pipeline import estimate, with_confidence
from torchlight.precomputation import DIRECTIONS_PER_EDGE
from torchlight.report.jpegs import photograph
from torchlight.report.page import photo_files
from torchlight.results import Provenance, select, write_result
from torchlight.synthetic import block_scene
from torchlight.transfer import transport

DOCS = Path(__file__).parent.parent / "docs"
PAGES = sorted(DOCS.glob("*.md"))
MINIMAL = {
    "occluders": "occluders: [{box: [100, 60, 120]}]\n",
    "receiver": "receiver: {size: [400, 300], samples: [16, 12]}\n",
}

# in the positive octant: it stands on the plane whichever axis of the file is up
TETRAHEDRON = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 4
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
0 0 1
3 0 2 1
3 0 1 3
3 1 2 3
3 0 3 2
"""


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL)


def snippets() -> list[tuple[str, str]]:
    return [(f"{page.stem}-{i}", text) for page in PAGES for i, text in enumerate(blocks(page, "yaml"))]


def load(text: str, folder: Path) -> Scene:
    """Loads a snippet with some mesh for each mesh, a white picture for each mask, and the keys it lacks."""
    for name in re.findall(r"mesh: (\S+)", text):
        (folder / name).write_text(TETRAHEDRON)
    for name in re.findall(r"^mask: (\S+)", text, re.MULTILINE):
        cv2.imwrite(str(folder / name), np.full((12, 16), 255, dtype=np.uint8))
    for name in re.findall(r"photo: (\S+\.jpg)", text):
        cv2.imwrite(str(folder / name), np.full((12, 16), 200, dtype=np.uint8))
    missing = [line for key, line in MINIMAL.items() if not re.search(f"^{key}:", text, re.MULTILINE)]
    scene = folder / "scene.yaml"
    scene.write_text("".join(missing) + text)
    return load_scene(scene)


@pytest.mark.parametrize("text", [text for _, text in snippets()], ids=[name for name, _ in snippets()])
def test_yaml_loads(text: str, tmp_path: Path) -> None:
    assert load(text, tmp_path).triangles.shape[0] > 0


def test_scene_page_shows_yaml() -> None:
    assert len(blocks(DOCS / "scenes.md", "yaml")) >= 4


def test_scene_page_names_every_key() -> None:
    text = (DOCS / "scenes.md").read_text()
    keys = {*scene_file._SCENE_KEYS, *scene_file._RECEIVER_KEYS, *scene_file._CAMERA_KEYS}
    keys |= {*_SHAPES, *_PLACEMENT_KEYS, "matrix", *ENCODINGS, *REFERENCES, *PHOTO_KEYS, *REFERENCE_KEYS}
    assert {key for key in keys if f"`{key}`" not in text} == set()


def test_scene_page_shows_the_true_error(tmp_path: Path) -> None:
    (shown,) = blocks(DOCS / "scenes.md", "text")
    with pytest.raises(ConfigError) as caught:
        load("receiver: {size: [400, 300], sample: [128, 96]}\n", tmp_path)
    assert str(caught.value) == f"{tmp_path}/{shown.strip()}"


def test_the_camera_snippet_looks_at_the_middle_from_above(tmp_path: Path) -> None:
    (text,) = (text for _, text in snippets() if "camera:" in text)
    camera = load(text, tmp_path).camera
    assert camera is not None
    assert camera.position[2].item() == pytest.approx(700, abs=0.01)
    forward: Tensor = camera.world_to_camera[2, :3]
    ground = camera.position - forward * (camera.position[2] / forward[2])
    torch.testing.assert_close(ground, torch.zeros(3, dtype=ground.dtype), atol=1e-2, rtol=0)  # 6 digits are printed


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small result as `torchlight estimate` writes it by default."""
    scene = block_scene(Block((1.0, 0.6, 1.2)), Receiver((0.0, 0.0), (4.0, 4.0), (8, 8)))
    photo = torch.rand(1, 3, 8, 8, generator=torch.Generator().manual_seed(0))
    columns = transport(scene, 4, 4)
    found = select(estimate(linear_photo(photo), scene, solver=AdaptiveHaar(4, 20), transfer=columns), 0)
    out, stored = tmp_path_factory.mktemp("out") / "photo", photograph(photo[0], linear=True)
    pages = functools.partial(photo_files, stored, scene.receiver)
    provenance = Provenance("", "", "photo.png", "adaptive", "nnls", {})
    write_result(out, with_confidence(found, scene, columns), scene, provenance, pages=pages)
    return out


def test_results_page_shows_exactly_the_keys_of_result_json(folder: Path) -> None:
    (example,) = blocks(DOCS / "results.md", "json")
    written = json.loads((folder / "result.json").read_text())
    assert list(json.loads(example)) == list(written)
    text = (DOCS / "results.md").read_text()
    assert [key for key in written if f"`{key}`" not in text] == []


def test_results_page_lists_exactly_the_files_written(folder: Path) -> None:
    rows = re.findall(r"^\| `(\S+\.\w+)` \|", (DOCS / "results.md").read_text(), re.MULTILINE)
    assert sorted(rows) == sorted(path.name for path in folder.iterdir())


def test_convergence_page_agrees_with_its_csv_and_the_code() -> None:
    page = (DOCS / "convergence.md").read_text().replace("**", "")
    shown = [line.strip("| ").split(" | ") for line in page.splitlines() if line.startswith(("| over", "| at"))]
    with (DOCS / "images" / "convergence.csv").open() as file:
        measured = list(csv.reader(file))[1:]
    assert [row[:4] for row in shown] == [row[:4] for row in measured]
    for row, exact in zip(shown, measured, strict=True):
        assert [float(v) for v in row[4:6]] == pytest.approx([float(v) for v in exact[4:6]], abs=6e-4)  # three digits
        assert float(row[6]) == pytest.approx(float(exact[6]), abs=0.06)  # one digit
    assert f"{DIRECTIONS_PER_EDGE} directions along a cube edge" in page


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_picture_comes_before_the_first_paragraph(page: Path) -> None:
    title, picture = [line for line in page.read_text().splitlines() if line][:2]
    assert title.startswith("# ")
    assert picture.startswith("![")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text()):
        file, _, anchor = target.partition("#")
        path = page.parent / file if file else page
        assert path.is_file(), target
        if anchor:
            headings = re.findall(r"^#+ (.*)$", path.read_text(), re.MULTILINE)
            assert anchor in {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}, (
                target
            )


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_named_files_of_the_package_exist(page: Path) -> None:
    for name in re.findall(r"`((?:torchlight|scripts|configs)/[\w/]+\.\w+)`", page.read_text()):
        assert (DOCS.parent / name).is_file(), name
