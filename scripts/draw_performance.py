"""Draws docs/images/performance.png and fills the tables of docs/performance.md, from what scripts/bench/*.py measured.

    python scripts/draw_performance.py [--bench out/bench] [--page docs/performance.md]

The picture has a bar for every row of any CSV file that has a ratio to a peer; a line across it is the ratio aimed at.
A table stands between `<!-- table: NAME -->` and `<!-- end -->` and shows BENCH/NAME.csv; one whose file is not there
is left as it is.
"""

from __future__ import annotations

import csv
import re
import sys
from pathlib import Path

import matplotlib as mpl
import tyro
from bench.measuring import markdown
from matplotlib.figure import Figure

from torchlight.drawing.canvas import png_bytes
from torchlight.io.atomic import write_atomically

DOCS = Path(__file__).resolve().parent.parent / "docs"
STATED = ("machine", "threads", "peak memory of the run, GiB")  # in every row: said once, below the table
BAR, FASTER, SLOWER = 0.24, "#0072B2", "#E69F00"  # after Okabe and Ito
TABLE = re.compile(r"(<!-- table: (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)

Row = dict[str, str]


def main(bench: Path = Path("out/bench"), page: Path = DOCS / "performance.md") -> None:
    """Writes the picture beside the page, under images/, and the page's tables.

    Args:
        bench: folder of the CSV files.
        page: Markdown file.
    """
    found = {path.stem: rows(path) for path in sorted(bench.glob("*.csv"))}
    compared = [row for some in found.values() for row in some if row.get("ratio")]
    if not found:
        sys.exit(f"draw_performance: no CSV files in '{bench}'; run scripts/bench/*.py first")
    if compared:
        picture = page.parent / "images" / "performance.png"
        write_atomically(picture, ratios_picture(compared))
        print(picture)
    write_atomically(page, filled(page.read_text(), found).encode())
    print(page)


def rows(path: Path) -> list[Row]:
    """Returns the rows of a CSV file."""
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def ratios_picture(compared: list[Row]) -> bytes:
    """Returns a PNG of how many times as fast as its peer each case is, on a logarithmic scale."""
    mpl.rcParams["font.size"] = 8
    figure = Figure(figsize=(9.0, 0.9 + BAR * len(compared)), dpi=110, layout="constrained")
    axis = figure.subplots()
    ratios = [float(row["ratio"]) for row in compared]
    axis.barh(range(len(ratios)), ratios, color=[FASTER if ratio >= 1 else SLOWER for ratio in ratios], height=0.7)
    for place, (row, ratio) in enumerate(zip(compared, ratios, strict=True)):
        axis.text(max(ratio, 1.0) * 1.05, place, f"{ratio:.3g}", va="center")
        if row.get("asked"):
            axis.plot([float(row["asked"])] * 2, [place - 0.45, place + 0.45], color="black", linewidth=1.5)
    axis.set_yticks(range(len(ratios)), [f"{row['case']}: {row['peer']}" for row in compared], parse_math=False)
    axis.set_xscale("log")
    axis.set_xlim(min(0.5, *ratios) * 0.9, 2 * max(ratios))
    axis.axvline(1.0, color="0.4", linewidth=0.8)
    axis.invert_yaxis()
    axis.set_xlabel("seconds of the peer / seconds of torchlight; black line: the ratio aimed at")
    return png_bytes(figure)


def filled(text: str, found: dict[str, list[Row]]) -> str:
    """Returns the page with every table whose measurements are there."""

    def table(match: re.Match[str]) -> str:
        begin, name, end = match.groups()
        return f"{begin}{shown(found[name])}\n{end}" if name in found else match.group(0)

    return TABLE.sub(table, text)


def shown(some: list[Row]) -> str:
    """Returns rows as Markdown tables, one for each set of columns in use, and what was stated of the machine."""
    groups: dict[tuple[str, ...], list[dict[str, object]]] = {}
    for row in some:
        used = {name: number(value) for name, value in row.items() if value and name not in STATED}
        key = tuple(name for name in used if name not in ("peer", "ratio", "asked", "asked, seconds"))
        groups.setdefault(key, []).append(used)
    machine, _, peak = (some[0][name] for name in STATED)
    note = f"{machine}; peak memory of the run {float(peak):.2g} GiB."
    return "\n\n".join([*(markdown(group) for group in groups.values()), note])


def number(text: str) -> object:
    """Returns the number that a text is, or the text."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


if __name__ == "__main__":
    tyro.cli(main)
