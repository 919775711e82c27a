"""Wrong inputs of every kind: read or refused in one line, nothing unpickled, nothing written outside."""

from __future__ import annotations

import os
import random
import struct
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from torchlight.io.exif import Exif, parse_exif
from torchlight.io.lights import read_light

sys.path.insert(0, str(Path(__file__).parent.parent / "scripts"))

bombs = import_module("fuzzing.bombs").bombs
mutated = import_module("fuzzing.mutations").mutated
seeds = import_module("fuzzing.seeds").seeds
trial = import_module("fuzzing.trial")
outcome, readers, watched = trial.outcome, trial.readers, trial.watched

MUTATIONS = 12  # of every kind


@pytest.fixture(scope="module")
def valid(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    return seeds(tmp_path_factory.mktemp("seeds"))


@pytest.fixture
def folder(tmp_path: Path, valid: dict[str, bytes]) -> Path:
    for name, data in valid.items():
        (tmp_path / name).write_bytes(data)
    return tmp_path


def test_what_mutations_begin_with_is_read(folder: Path, valid: dict[str, bytes]) -> None:
    assert {name: outcome(folder, name, valid[name]) for name in valid if readers(name)} == {
        name: "read" for name in valid if readers(name)
    }


def test_mutated_inputs_end_well(folder: Path, valid: dict[str, bytes]) -> None:
    said = {}
    for name in filter(readers, valid):
        for index in range(MUTATIONS):
            data = mutated(random.Random(f"tests {name} {index}"), name, valid[name])
            said[name, index] = outcome(folder, name, data)
        (folder / name).write_bytes(valid[name])
    assert {case: one for case, one in said.items() if one not in ("read", "refused")} == {}
    assert sum(one == "refused" for one in said.values()) > len(said) / 2


HARMLESS = {
    "OBJ whose face has 10^5 corners",
    "glTF whose nodes go round",
    "a photograph that leads outside",  # it is read where it lies; its result has a name inside the output
    "a tag that is no UTF-8",
    "a pickle instead of safetensors",  # the cache warns, and the transport is computed again
}


def test_small_inputs_that_ask_for_much_are_refused(folder: Path, valid: dict[str, bytes]) -> None:
    found = {what: outcome(folder, name, data) for what, (name, data) in bombs(valid).items()}
    assert found == {what: "read" if what in HARMLESS else "refused" for what in found}
    assert not (folder / "called").exists()


def test_what_a_reader_must_not_do_is_heard(tmp_path: Path) -> None:
    import pickle

    with watched(tmp_path) as wrong:
        pickle.loads(pickle.dumps(Path))
        (tmp_path / "inside").write_text("x")
    assert len(wrong) == 1
    assert wrong[0].startswith("pickle.find_class")
    (tmp_path / "in").mkdir()
    with watched(tmp_path / "in") as wrong:
        (tmp_path / "outside").write_text("x")
    assert len(wrong) == 1
    assert "outside" in wrong[0]


@pytest.mark.parametrize(
    "attributes",
    [
        {"torchlight": "[" * 100_000},
        {"torchlight": '{"light_plane": {"height": 1' + "0" * 400 + ', "center": [0, 0]}}'},
        {"torchlight": '{"light_plane": {"height": NaN, "center": [0, 0]}}'},
        {"torchlight": '{"convention": "\\ud800\\n"}'},
    ],
)
def test_attributes_of_an_exr_that_no_writer_makes_are_refused(tmp_path: Path, attributes: dict[str, str]) -> None:
    planes = {name: np.zeros((4, 8), np.float32) for name in "RGB"}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File({**header, **attributes}, planes).write(str(tmp_path / "a.exr"))
    assert trial.one_reading(read_light, tmp_path / "a.exr") == "refused"


def test_primaries_that_are_no_numbers_are_refused(tmp_path: Path, valid: dict[str, bytes]) -> None:
    changed = valid["light.exr"].replace(b"chromaticities\0chromaticities\0", b"chromaticities\0chromaticitieX\0")
    assert outcome(tmp_path, "light.exr", changed) == "refused"


def test_exif_whose_directory_lies_nowhere_is_none() -> None:
    entry = struct.pack("<HHII", 0x8769, 5, 1, 26)
    block = b"II*\0" + struct.pack("<IH", 8, 1) + entry + struct.pack("<III", 0, 1, 0)
    assert parse_exif(block) == Exif()


def test_a_mesh_reads_no_pipe_and_nothing_outside_its_folder(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    gltf = import_module("fuzzing.bombs").gltf
    for uri in ("pipe", "/dev/zero", "../outside.bin"):
        assert outcome(tmp_path, "a.gltf", gltf(uri=uri)) == "refused"
    (tmp_path / "buffer.bin").write_bytes(np.eye(3, dtype="<f4").tobytes())
    assert outcome(tmp_path, "a.gltf", gltf(uri="buffer.bin")) == "read"
