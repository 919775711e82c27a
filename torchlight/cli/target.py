"""`torchlight target`: the printed sheet, and how low the light may stand over it."""

from __future__ import annotations

from pathlib import Path

from torchlight.cli import arguments
from torchlight.errors import ConfigError, FormatError
from torchlight.io.atomic import check_writable, write_atomically
from torchlight.io.target_file import write_target
from torchlight.photo.target import RULER_LENGTH, Prop, Reach, Sheet, make_sheet, shadow_reach
from torchlight.report.sheet import sheet_pdf, sheet_png


def run(command: arguments.Target) -> int:
    """Writes the sheet as PDF, PNG and YAML, and says what the shadow may do."""
    prop = parse_prop(command.object, command.pose)
    sheet = make_sheet(command.paper)
    reach = shadow_reach(sheet, prop)
    pdf, png, description = check_places(command)
    write_atomically(pdf, sheet_pdf(sheet, prop))
    write_atomically(png, sheet_png(sheet, prop))
    write_target(description, sheet, prop)
    print(
        f"{pdf}: print at 100 % (actual size); the printed line must measure {RULER_LENGTH:g} mm. {png}; {description}"
    )
    for line in verdict(sheet, prop, reach):
        print(line)
    return 0


def verdict(sheet: Sheet, prop: Prop, reach: Reach) -> list[str]:
    """Returns what to know before the photograph: heights of the light, markers at risk, and the receiver to state."""
    width, height = sheet.inside
    free = len(sheet.markers) - len(reach.markers)
    met = f"shadows may fall on markers {', '.join(map(str, reach.markers))}; {free} others stay clear"
    between = met if reach.markers else "no marker is met"
    return [
        f"object {prop.height:g} mm tall: its shadow stays on the clean white, {width:g} x {height:g} mm, "
        f"while the light is {reach.inside_degrees:.1f} degrees or more above the plane",
        f"down to {reach.sheet_degrees:.1f} degrees it stays on the sheet: {between}; but its end may leave the white, "
        "and then the light's azimuth is seen, its height is not",
        f"below {reach.sheet_degrees:.1f} degrees it may leave the sheet: choose a lower object or a larger paper",
        f"scene file: receiver: {{size: [{width:g}, {height:g}], samples: [{width / 2:.0f}, {height / 2:.0f}]}}",
    ]


def parse_prop(text: str, pose: str) -> Prop:
    """Returns the object that --object and --pose describe; ConfigError where they describe none."""
    shape, _, sizes = text.partition(":")
    size = _numbers(sizes, f"--object {text}: expected such as box:30,20,35, cylinder:10,40 or cone:10,40")
    place = _numbers(pose, f"--pose {pose}: expected x,y,degrees such as 0,0,30")
    if len(place) != 3:
        raise ConfigError(f"--pose {pose}: expected x,y,degrees such as 0,0,30")
    try:
        return Prop(shape, tuple(size), (place[0], place[1]), place[2])
    except ConfigError as error:
        raise ConfigError(f"--object {text}: {str(error).removeprefix('object: ')}") from error


def _numbers(text: str, otherwise: str) -> list[float]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError as error:
        raise ConfigError(otherwise) from error
    if not all(abs(value) < 1e6 for value in values):
        raise ConfigError(otherwise)
    return values


def check_places(command: arguments.Target) -> tuple[Path, Path, Path]:
    """Returns where PDF, PNG and YAML go; raises ConfigError or FormatError where they cannot."""
    if command.out.suffix.lower() != ".pdf":
        raise ConfigError(f"--out {command.out}: expected a name that ends in .pdf")
    check_writable(command.out.parent)
    places = (command.out, command.out.with_suffix(".png"), command.out.with_suffix(".yaml"))
    for path in places:
        if path.exists() and not command.overwrite:
            raise FormatError(f"{path}: already there; pass --overwrite to replace it, or choose another --out")
    return places
