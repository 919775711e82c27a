"""Draws docs/images/viewer.png: what `torchlight view` shows, photographed in headless Chromium.

    python scripts/draw_viewer.py RESULTS --scene SCENE --out docs/images/viewer.png

Needs the extra viewer and a program called chromium on the path.
"""

from __future__ import annotations

import argparse
import base64
import itertools
import json
import subprocess
import tempfile
import time
import urllib.request
from pathlib import Path

from torchlight.cli import arguments
from torchlight.cli.view import prepare
from torchlight.errors import ConfigError
from torchlight.io.atomic import write_atomically
from torchlight.viewer.window import close_window, open_window

SIZE = (1280, 800)
WIRE = ["--headless", "--no-sandbox", "--enable-unsafe-swiftshader", "--use-gl=angle", "--use-angle=swiftshader"]
CLOSE_NOTICES = "document.querySelectorAll('[class*=Notification-closeButton]').forEach(e => e.click())"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("source", type=Path)
    parser.add_argument("--scene", type=Path)
    parser.add_argument("--light", type=Path)
    parser.add_argument("--out", type=Path, default=Path("docs/images/viewer.png"))
    parser.add_argument("--seconds", type=float, default=40.0, help="to wait for the window to be drawn")
    given = parser.parse_args()
    shown = prepare(arguments.View(given.source, given.scene, given.light))
    server = open_window(shown, "localhost", 8765)
    try:
        image = photograph(f"http://localhost:{server.get_port()}", given.seconds)
    finally:
        close_window(server)
    write_atomically(given.out, image)
    print(given.out)


def photograph(address: str, seconds: float) -> bytes:
    """Returns a page as PNG, after some seconds of real time."""
    from websockets.sync.client import connect  # pyright: ignore[reportMissingImports]

    with tempfile.TemporaryDirectory() as folder:
        size = f"--window-size={SIZE[0]},{SIZE[1]}"
        command = ["chromium", *WIRE, size, "--remote-debugging-port=0", f"--user-data-dir={folder}", address]
        browser = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            with connect(debugger(Path(folder)), max_size=None) as socket:
                numbers = itertools.count(1)
                time.sleep(seconds)
                ask(socket, next(numbers), "Runtime.evaluate", {"expression": CLOSE_NOTICES})
                time.sleep(2)
                return base64.b64decode(ask(socket, next(numbers), "Page.captureScreenshot", {})["data"])
        finally:
            browser.terminate()
            browser.wait(20)


def debugger(folder: Path) -> str:
    """Returns the address of the page's debugger, once the browser has written its port."""
    for _ in range(150):
        time.sleep(0.2)
        try:
            port = (folder / "DevToolsActivePort").read_text().split()[0]
            with urllib.request.urlopen(f"http://localhost:{port}/json") as answer:
                pages = [page for page in json.load(answer) if page["type"] == "page"]
            return pages[0]["webSocketDebuggerUrl"]
        except (OSError, IndexError):
            continue
    raise ConfigError("chromium did not start; is it on the path?")


def ask(socket, number: int, method: str, params: dict) -> dict:
    """Returns the browser's answer to one request."""
    socket.send(json.dumps({"id": number, "method": method, "params": params}))
    while True:
        answer = json.loads(socket.recv(timeout=120))
        if answer.get("id") == number:
            return answer["result"]


if __name__ == "__main__":
    main()
