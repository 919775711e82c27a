"""The measurements as Markdown tables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from .measure import Row
from .methods import CHOSEN, GAIN, Family
from .truth import Agreement

PRINTED = {"kitchen_cross": (3.7, 1.6), "campus_cross": (2.7, 1.3), "galileo_probe": (5.9, 2.1)}
ALLOWED = 0.3
HEAD = ("probe", "method", "functions", "regions", "fit", "other poses", "worst", "solve, s (RGB)", "KKT residual")
LSTSQ = 1e-8


def report(rows: Sequence[Row], agreements: Sequence[Agreement]) -> str:
    """Returns all tables, with a title each."""
    parts = [
        "RMS of 255 on other poses (mean, worst) for light from one 8-bit photograph:",
        summary([row for row in rows if row.noise == 0]),
        "RMS of 255. Fit: on the photograph. Other poses: mean and worst of four that no solve has seen.",
        table(HEAD, [measured(row) for row in rows if row.noise == 0]),
    ]
    noisy = sorted({row.noise for row in rows} - {0.0})
    for noise in noisy:
        parts += [
            f"With Gaussian noise of {noise:.3g} of the brightest sample in the photograph:",
            table(HEAD, [measured(row) for row in rows if row.noise == noise]),
        ]
    parts += [
        "Spherical harmonics / Haar wavelets by gain, other poses (mean):",
        ratio_table(rows),
        chosen(rows),
        checks(rows),
    ]
    if agreements:
        parts += [agreement_title(agreements), agreement_table(agreements)]
    return "\n\n".join(parts) + "\n"


def summary(rows: Sequence[Row]) -> str:
    """Returns mean and worst error on the other poses, a line per method and a column per probe."""
    probes = list(dict.fromkeys(row.probe for row in rows))
    cells = {(row.method, row.probe): f"{row.mean:.2f}, {row.worst:.2f}" for row in rows}
    methods = dict.fromkeys(row.method for row in rows)
    lines = [[method, *(cells.get((method, probe), "") for probe in probes)] for method in methods]
    return table(("method", *probes), lines)


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Returns a Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def measured(row: Row) -> list[str]:
    """Returns the cells of one measurement."""
    regions = "" if row.regions is None else str(row.regions)
    figures = [f"{value:.2f}" for value in (row.fit, row.mean, row.worst, row.seconds)]
    kkt = f"{row.kkt_residual:.0e}{'' if row.converged else ', not converged'}"
    return [row.probe, row.method, str(row.functions), regions, *figures, kkt]


def ratio_table(rows: Sequence[Row]) -> str:
    """Returns, per probe, the error of every line of spherical harmonics over that of Haar wavelets."""
    clean = [row for row in rows if row.noise == 0]
    names = list(dict.fromkeys(row.method for row in clean if row.family == Family.HARMONICS.value))
    lines = []
    for probe in dict.fromkeys(row.probe for row in clean):
        errors = {row.method: row.mean for row in clean if row.probe == probe}
        printed = f"{PRINTED[probe][0] / PRINTED[probe][1]:.1f}" if probe in PRINTED else ""
        lines.append([probe, *(f"{errors[name] / errors[GAIN.name]:.1f}" for name in names), printed])
    return table(("probe", *names, "the paper's Table 1"), lines)


def chosen(rows: Sequence[Row]) -> str:
    """Returns the settings of the method that chooses its own, one line per photograph."""
    lines = [f"- {row.probe}, noise {row.noise:.3g}: {row.settings}" for row in rows if row.method == CHOSEN.name]
    return "\n".join([f"{CHOSEN.name} on each photograph:", "", *lines])


def checks(rows: Sequence[Row]) -> str:
    """Returns the comparison of plain least squares with numpy in one line."""
    found = [row.lstsq_difference for row in rows if row.lstsq_difference is not None]
    verdict = "as it should be" if max(found) <= LSTSQ else "NOT as it should be"
    return (
        f"Objective of the unconstrained spherical harmonics against numpy.linalg.lstsq: relative difference of at "
        f"most {max(found):.0e} over {len(found)} solves (allowed {LSTSQ:.0e}; {verdict})."
    )


def agreement_title(agreements: Sequence[Agreement]) -> str:
    """Returns in one line whether the two truths agree."""
    worst = max(item.rms for item in agreements)
    verdict = "they agree" if worst <= ALLOWED else "they DISAGREE"
    return f"Mitsuba 3 against the analytic shadow, RMS of 255: at most {worst:.2f} (allowed {ALLOWED}; {verdict})."


def agreement_table(agreements: Sequence[Agreement]) -> str:
    """Returns RMS (largest) difference per probe and pose."""
    poses = list(dict.fromkeys(item.pose for item in agreements))
    cells = {(item.probe, item.pose): f"{item.rms:.2f} ({item.largest:.1f})" for item in agreements}
    probes = dict.fromkeys(item.probe for item in agreements)
    return table(("probe", *poses), [[probe, *(cells[probe, pose] for pose in poses)] for probe in probes])
