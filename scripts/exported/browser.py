"""A page in a browser without a window: served from this machine alone, its answer taken as JSON."""

from __future__ import annotations

import json
import subprocess
import tempfile
from collections.abc import Mapping
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from queue import Empty, Queue
from threading import Thread
from typing import Any

FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--no-first-run",
    "--disable-dev-shm-usage",
)
TYPES = {".js": "text/javascript", ".html": "text/html", ".json": "application/json"}


class Pages(SimpleHTTPRequestHandler):
    """Serves folders by their first name, and one JSON; hands a posted answer on."""

    def __init__(self, *args: Any, folders: Mapping[str, Path], job: bytes, answers: Queue[bytes]) -> None:
        self.folders, self.job, self.answers = folders, job, answers
        super().__init__(*args)

    def translate_path(self, path: str) -> str:
        """Returns the file of an address."""
        first, _, rest = path.split("?", maxsplit=1)[0].lstrip("/").partition("/")
        return str(self.folders[first] / rest) if first in self.folders and ".." not in rest else "/nowhere"

    def guess_type(self, path: Any) -> str:
        """Returns the type of a file."""
        return TYPES.get(Path(path).suffix, "application/octet-stream")

    def do_GET(self) -> None:
        """Serves the job, or a file."""
        if self.path != "/job.json":
            super().do_GET()
            return
        self.send_response(200)
        self.send_header("Content-Type", "application/json")
        self.end_headers()
        self.wfile.write(self.job)

    def do_POST(self) -> None:
        """Takes the answer."""
        self.answers.put(self.rfile.read(int(self.headers["Content-Length"])))
        self.send_response(204)
        self.end_headers()

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
        """Says nothing."""


def answer(
    browser: str, page: str, folders: Mapping[str, Path], job: Mapping[str, Any], seconds: float
) -> dict[str, Any]:
    """Returns what a page posts to /result.

    Args:
        browser: Chromium's command.
        page: address within the folders, such as page/index.html.
        folders: that are served, by first name.
        job: served as /job.json.
        seconds: to wait at most.

    Raises:
        TimeoutError: no answer came.
    """
    answers: Queue[bytes] = Queue()
    handler = partial(Pages, folders=folders, job=json.dumps(job).encode(), answers=answers)
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server, tempfile.TemporaryDirectory() as profile:
        Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_address[1]}/{page}"
        command = [browser, *FLAGS, f"--user-data-dir={profile}", address]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            return json.loads(answers.get(timeout=seconds))
        except Empty as error:
            raise TimeoutError(f"{browser}: no answer from {page} after {seconds:g} s") from error
        finally:
            process.terminate()
            process.wait(timeout=30)
            server.shutdown()
