"""Six photographs of a pencil under a desk lamp: the recovered peak against the direction seen in the photograph.

    python scripts/desk_pencil.py --data DIR

DIR holds photos/desk_pencil/light/light_1.jpg to light_6.jpg and photos/desk_pencil/params.json (TORCHLIGHT_DATA is
used when --data is absent). One setting for all six: the default. How the truth is known is in `real/pencil.py`.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import tyro
from real.pencil import pencils, second_lamp, table

from torchlight.errors import TorchlightError


def main(data: Path | None = None) -> None:
    """Estimates the six lights and prints how far each peak is from the truth, in degrees.

    Args:
        data: folder that holds photos/desk_pencil; default: the environment variable TORCHLIGHT_DATA.
    """
    found = list(pencils(data if data is not None else Path(os.environ.get("TORCHLIGHT_DATA", ""))))
    print(table(found))
    azimuth, whole = second_lamp(found)
    print(f"second lamp, light_1 and light_2: azimuths {azimuth:.1f} degrees apart, directions {whole:.1f}")


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except TorchlightError as error:
        sys.exit(f"desk_pencil: {error}")
