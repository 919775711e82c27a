"""A camera's response as a JSON file: what `torchlight merge` finds and `photo.response` reads."""

from __future__ import annotations

import json
from pathlib import Path

import torch

from torchlight.errors import ConfigError, FormatError
from torchlight.io.atomic import write_atomically
from torchlight.io.files import read_bytes
from torchlight.photo.radiometry import Response

MAX_BYTES = 1 << 24
_CHANNELS = ("red", "green", "blue")


def write_response(path: str | Path, response: Response) -> None:
    """Writes the relative exposure of every stored code per channel, code 0 first."""
    rows = dict(zip(_CHANNELS, response.exposure.double().tolist(), strict=True))
    document = {"response": "relative exposure of every stored code, code 0 first", **rows}
    write_atomically(path, (json.dumps(document) + "\n").encode())


def read_response(path: str | Path) -> Response:
    """Returns a response, float64.

    Raises:
        FormatError: missing, or not such a file.
    """
    try:
        document = json.loads(read_bytes(path, MAX_BYTES))
        rows = torch.tensor([document[name] for name in _CHANNELS], dtype=torch.float64)
        return Response(rows)
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
        expected = "expected JSON with red, green and blue lists of numbers of one length"
        why = str(error) if isinstance(error, ConfigError) else expected
        raise FormatError(f"{path}: not a camera response: {why}; `torchlight merge` writes such files") from error
