"""Opens report.html of a photograph, of two together and of a batch in headless Chromium and checks what a reader sees.

    python scripts/report_check.py --out docs/images

Photographs of a day are made as by draw_batch.py, one of them cut off, and one of the block turned; `torchlight batch`
and `torchlight joint` write the pages. Checked: no complaint on the console, no request to a network, no sideways
scrolling at 390 and 1,440 pixels, the exposure slider and the marks change the light's pixels, a heading sorts by mouse
and by keyboard. Screenshots are written to --out.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from contextlib import chdir, suppress
from io import BytesIO
from pathlib import Path

import tyro
from chromium import Page, browser
from draw_batch import SCENE, photograph
from PIL import Image

from torchlight.demo import RECEIVER, SECOND_POSE
from torchlight.io.images import write_png
from torchlight.light.procedural import sun_and_window
from torchlight.synthetic import block_values, pixel_rays, receiver_image

WIDTHS = (390, 1440)


def main(out: Path = Path("docs/images")) -> None:
    """Checks the pages and writes report.png, report_phone.png, report_dark.png, report_batch.png, marked.png.

    Args:
        out: folder for the screenshots.
    """
    with tempfile.TemporaryDirectory() as name:
        top = made(Path(name))
        one = top.parent / "photos/1000/report.html"
        with browser() as page:
            for path, check in ((one, check_photo), (together(Path(name)), check_photo), (top, check_table)):
                check_page(page, path, check)
            shots(page, one, top, out)
    print("all checks passed")


def made(folder: Path) -> Path:
    """Returns report.html of a batch that is made here."""
    from torchlight.cli import main as torchlight

    (folder / "block.yaml").write_text(SCENE)
    (folder / "day").mkdir()
    photograph(folder / "day")
    call = ["batch", "day/*.png", "--scene", "block.yaml", "--out", "lights", "--workers", "0"]
    call += ["--skip-near-test", "--functions", "150"]
    with chdir(folder):  # the page shows names as they were given
        try:
            torchlight(call)
        except SystemExit as ended:
            if ended.code != 1:  # one photograph is to fail
                raise
    return folder / "lights/report.html"


def together(folder: Path) -> Path:
    """Returns report.html of two photographs solved together; the block is turned in the second."""
    from torchlight.cli import main as torchlight

    (folder / "turned.yaml").write_text(SCENE.replace("20]}", "69], translation: [0.3, 0.2, 0]}"))
    values = block_values(SECOND_POSE, RECEIVER, pixel_rays(sun_and_window(128)))
    photo = receiver_image(0.7 * values / values.max(), RECEIVER)
    write_png(folder / "turned.png", (photo * 255).round().byte().permute(1, 2, 0).contiguous().numpy())
    views = ("{scene: block.yaml, photo: day/0800.png}", "{scene: turned.yaml, photo: turned.png}")
    (folder / "views.yaml").write_text("photographs:\n" + "".join(f"  - {view}\n" for view in views))
    with chdir(folder), suppress(SystemExit):
        torchlight(["joint", "views.yaml", "--out", "both", "--functions", "150"])
    return folder / "both/report.html"


def check_page(page: Page, path: Path, check: Callable[[Page], None]) -> None:
    """Raises SystemExit where a page is not as it should be."""
    for width in WIDTHS:
        for dark in (False, True):
            page.open(path, width, dark=dark)
            check(page)
            wide = page.value("document.documentElement.scrollWidth")
            expect(wide <= width, f"{path.name}: {wide} pixels wide at {width}")
            expect(not page.complaints, f"{path.name}: the console says {page.complaints}")
            expect(page.requests == [path.resolve().as_uri()], f"{path.name}: asked for {page.requests}")
            lacking = page.value("[...document.images].filter((i) => !i.alt || !i.complete || !i.naturalWidth).length")
            shown = page.value("[...document.images].filter((i) => i.loading !== 'lazy').length")
            expect(lacking == 0 or shown == 0, f"{path.name}: {lacking} pictures without text or not shown")
            print(f"{path.parent.name}/{path.name} at {width} pixels, {'dark' if dark else 'light'}: fine")


def check_photo(page: Page) -> None:
    """Raises SystemExit where slider or marks do not change the light."""
    for view in ("map", "disc"):
        before = pixels(page, view)
        act(page, "exposure", "value", "3", "input")
        brighter = pixels(page, view)
        act(page, "exposure", "value", "0", "input")
        expect(pixels(page, view) == before, f"{view}: exposure 0 does not come back")
        expect(brighter != before, f"{view}: the slider changes nothing")
    before = pixels(page, "map")
    act(page, "marks", "checked", "false", "change")
    expect(pixels(page, "map") != before, "the marks cannot be taken away")
    act(page, "marks", "checked", "true", "change")
    expect(page.value("document.getElementById('stops').textContent") == "0.0 stops", "the slider says no stops")


def check_table(page: Page) -> None:
    """Raises SystemExit where a heading does not sort."""
    heads = "[...document.querySelectorAll('th button')]"
    errors = "[...document.querySelectorAll('tbody tr')].map((r) => r.cells[3].dataset.value).filter((v) => v)"
    place = page.value(f"{heads}.findIndex((b) => b.textContent.startsWith('error'))")
    page.value(f"{heads}[{place}].click()")
    rising = [float(value) for value in page.value(errors)]
    expect(rising == sorted(rising) and len(rising) > 1, f"sorted by error: {rising}")
    page.value(f"{heads}[{place}].focus()")
    page.press("Enter", 13)
    falling = [float(value) for value in page.value(errors)]
    expect(falling == rising[::-1], f"sorted by keyboard: {falling}")
    sides = page.value(f"{heads}[{place}].parentElement.getAttribute('aria-sort')")
    expect(sides == "descending", f"aria-sort: {sides}")


def pixels(page: Page, view: str) -> str:
    """Returns what a canvas shows."""
    return page.value(f"document.getElementById('{view}').toDataURL()")


def act(page: Page, identity: str, member: str, value: str, event: str) -> None:
    """Changes a control as a reader would."""
    page.value(f"(() => {{ const c = document.getElementById('{identity}'); c.{member} = {value}; "
               f"c.dispatchEvent(new Event('{event}')); }})()")  # fmt: skip


def shots(page: Page, one: Path, top: Path, out: Path) -> None:
    """Writes the screenshots."""
    wanted = (
        ("report", one, 1440, 1500, False),
        ("report_phone", one, 390, 1500, False),
        ("report_dark", one, 1440, 1100, True),
        ("report_batch", top, 1440, 1000, False),
    )
    (out / "marked.png").write_bytes((one.parent / "light.png").read_bytes())
    for name, path, width, height, dark in wanted:
        page.open(path, width, dark=dark)
        small = Image.open(BytesIO(page.picture(height))).convert("RGB")
        scaled = small if width < 600 else smaller(small)
        scaled.save(out / f"{name}.png", optimize=True)


def smaller(picture: Image.Image) -> Image.Image:
    """Returns a picture at two thirds of its size."""
    return picture.resize((picture.width * 2 // 3, picture.height * 2 // 3), Image.Resampling.LANCZOS)


def expect(so: bool, otherwise: str) -> None:
    """Raises SystemExit with what is wrong."""
    if not so:
        sys.exit(f"report_check: {otherwise}")


if __name__ == "__main__":
    tyro.cli(main)
