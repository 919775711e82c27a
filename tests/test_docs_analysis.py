"""docs/analysis.md says what its curves say."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import torch

from torchlight.analysis.nullity import (
    ABSOLUTE_TOLERANCES,
    CONSIDERABLY_LESS_THAN_1,
    MATLAB,
    TOLERANCE,
    recommended_bandwidth,
)
from torchlight.io.scene_file import load_scene
from torchlight.report.case import used_samples
from torchlight.report.folder import tolerance_name

DOCS = Path(__file__).parent.parent / "docs"
PAGE = (DOCS / "analysis.md").read_text().replace("**", "")
NAMES = [tolerance_name(tolerance) for tolerance in (MATLAB, *ABSOLUTE_TOLERANCES)]


def curves() -> dict[tuple[str, str], list[float]]:
    found: dict[tuple[str, str], list[float]] = {}
    with (DOCS / "images" / "nullity.csv").open() as file:
        for row in csv.DictReader(file):
            found.setdefault((row["view"], row["tolerance"]), []).append(float(row["mean"]))
    return found


def test_the_table_of_recommended_bandwidths_follows_from_the_curves() -> None:
    means = curves()
    rows = re.findall(r"^\| ([a-z ]+) \| \d+ \| (\d) \| (\d) \| (\d) \| (\d) \|$", PAGE, re.MULTILINE)
    assert [row[0] for row in rows] == ["above", "low", "half", "all together"]
    for view, *shown in rows:
        found = [recommended_bandwidth(torch.tensor(means[view, name], dtype=torch.float64)) for name in NAMES]
        assert [int(value) for value in shown] == found


def test_the_quoted_nullities_are_the_curves() -> None:
    means = curves()
    assert ", ".join(f"{value:.2f}" for value in means["above", MATLAB][3:7]) in PAGE
    for view in ("low", "half"):
        both = zip(means[view, MATLAB][:7], means["above", MATLAB][:7], strict=True)
        assert all(abs(a - b) < 0.0101 for a, b in both)
    for name in NAMES[1:]:
        for one, two, three in zip(*(means[view, name] for view in ("above", "low", "half")), strict=True):
            assert one <= two <= three


def test_the_rule_is_the_code_s() -> None:
    assert f"is below {CONSIDERABLY_LESS_THAN_1:g} at the\ntolerance {TOLERANCE:.0e}".replace("e-0", "e-") in PAGE
    assert f"| {' | '.join(['MATLAB', *NAMES[1:]])} |" in PAGE


def test_the_paper_s_views_load_and_lose_samples_one_after_the_other() -> None:
    scenes = {view: load_scene(DOCS.parent / "configs" / "paper" / f"{view}.yaml") for view in ("above", "low", "half")}
    counts = [int(used_samples(scene).sum()) for scene in scenes.values()]
    shown = re.findall(r"^\| (?:above|low|half) \| (\d+) \|", PAGE, re.MULTILINE)
    assert counts == [int(value) for value in shown]
    assert counts == sorted(counts, reverse=True)
