"""Damage to files at random: bytes, words and values, within what the format's checksums allow."""

import json
import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from itertools import takewhile
from typing import Any

import numpy as np
import yaml

from strangers.containers import join_glb, join_png, join_zip, png_chunks, split_glb, zip_members

Rng = np.random.Generator

OUTSIDE = (
    b"/etc/passwd", b"../../../../../../../../etc/passwd", b"file:///etc/passwd", b"..",
    b"http://localhost:9/a",
    b"model://../../etc/passwd", b"package://../../etc/passwd", b"model:///etc", b"~/.bashrc", b"/dev/zero",
    b"C:\\a.obj", b"os:system", b"|touch a",
)  # fmt: skip
# What breaks readers of numbers, counts and names.
WORDS = (
    b"nan", b"inf", b"-inf", b"-1", b"0", b"1", b"1e-308", b"2147483647", b"4294967295", b"1000000000",
    b"99999999999999999999", b"1e308", b"-1e308", b"1e9", b"", b"&a;", b"\0", b"<", b">", b"#", b"true",
    b"null",
    b"{}", b"[]", b"\xff\xfe", b"9" * 5000, b"x" * 5000, "\u202e\u0000".encode(), *OUTSIDE,
)  # fmt: skip
_VALUES: tuple[Any, ...] = (
    None, True, -1, 0, 1, 0.5, 2**31, 2**63, 10**9, 10**400, 1e308, float("nan"), float("inf"), "", "x",
    "9" * 400,
    [], {}, [[]], [None], {"": None}, [1, 2, 3], "1", "nan", *(word.decode() for word in OUTSIDE),
)  # fmt: skip
_INTEGERS = (0xFFFFFFFF, 0x7FFFFFFF, 0, 0x80000000, 1, 1_000_000_000, 0xFFFF)
_FLOATS = (float("nan"), float("inf"), -float("inf"), 3e38, -3e38, 0.0, 1e-38)


def mutated(data: bytes, form: str, rng: Rng) -> bytes:
    """The file after one to three damages, in a way that fits its `form`."""
    for _ in range(int(rng.integers(1, 4))):
        change = _FORMS.get(form, _bytes)
        # A sixth is damage that knows nothing of the format.
        data = (_bytes if rng.random() < 1 / 6 else change)(data, rng)
    return data


def _bytes(data: bytes, rng: Rng) -> bytes:
    out = bytearray(data)
    if len(out) < 8:
        return bytes(out)
    # Half of the damage goes to the head, where counts and names are.
    near = len(out) if rng.random() < 0.5 else min(len(out), 400)
    at, way = int(rng.integers(near)), int(rng.integers(6))
    length = int(rng.integers(1, 1 + max(1, len(out) // 8)))
    if way == 0:
        out[at] ^= 1 << int(rng.integers(8))
    elif way == 1:
        order = "little" if rng.random() < 0.5 else "big"
        out[at : at + 4] = _INTEGERS[int(rng.integers(len(_INTEGERS)))].to_bytes(4, order)
    elif way == 2:
        del out[at : at + (length if rng.random() < 0.5 else 1)]
    elif way == 3:
        out[at:at] = out[at : at + length]
    elif way == 4:
        out = out[: max(8, at)]
    else:
        out += rng.bytes(64)
    return bytes(out)


def _text(data: bytes, rng: Rng) -> bytes:
    if rng.random() < 0.2:
        lines = data.splitlines(keepends=True)
        at = int(rng.integers(len(lines))) if lines else 0
        lines[at : at + 1] = [] if rng.random() < 0.5 else lines[at : at + 1] * int(rng.integers(2, 40))
        return b"".join(lines)
    words = list(re.finditer(rb"[-\w.:/]+", data))
    if not words:
        return data
    found = words[int(rng.integers(len(words)))]
    return data[: found.start()] + WORDS[int(rng.integers(len(WORDS)))] + data[found.end() :]


def _xml(data: bytes, rng: Rng) -> bytes:
    if rng.random() < 0.7:
        return _text(data, rng)
    spans = [match.span() for match in re.finditer(rb"<([\w:]+)[^<>]*(/>|>[^<]*</\1>)", data)]
    if not spans:
        return data
    start, end = spans[int(rng.integers(len(spans)))]
    if rng.random() < 0.4:
        return data[:start] + data[end:]
    first, last = spans[int(rng.integers(len(spans)))]
    # An element in the place of another, or many times.
    count = 1 if rng.random() < 0.7 else 300
    return data[:start] + data[first:last] * count + data[end if rng.random() < 0.5 else start :]


def _places(tree: Any) -> Iterator[tuple[Any, Any]]:
    """Every container with a key or an index of something in it."""
    for key, value in list(tree.items() if isinstance(tree, dict) else enumerate(tree)):
        yield tree, key
        if isinstance(value, dict | list):
            yield from _places(value)


def mutate_tree(tree: Any, rng: Rng) -> Any:
    """Plain data in which a value is another one, or gone, or that of another place."""
    places = list(_places(tree)) if isinstance(tree, dict | list) else []
    if not places:
        return tree
    holder, key = places[int(rng.integers(len(places)))]
    way = rng.random()
    if way < 0.6:
        holder[key] = _VALUES[int(rng.integers(len(_VALUES)))]
    elif way < 0.75:
        del holder[key]
    elif way < 0.9:
        other, there = places[int(rng.integers(len(places)))]
        holder[key] = json.loads(json.dumps(other[there], default=str))
    elif isinstance(holder, dict):
        holder[str(_VALUES[int(rng.integers(len(_VALUES)))])[:60]] = holder[key]
    else:
        holder.extend([holder[key]] * int(rng.integers(1, 50)))
    return tree


def _json(data: bytes, rng: Rng) -> bytes:
    try:
        tree = json.loads(data)
    except (ValueError, RecursionError):
        return _text(data, rng)
    return _text(data, rng) if rng.random() < 0.2 else json.dumps(mutate_tree(tree, rng)).encode()


def _yaml(data: bytes, rng: Rng) -> bytes:
    try:
        tree = yaml.load(data, getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    except (ValueError, yaml.YAMLError, RecursionError):
        return _text(data, rng)
    if rng.random() < 0.4:
        return _text(data, rng)
    # Without the comment that says in which package a file of Hydra is, all of it would be refused.
    comments = list(takewhile(lambda line: line.startswith(b"#"), data.splitlines(keepends=True)))
    return b"".join(comments) + yaml.safe_dump(mutate_tree(tree, rng)).encode()


def _png(data: bytes, rng: Rng) -> bytes:
    chunks = png_chunks(data)
    if not chunks:
        return _bytes(data, rng)
    at = int(rng.integers(len(chunks)))
    kind, body = chunks[at]
    way = rng.random()
    if way < 0.15:
        del chunks[at]
    elif way < 0.3:
        chunks.insert(int(rng.integers(len(chunks))), chunks[at])
    elif kind == b"IDAT" and way < 0.6:
        try:
            chunks[at] = kind, zlib.compress(_bytes(zlib.decompress(body), rng))
        except zlib.error:
            chunks[at] = kind, _bytes(body, rng)
    else:
        chunks[at] = kind, _bytes(body, rng)
    return join_png(chunks)


def _zip(data: bytes, rng: Rng) -> bytes:
    try:
        members = zip_members(data)
        at = int(rng.integers(len(members)))
    except (zipfile.BadZipFile, ValueError, zlib.error, NotImplementedError, EOFError, RuntimeError, OSError):
        return _bytes(data, rng)
    name, body = members[at]
    way = rng.random()
    if way < 0.1:
        del members[at]
    elif way < 0.2:
        members.append((members[int(rng.integers(len(members)))][0] + "_", body))
    elif way < 0.3:
        members[at] = members[int(rng.integers(len(members)))][0], body
    else:
        form = "npy" if name.endswith(".npy") else "pickle" if name.endswith(".pkl") else "bytes"
        if form == "pickle" or rng.random() < 0.5:
            # The small ones say what the others are.
            at = min(range(len(members)), key=lambda n: (not members[n][0].endswith(".pkl"), n != at))
        name, body = members[at]
        members[at] = name, mutated(body, form, rng)
    return join_zip(members)


def _npy(data: bytes, rng: Rng) -> bytes:
    """Damage to the header, whose length is set right, or to the numbers."""
    if len(data) < 10 or not data.startswith(b"\x93NUMPY\x01") or rng.random() < 0.2:
        return _bytes(data, rng)
    (length,) = struct.unpack_from("<H", data, 8)
    header = _text(data[10 : 10 + length], rng) if rng.random() < 0.6 else data[10 : 10 + length]
    body = data[10 + length :]
    if header == data[10 : 10 + length]:
        body = _numbers(body, rng)
    return data[:8] + struct.pack("<H", min(len(header), 65_535)) + header + body


def _numbers(body: bytes, rng: Rng) -> bytes:
    """Floats that are none, or the largest, here and there."""
    out = bytearray(body)
    for at in rng.integers(max(1, len(out) // 8), size=int(rng.integers(1, 9))).tolist():
        number = _FLOATS[int(rng.integers(len(_FLOATS)))]
        if 8 * at + 8 <= len(out):
            struct.pack_into("<d" if rng.random() < 0.5 else "<f", out, 8 * at, number)
    return bytes(out)


def _pickle(data: bytes, rng: Rng) -> bytes:
    """Damage to a pickle: a text or a number of it, or its bytes."""
    if rng.random() < 0.4:
        return _bytes(data, rng)
    texts = list(re.finditer(rb"X(....)", data, re.DOTALL))
    if not texts or rng.random() < 0.3:
        numbers = list(re.finditer(rb"[KMJ]", data))
        if not numbers:
            return _bytes(data, rng)
        at = numbers[int(rng.integers(len(numbers)))].end()
        return data[:at] + rng.bytes(1) + data[at + 1 :]
    found = texts[int(rng.integers(len(texts)))]
    (length,) = struct.unpack("<I", found[1])
    word = WORDS[int(rng.integers(len(WORDS)))]
    return data[: found.start()] + b"X" + struct.pack("<I", len(word)) + word + data[found.end() + length :]


def _glb(data: bytes, rng: Rng) -> bytes:
    try:
        header, rest = split_glb(data)
    except (ValueError, struct.error, RecursionError):
        return _bytes(data, rng)
    if rng.random() < 0.7:
        return join_glb(mutate_tree(header, rng), rest)
    return join_glb(header, rest[:8] + _numbers(rest[8:], rng))


def _tif(data: bytes, rng: Rng) -> bytes:
    """Damage to an entry of the first directory of a little-endian TIFF: a tag, type, count or value."""
    if data[:4] != b"II*\0" or len(data) < 16 or rng.random() < 0.2:
        return _bytes(data, rng)
    (at,) = struct.unpack_from("<I", data, 4)
    if at + 2 > len(data):
        return _bytes(data, rng)
    (count,) = struct.unpack_from("<H", data, at)
    place = at + 2 + 12 * int(rng.integers(max(1, count))) + (0, 2, 4, 8)[int(rng.integers(4))]
    if place + 4 > len(data):
        return _bytes(data, rng)
    new = _INTEGERS[int(rng.integers(len(_INTEGERS)))] if rng.random() < 0.6 else int(rng.integers(20))
    return data[:place] + struct.pack("<I", new) + data[place + 4 :]


def _stl(data: bytes, rng: Rng) -> bytes:
    return data[:84] + _numbers(data[84:], rng) if rng.random() < 0.4 else _bytes(data, rng)


_FORMS: dict[str, Callable[[bytes, Rng], bytes]] = {
    "text": _text, "csv": _text, "obj": _text, "xml": _xml, "dae": _xml, "sdf": _xml, "urdf": _xml,
    "json": _json, "yaml": _yaml, "png": _png, "zip": _zip, "npz": _zip, "pt": _zip, "npy": _npy,
    "pickle": _pickle, "glb": _glb, "tif": _tif, "stl": _stl, "ply": _bytes,
}  # fmt: skip
