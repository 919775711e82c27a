"""Searches: which points, in which order, and that neither interruption nor the number of workers changes them."""

from __future__ import annotations

import itertools
from collections import Counter
from pathlib import Path

import pytest
from sweep_case import BASE, DATA, GRID, write_sweep

from torchlight.errors import ConfigError
from torchlight.io.sweep_file import Interval, Sweep, read_sweep
from torchlight.sweep.optuna_search import by_optuna
from torchlight.sweep.search import Point, at_random, drawn, grid, random_point

AXES = "axes: {adaptive.functions: {low: 10, high: 20}, data.noise: {low: 0.001, high: 0.1, log: true}}\n"


def test_a_grid_is_every_combination_once(tmp_path: Path) -> None:
    (points,) = grid(read_sweep(write_sweep(tmp_path)))
    assert [tuple(point.values()) for point in points] == list(itertools.product([2, 4], [0.0, 0.01, 0.02]))


def random_sweep(folder: Path, trials: int, seed: int = 0) -> Sweep:
    text = f"seed: {seed}\nsearch: {{kind: random, trials: {trials}}}\n" + BASE + AXES + DATA
    return read_sweep(write_sweep(folder, text))


def test_more_random_points_begin_with_the_same(tmp_path: Path) -> None:
    (few,), (many,) = at_random(random_sweep(tmp_path, 3)), at_random(random_sweep(tmp_path, 9))
    assert many[:3] == few
    assert len({tuple(point.values()) for point in many}) == 9


def test_another_seed_is_another_sweep(tmp_path: Path) -> None:
    assert random_point(random_sweep(tmp_path, 1, seed=1), 0) != random_point(random_sweep(tmp_path, 1, seed=2), 0)


@pytest.mark.parametrize("log", [False, True])
def test_integers_between_two_ends_all_occur_as_often_as_they_should(log: bool) -> None:
    import math
    import random

    generator, count = random.Random(0), 20_000
    found = Counter(drawn(Interval(1, 4, log), generator) for _ in range(count))
    width = math.log(4.5 / 0.5)
    shares = [math.log((k + 0.5) / (k - 0.5)) / width if log else 0.25 for k in (1, 2, 3, 4)]
    for k, share in zip((1, 2, 3, 4), shares, strict=True):
        assert found[k] / count == pytest.approx(share, abs=5 * math.sqrt(share / count))


def test_ratios_are_drawn_evenly_on_a_logarithmic_axis() -> None:
    import random

    generator = random.Random(0)
    values = sorted(drawn(Interval(0.001, 0.1, True), generator) for _ in range(4001))
    assert 0.001 <= values[0] < values[-1] <= 0.1
    assert values[2000] == pytest.approx(0.01, rel=0.1)  # the median of even ratios is the geometric mean of the ends


def optuna_sweep(folder: Path, trials: int) -> Sweep:
    text = f"search: {{kind: optuna, trials: {trials}, together: 3}}\n" + BASE + AXES + DATA
    return read_sweep(write_sweep(folder, text))


def played(sweep: Sweep, out: Path, groups: int | None = None) -> list[Point]:
    """Returns the points that are asked when the figure is the distance from 15 functions; stops after some groups."""
    out.mkdir(exist_ok=True)
    search, asked, answers = by_optuna(sweep, out), [], None
    for _ in itertools.count() if groups is None else range(groups):
        try:
            group = next(search) if answers is None else search.send(answers)
        except StopIteration:
            break
        asked += group
        answers = [
            None if point["data.noise"] > 0.05 else float(abs(point["adaptive.functions"] - 15)) for point in group
        ]
    search.close()
    return asked


@pytest.mark.filterwarnings("default")
def test_optuna_goes_on_as_if_it_had_not_been_interrupted(tmp_path: Path) -> None:
    pytest.importorskip("optuna", reason="Optuna is not installed (extra sweep)")
    sweep = optuna_sweep(tmp_path, 16)
    undisturbed = played(sweep, tmp_path / "undisturbed")
    assert len(undisturbed) == 16
    first = played(sweep, tmp_path / "out", groups=4)  # the answers to the fourth group are never told
    rest = played(sweep, tmp_path / "out")
    assert first[:9] + rest == undisturbed
    assert rest[:3] == first[9:]
    assert played(sweep, tmp_path / "out") == []


def test_without_optuna_one_line_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "optuna", None)
    with pytest.raises(ConfigError, match=r"search.kind: optuna is not installed; pip install 'torchlight\[sweep\]'"):
        next(by_optuna(optuna_sweep(tmp_path, 4), tmp_path))


def test_a_grid_file_is_what_the_other_tests_use() -> None:
    assert GRID.startswith("search: {kind: grid}")
