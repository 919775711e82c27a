"""Inputs made wrong, reproducibly: bits, lengths, fields of headers, numbers and structure of texts."""

from __future__ import annotations

import json
import random
import re
import struct
import zlib
from collections.abc import Callable
from typing import Any

import yaml

NUMBER = re.compile(rb"-?\d+(?:\.\d+)?")
EXTREMES = (0, 1, 2, 7, 127, 128, 255, 32767, 65535, 20_000, 2**24, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**64 - 1)
WORDS = (
    *(b"-1", b"0", b"1e999", b"-1e308", b"nan", b".nan", b".inf", b"99999999999", b"9" * 400, b"9" * 5000, b"1_0"),
    *(b"null", b"true", b"[]", b"{}", b'""', b"[[[[", b"\x00", b"\xff", b"\\ud800", b"\xe2\x80\xae", b"%s", b"0x10"),
    *(b"../../../../etc/passwd", b"/dev/zero", b"/etc/passwd", b"..", b".", b"~", b"*" * 50, b"&a [*a]", b"<<"),
    *(b"!!python/object/apply:os.system ['true']", b"!!binary aaaa", b"!!timestamp 2001-01-01", b"--- ", b"# " * 60),
)
ALIENS: tuple[Any, ...] = (
    *(None, True, -1, 0, 1e308, float("inf"), float("nan"), 10**30, 10**400, "", "x", "../../x", "/dev/zero", "a\0b"),
    *([], {}, [[]], [None] * 3, [1e300] * 3, [0, 0], [0, 0, 0], [1, 2, 3, 4], {"x": 1}, "\ud800", "e" * 5000),
    [[0] * 4] * 4,
)
Mutation = Callable[[random.Random, bytes], bytes]


def flip_bits(chance: random.Random, data: bytes) -> bytes:
    """Flips one to eight bits."""
    changed = bytearray(data)
    for _ in range(chance.randint(1, 8)):
        changed[chance.randrange(len(changed))] ^= 1 << chance.randrange(8)
    return bytes(changed)


def truncate(chance: random.Random, data: bytes) -> bytes:
    """Cuts the end off."""
    return data[: chance.randrange(len(data))]


def splice(chance: random.Random, data: bytes) -> bytes:
    """Puts a slice of the input somewhere else in it: repeated, moved or instead of what was there."""
    start = chance.randrange(len(data))
    piece = data[start : start + chance.choice((1, 4, 16, 64, 256))] * chance.choice((1, 1, 1, 50))
    place = chance.randrange(len(data))
    return data[:place] + piece + data[place + chance.choice((0, len(piece))) :]


def remove(chance: random.Random, data: bytes) -> bytes:
    """Removes a slice."""
    start = chance.randrange(len(data))
    return data[:start] + data[start + chance.choice((1, 2, 4, 8, 32)) :]


def extreme_field(chance: random.Random, data: bytes) -> bytes:
    """Sets two, four or eight bytes, most often of the header, to a number that is extreme."""
    letter = chance.choice("HIQ")
    size = struct.calcsize("=" + letter)
    place = chance.randrange(max(1, min(len(data) - size, chance.choice((64, 400, len(data))))))
    number = chance.choice(EXTREMES) % 2 ** (8 * size)
    return data[:place] + struct.pack(chance.choice("<>") + letter, number) + data[place + size :]


def extreme_word(chance: random.Random, data: bytes) -> bytes:
    """Sets a number of a text to something else."""
    found = list(NUMBER.finditer(data))
    if not found:
        return flip_bits(chance, data)
    chosen = chance.choice(found)
    return data[: chosen.start()] + chance.choice(WORDS) + data[chosen.end() :]


def shuffled_lines(chance: random.Random, data: bytes) -> bytes:
    """Removes, doubles, swaps or cuts a line."""
    lines = data.splitlines(keepends=True)
    one, other = chance.randrange(len(lines)), chance.randrange(len(lines))
    match chance.randrange(4):
        case 0:
            del lines[one]
        case 1:
            lines.insert(other, lines[one])
        case 2:
            lines[one], lines[other] = lines[other], lines[one]
        case _:
            lines[one] = lines[one][: chance.randrange(len(lines[one]))]
    return b"".join(lines)


def changed_tree(chance: random.Random, data: bytes) -> bytes:
    """Removes, replaces, renames or nests a node of a JSON or YAML document; of JSON lines the first."""
    first, _, rest = data.partition(b"\n")
    try:
        if first.startswith(b"{"):
            return json.dumps(changed(chance, json.loads(first))).encode() + b"\n" + rest
        return yaml.safe_dump(changed(chance, yaml.safe_load(data)), sort_keys=False).encode("utf-8", "surrogatepass")
    except (yaml.YAMLError, ValueError, TypeError, AttributeError, LookupError, RecursionError):
        return extreme_word(chance, data)  # no document any more, by an earlier mutation


def changed(chance: random.Random, tree: Any) -> Any:
    """Returns a document with a change; raises TypeError where it has no nodes."""
    change(chance, tree)
    return tree


def change(chance: random.Random, node: Any) -> None:
    """Changes something within a node that has children."""
    keys = list(node) if isinstance(node, dict) else list(range(len(node)))
    if not keys:
        return
    key = chance.choice(keys)
    if isinstance(node[key], dict | list) and chance.random() < 0.7:
        change(chance, node[key])
        return
    match chance.randrange(4):
        case 0:
            del node[key]
        case 1 if isinstance(node, dict):
            node[f"{key}s"] = node.pop(key)
        case 2:
            node[key] = [node[key]]
        case _:
            node[key] = chance.choice(ALIENS)


def repaired_png(data: bytes) -> bytes:
    """Returns a PNG whose chunks have right checksums again, so that a decoder believes what they say."""
    pieces, position = [data[:8]], 8
    while position + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, position)
        body = data[position + 4 : position + 8 + length]
        pieces += [data[position : position + 4], body, struct.pack(">I", zlib.crc32(body))]
        position += 12 + length
    return b"".join(pieces) + data[position:]


ON_BYTES: tuple[Mutation, ...] = (flip_bits, truncate, splice, remove, extreme_field, extreme_field)
ON_TEXTS: tuple[Mutation, ...] = (extreme_word, extreme_word, shuffled_lines, changed_tree, changed_tree, changed_tree)


def mutated(chance: random.Random, name: str, data: bytes) -> bytes:
    """Returns an input with one to three mutations."""
    mutations = ON_BYTES + ON_TEXTS if is_text(data) else ON_BYTES
    for _ in range(chance.choice((1, 1, 2, 3))):
        if data:
            data = chance.choice(mutations)(chance, data)
    return repaired_png(data) if name.endswith(".png") and chance.random() < 0.7 else data


def is_text(data: bytes) -> bool:
    """Returns whether an input is text."""
    return b"\0" not in data and all(byte < 128 for byte in data[:256])
