"""Section 5.1 of the paper on eight light probes, with ground truth that no solver has touched.

    python scripts/reproduce_paper.py --data DIR [--out out/paper] [--truth analytic|mitsuba|both] [--noise 0.01]
    python scripts/reproduce_paper.py --probes DIR

DIR holds probes/kitchen_cross.hdr and the others of `paper.setting.PROBES` (TORCHLIGHT_DATA is used when --data is
absent); --probes measures every .hdr and .exr of a folder of your own. A block of 1.0 x 0.6 x 1.2 stands on a plane of
4 x 4, seen as 64 x 64 samples. Its 8-bit photograph gives the light; four other poses, one of them of another block,
are relit and compared with the truth. All settings are the same for all probes.

Errors are RMS over all samples that no block stands on, in 255ths of the brightest (Okabe, Sato and Sato 2004,
Table 1, print 3.7 / 2.7 / 5.9 for spherical harmonics and 1.6 / 1.3 / 2.1 for Haar wavelets on a scene of their own).

Writes OUT/paper.md, OUT/paper.json and pictures: figure4.png (Haar functions), figure5.png (the lights), and for each
probe figure6_NAME.png (what each method makes of it) and fates_NAME.png (which Haar functions it uses, and why no
others). OUT/truth keeps the ground truth for the next run.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

import tyro
from paper import pictures, tables
from paper.measure import AllColumns, Row, Transfers, all_columns, measure, precomputed, warm_up
from paper.methods import METHODS, Found
from paper.setting import Exposed, exposed, probe_files
from paper.truth import Agreement, Truth, available, truths

from torchlight.errors import TorchlightError
from torchlight.io.atomic import write_atomically
from torchlight.io.lights import read_light
from torchlight.light.environment import EnvironmentMap


@dataclass(eq=False)
class Results:
    """What has been measured so far."""

    rows: list[Row] = field(default_factory=list)
    agreements: list[Agreement] = field(default_factory=list)


def main(
    data: Path | None = None,
    probes: Path | None = None,
    out: Path = Path("out/paper"),
    truth: Truth | None = None,
    noise: float | None = None,
    mitsuba_samples: int = 8192,
) -> None:
    """Prints the tables and writes OUT/paper.md, OUT/paper.json and the pictures.

    Args:
        data: folder that holds probes/*.hdr; default: the environment variable TORCHLIGHT_DATA.
        probes: a folder of your own light probes, .hdr or .exr, to measure instead.
        out: folder for tables, pictures and the ground truth.
        truth: analytic, mitsuba (an independent renderer; minutes per probe) or both: scored by the analytic one,
            and the two compared. Default: both where Mitsuba is installed.
        noise: measure also with Gaussian noise of this standard deviation, as a share of the brightest sample.
        mitsuba_samples: light samples of Mitsuba per sample of the plane.
    """
    files = probe_files(data, probes)
    chosen = available(truth)
    transfers = precomputed(METHODS)
    columns = all_columns(METHODS, transfers)
    warm_up(transfers, columns)
    results = Results()
    lights = {}
    for path in files:
        lights[path.stem] = read_light(path)
        values, agreements = truths(lights[path.stem], path.stem, chosen, out / "truth", mitsuba_samples)
        results.agreements += agreements
        seen = exposed(values, 0.0)
        found = dict(measured(results, path.stem, seen, transfers, columns, 0.0))
        draw(out, path.stem, lights[path.stem], seen, found, transfers)
        if noise is not None:
            dict(measured(results, path.stem, exposed(values, noise), transfers, columns, noise))
        write(out, results)
    write_atomically(out / "figure4.png", pictures.functions_picture())
    write_atomically(out / "figure5.png", pictures.probes_picture(lights))
    print(write(out, results))


def measured(
    results: Results, probe: str, seen: Exposed, transfers: Transfers, columns: AllColumns, noise: float
) -> Iterator[tuple[str, Found]]:
    """Yields every method's light, and adds its line to the results."""
    for method in METHODS:
        row, found = measure(probe, method, seen, transfers, columns[method.name], noise)
        results.rows.append(row)
        yield method.name, found


def draw(
    out: Path, probe: str, light: EnvironmentMap, seen: Exposed, found: dict[str, Found], transfers: Transfers
) -> None:
    """Writes the pictures of one probe."""
    out.mkdir(parents=True, exist_ok=True)
    write_atomically(out / f"figure6_{probe}.png", pictures.comparison(probe, light, seen, found, transfers))
    write_atomically(out / f"fates_{probe}.png", pictures.fates(found))


def write(out: Path, results: Results) -> str:
    """Writes tables and figures so far and returns the tables."""
    text = tables.report(results.rows, results.agreements)
    content = {
        "rows": [{**asdict(row), "mean": row.mean, "worst": row.worst} for row in results.rows],
        "agreement": [asdict(item) for item in results.agreements],
    }
    out.mkdir(parents=True, exist_ok=True)
    write_atomically(out / "paper.md", text.encode())
    write_atomically(out / "paper.json", json.dumps(content, indent=2).encode())
    return text


if __name__ == "__main__":
    try:
        tyro.cli(main, config=(tyro.conf.EnumChoicesFromValues,))
    except TorchlightError as error:
        sys.exit(f"reproduce_paper: {error}")
