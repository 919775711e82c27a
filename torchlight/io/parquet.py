"""Tables as Apache Parquet (extra `parquet`): what CSV cannot keep, the type of every column."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from torchlight.errors import ConfigError
from torchlight.io.atomic import write_atomically

Kind = Literal["string", "int64", "float64", "bool"]


def installed() -> Any:
    """Returns pyarrow; raises ConfigError where it is not installed."""
    try:
        import pyarrow.parquet  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise ConfigError("--parquet: pyarrow is not installed; pip install 'torchlight[parquet]'") from None
    return pyarrow


def write_parquet(path: Path, rows: Sequence[Mapping[str, Any]], kinds: Mapping[str, Kind]) -> None:
    """Writes rows as columns of stated types, complete or not at all; a value that is None or absent is null.

    Bytes of a file's name that are no UTF-8 are written as \\udcff, as in the CSV.

    Args:
        path: of the file.
        rows: by column.
        kinds: of every column, in their order.

    Raises:
        ConfigError: pyarrow is not installed.
        FormatError: the file cannot be written.
    """
    arrow = installed()
    types = {"string": arrow.string(), "int64": arrow.int64(), "float64": arrow.float64(), "bool": arrow.bool_()}
    schema = arrow.schema([(name, types[kind]) for name, kind in kinds.items()])
    columns = {name: [storable(row.get(name), kind) for row in rows] for name, kind in kinds.items()}
    buffer = io.BytesIO()
    arrow.parquet.write_table(arrow.table(columns, schema=schema), buffer, compression="zstd")
    write_atomically(path, buffer.getvalue())


def storable(value: Any, kind: Kind) -> Any:
    """Returns a value as its column keeps it."""
    if value is None:
        return None
    if kind == "string":
        return str(value).encode(errors="backslashreplace").decode()
    return float(value) if kind == "float64" else value
