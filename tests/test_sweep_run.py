"""Sweeps: every trial ends one way, nothing is done twice, the same seed gives the same numbers."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from sweep_case import GRID, fingerprints, here, write_sweep
from sweep_workers import dies_of_noise

from torchlight import synthetic
from torchlight.batch.local import DIED, answers
from torchlight.cli import arguments
from torchlight.cli.sweep import run as run_command
from torchlight.errors import ConfigError, FormatError
from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.receiver import Receiver
from torchlight.io.journal import opened
from torchlight.io.lights import read_light
from torchlight.io.sweep_file import read_sweep
from torchlight.sweep import synthetic as scoring
from torchlight.sweep import work as module
from torchlight.sweep.plots import pareto_front
from torchlight.sweep.run import run_sweep
from torchlight.sweep.table import write_tables
from torchlight.sweep.trial import trial_at
from torchlight.sweep.truth import truth
from torchlight.synthetic import block_values, pixel_rays


@pytest.fixture(scope="module", autouse=True)
def coarse() -> Iterator[None]:
    """Fewer rays than usual, for the photographs and for the scores: seconds, not minutes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(synthetic, "PART_SHARE", 1e-3)
        patch.setattr(scoring, "RELIGHT_RAYS", 1024)
        yield


@pytest.fixture(scope="module")
def asked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_sweep(tmp_path_factory.mktemp("sweep"))


@pytest.fixture(scope="module")
def undisturbed(asked: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("undisturbed") / "out"
    assert len(done(asked, out)) == 6
    return out


def done(path: Path, out: Path, retry: bool = False) -> list[str]:
    """Returns the names of the trials that a run did."""
    return [step.record.name for step in run_sweep(read_sweep(path), out, here, retry)]


def test_a_second_run_does_nothing(asked: Path, undisturbed: Path) -> None:
    before = fingerprints(undisturbed)
    assert len(before) == 6
    assert done(asked, undisturbed) == []
    assert fingerprints(undisturbed) == before


@pytest.mark.parametrize("stop", [1, 4])
def test_an_interrupted_sweep_ends_like_another(asked: Path, undisturbed: Path, tmp_path: Path, stop: int) -> None:
    steps = run_sweep(read_sweep(asked), tmp_path / "out", here)
    first = [next(steps).record.name for _ in range(stop)]
    steps.close()
    (tmp_path / "out" / "trials" / ".abc.partial-1").mkdir()  # what a killed process leaves
    rest = done(asked, tmp_path / "out")
    assert sorted(first + rest) == sorted(fingerprints(undisturbed))
    assert fingerprints(tmp_path / "out") == fingerprints(undisturbed)
    assert not list((tmp_path / "out" / "trials").glob(".*"))


def test_a_trial_whose_line_was_never_written_is_not_done_again(asked: Path, undisturbed: Path, tmp_path: Path) -> None:
    done(asked, tmp_path / "out")
    (tmp_path / "out" / "journal" / "sweep.jsonl").unlink()
    assert done(asked, tmp_path / "out") == []
    assert len((tmp_path / "out" / "journal" / "sweep.jsonl").read_text().splitlines()) == 6


def test_every_trial_says_where_it_comes_from(undisturbed: Path) -> None:
    for name, content in fingerprints(undisturbed).items():
        assert content["digest"].startswith(name)
        assert content["configuration"]["light.method"] == "texels"
        assert content["data"]["noise"] == content["values"]["data.noise"]
        assert content["data"]["seed"] == 0
        assert content["versions"]["torch"] == torch.__version__
        assert content["git_commit"] is None or len(content["git_commit"].removesuffix("+changes")) == 40


def test_a_failing_trial_is_data(tmp_path: Path) -> None:
    path = write_sweep(tmp_path, GRID.replace("[2, 4]", "[2, 3]"))
    out = tmp_path / "out"
    assert len(done(path, out)) == 6
    sweep = read_sweep(path)
    trials = [trial_at(sweep, {"light.resolution": n, "data.noise": 0.0}) for n in (2, 3)]
    good, bad = write_tables(out, trials)
    assert (good["state"], good["reason"]) == ("done", "")
    assert bad["state"] == "failed"
    assert "3" in bad["reason"]
    assert "\n" not in bad["reason"]
    assert done(path, out) == []
    assert len(done(path, out, retry=True)) == 3


def test_another_sweep_in_the_same_folder_is_refused(asked: Path, undisturbed: Path, tmp_path: Path) -> None:
    other = write_sweep(tmp_path, GRID.replace("[2, 4]", "[2, 8]"))
    with pytest.raises(ConfigError, match="was begun with another 'axes'"):
        done(other, undisturbed)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.tex").touch()
    with pytest.raises(FormatError, match="is not empty and holds no sweep"):
        done(asked, tmp_path / "full")


def test_two_runs_exclude_each_other(asked: Path, undisturbed: Path) -> None:
    with opened(undisturbed / "journal", "sweep"), pytest.raises(FormatError, match="worked on by another process"):
        done(asked, undisturbed)


def test_more_random_trials_keep_those_that_are_done(tmp_path: Path) -> None:
    def text(trials: int) -> str:
        return (
            GRID.replace("kind: grid", f"kind: random, trials: {trials}")
            .replace("[2, 4]", "[2]")
            .replace("[0.0, 0.01, 0.02]", "{low: 0.0, high: 0.05}")
        )

    first = done(write_sweep(tmp_path, text(2)), tmp_path / "out")
    more = done(write_sweep(tmp_path, text(4)), tmp_path / "out")
    assert (len(first), len(more)) == (2, 2)
    assert not set(first) & set(more)


def test_a_process_that_is_killed_costs_one_trial(asked: Path) -> None:
    sweep = read_sweep(asked)
    trials = [trial_at(sweep, {"light.resolution": 2, "data.noise": noise}) for noise in (0.0, 0.01, 0.02)]
    found = {one.name: one.reason for report in answers(trials, dies_of_noise, 1) for one in report.records}
    assert found == {trials[0].name: "", trials[1].name: DIED, trials[2].name: ""}


# --- figures ---------------------------------------------------------------------------------------------------------


def test_under_an_even_sky_any_method_predicts_any_pose_and_the_fit_is_the_noise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scoring, "RELIGHT_RAYS", 16384)
    text = GRID.replace("[0.0, 0.01, 0.02]", "[0.0, 0.02]").replace("samples: 8", "samples: 24")
    sweep = read_sweep(write_sweep(tmp_path, text, sky=torch.ones(3, 8, 16)))
    quiet, noisy = (
        module.measured(trial_at(sweep, {"light.resolution": 2, "data.noise": noise}), tmp_path).figures
        for noise in (0.0, 0.02)
    )
    assert quiet["held_out_rms_255"] < 0.5  # 8 bits
    # brightest of 3 x 24 x 24 noisy samples: at most white, at least the noiseless one
    assert 0.95 * 0.02 * 250 < noisy["fit_rms_255"] < 0.02 * 255
    assert noisy["held_out_rms_255"] < noisy["fit_rms_255"] / 2
    assert quiet["functions"] == noisy["functions"] == 12  # 2 x 2 on top, 2 above the horizon on each of four sides


def test_every_seed_draws_noise_of_its_own(asked: Path, tmp_path: Path) -> None:
    data = read_sweep(asked).data
    receiver = Receiver((0.0, 0.0), (4.0, 4.0), (8, 8))

    def drawn(seed: int) -> torch.Tensor:
        noisy = replace(data, noise=0.02, seed=seed)  # pyright: ignore[reportArgumentType, reportCallIssue]
        return scoring.photograph(data.lights[0], noisy, receiver, tmp_path)[0]  # pyright: ignore[reportAttributeAccessIssue, reportArgumentType]

    photographs = [drawn(seed) for seed in (0, 1, 2, 2**32 - 1)]
    for index, one in enumerate(photographs):
        for other in photographs[:index]:
            assert (one != other).float().mean() > 0.5
    assert torch.equal(drawn(1), photographs[1])


def test_truth_is_the_analytic_shadow_and_outlives_damage(asked: Path, tmp_path: Path) -> None:
    data = read_sweep(asked).data
    light, block = data.lights[0], Block((1.0, 0.6, 1.2), 69.0)  # pyright: ignore[reportAttributeAccessIssue]
    receiver = Receiver((0.0, 0.0), (4.0, 4.0), (8, 8))
    expected = block_values(block, receiver, pixel_rays(read_light(asked.parent / "sky.exr")))
    torch.testing.assert_close(truth(light, block, receiver, tmp_path), expected, rtol=0, atol=0)
    (file,) = tmp_path.iterdir()
    content = bytearray(file.read_bytes())
    content[200] ^= 1
    file.write_bytes(content)
    torch.testing.assert_close(truth(light, block, receiver, tmp_path), expected, rtol=0, atol=0)


def test_nobody_on_the_front_is_beaten_and_everybody_else_is() -> None:
    generator = torch.Generator().manual_seed(0)
    points = [(float(x), float(y)) for x, y in torch.randint(0, 12, (60, 2), generator=generator)]
    front = pareto_front(points)

    def beaten(one: tuple[float, float]) -> bool:
        return any(other != one and other[0] <= one[0] and other[1] <= one[1] for other in points)

    assert set(front) == {one for one in points if not beaten(one)}


def test_the_command_writes_table_and_pictures(asked: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    out = tmp_path / "out"
    assert run_command(arguments.Sweep(asked, out, workers=0)) == 0
    rows = [json.loads(line) for line in (out / "results.jsonl").read_text().splitlines()]
    assert [(row["light.resolution"], row["data.noise"]) for row in rows] == [
        (n, noise) for n in (2, 4) for noise in (0.0, 0.01, 0.02)
    ]
    names = {"held_out_rms_255_against_light.resolution", "held_out_rms_255_against_data.noise", "pareto"}
    assert {path.stem for path in (out / "plots").glob("*.png")} == names
    best = min(rows, key=lambda row: row["held_out_rms_255"])
    assert f"least held_out_rms_255: {best['held_out_rms_255']:.2f}" in capsys.readouterr().out
