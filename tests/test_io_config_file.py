"""Configuration files: what they say is what options say, and a wrong key is named."""

from __future__ import annotations

from pathlib import Path

import pytest

from torchlight.config import Adaptive, Config, Light, Output, Solver, as_options, leaves
from torchlight.errors import ConfigError
from torchlight.io.config_file import as_yaml, read_config, with_values

CHANGED = Config(Light("texels", 8), Adaptive(noise=0.001), Solver("ridge", True), output=Output(skip_pictures=True))


def written(folder: Path, text: str) -> Path:
    path = folder / "c.yaml"
    path.write_text(text)
    return path


def test_a_tree_written_is_read_again(tmp_path: Path) -> None:
    assert read_config(written(tmp_path, as_yaml(CHANGED))) == CHANGED
    assert read_config(written(tmp_path, as_yaml(Config()))) == Config()


def test_what_a_file_leaves_out_keeps_its_default(tmp_path: Path) -> None:
    assert read_config(written(tmp_path, "light: {method: sh, degree: 3}")) == Config(Light("sh", None, 3))


def test_settings_by_path_are_those_of_the_tree() -> None:
    values = {"light.method": "texels", "light.resolution": 8, "adaptive.noise": 1e-3}
    values |= {"solver.name": "ridge", "solver.robust": True, "output.skip_pictures": True}
    assert with_values(Config(), values, Path("sweep.yaml")) == CHANGED


def test_options_say_what_differs() -> None:
    assert as_options(Config()) == []
    options = "--light.method texels --light.resolution 8 --adaptive.noise 0.001 --solver.name ridge"
    assert as_options(CHANGED) == [*options.split(), "--solver.robust", "True", "--output.skip-pictures", "True"]


def test_every_setting_can_stand_in_a_file(tmp_path: Path) -> None:
    for path, value in leaves(Config()):
        assert with_values(Config(), {path: value}, tmp_path) == Config()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("lights: {}", "c.yaml: lights: unknown key; did you mean 'light'?"),
        ("light: {methods: sh}", "c.yaml: light.methods: unknown key; did you mean 'method'?"),
        ("light: {method: wavelets}", "light.method: expected texels or haar or adaptive or sh, got 'wavelets'"),
        ("light: 3", "light: expected a mapping"),
        ("solver: {robust: 1}", "solver.robust: expected true or false, got 1"),
        ("light: {degree: true}", "light.degree: expected an integer, got True"),
        ("light: {degree: null}", "light.degree: expected an integer, got nothing"),
        ("light: {resolution: 8.0}", "light.resolution: expected an integer"),
        ("adaptive: {noise: .nan}", "adaptive.noise: expected a finite number"),
        ("- light", "expected a mapping"),
    ],
)
def test_a_wrong_key_or_value_is_named(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(ConfigError) as raised:
        read_config(written(tmp_path, text))
    assert said in str(raised.value)


def test_a_wrong_path_is_named() -> None:
    with pytest.raises(ConfigError, match=r"sweep.yaml: light.degre: unknown key; did you mean 'light.degree'\?"):
        with_values(Config(), {"light.degre": 3}, Path("sweep.yaml"))
