"""Files that are built to do harm: bombs, deep nesting, false counts, code, and names of other files."""

import json
import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from functools import lru_cache

from strangers.containers import join_glb, join_png, join_zip, png_chunks, split_glb, zip_members
from strangers.damage import OUTSIDE, WORDS

_BOMB_BYTES = 2**30
_DEEP = 100_000


def attacks(data: bytes, form: str) -> list[bytes]:
    """Files that are built to do harm: bombs, deep nesting, false counts, code, and names of other files."""
    return list(_ATTACKS.get(form, lambda data: iter(()))(data))


@lru_cache(maxsize=2)
def _deflated(size: int = _BOMB_BYTES) -> bytes:
    """So many zeros, as zlib packs them a thousand times smaller."""
    packer, block = zlib.compressobj(9), bytes(2**20)
    return b"".join(packer.compress(block) for _ in range(size // len(block))) + packer.flush()


def _xml_attacks(data: bytes) -> Iterator[bytes]:
    body = re.sub(rb"<\?xml[^>]*\?>", b"", data)
    root = re.search(rb"<([\w:]+)", body)
    assert root is not None
    laughs = b"".join(b'<!ENTITY a%d "%s">' % (n, b"&a%d;" % (n - 1) * 10) for n in range(1, 10))
    inside = body[: root.end()] + b' zz="&a9;"' + body[root.end() :]
    yield b'<!DOCTYPE r [<!ENTITY a0 "ha">' + laughs + b"]>" + inside
    yield b'<!DOCTYPE r [<!ENTITY a "' + b"a" * 100_000 + b'">]>' + inside.replace(b"&a9;", b"&a;" * 20_000)
    for system in (b"file:///etc/passwd", b"http://localhost:9/a"):
        yield b'<!DOCTYPE r [<!ENTITY a9 SYSTEM "' + system + b'">]>' + inside
        yield b'<!DOCTYPE r SYSTEM "' + system + b'">' + body
        yield b'<!DOCTYPE r [<!ENTITY % a SYSTEM "' + system + b'"> %a;]>' + body
    yield b"<a>" * _DEEP + b"</a>" * _DEEP
    end = body.rindex(b"</")
    yield body[:end] + b"<link><model>" * 50_000 + b"</model></link>" * 50_000 + body[end:]
    yield body[: root.end()] + b' zz="' + b"a" * 10**7 + b'"' + body[root.end() :]
    yield body[:end] + b"<!--" + b"-" * 10**6 + body[end:]
    yield b'<?xml version="1.0" encoding="utf-16"?>' + body
    yield b'<?xml version="1.0" encoding="utf-7"?>' + body
    yield b""
    # Every name and text that may be a path.
    for word in OUTSIDE:
        yield re.sub(rb'(filename="|<uri>|<init_from>)[^"<]*', lambda found, word=word: found[1] + word, data)


def _json_attacks(data: bytes) -> Iterator[bytes]:
    yield b"[" * _DEEP
    yield b"[" * _DEEP + b"]" * _DEEP
    yield b'{"a":' * _DEEP + b"1" + b"}" * _DEEP
    yield b"9" * 10_000
    yield data[:-1] + b', "x": ' + b"9" * 10_000 + b"}"
    yield from (b"", b"null", b"[]", b"{}", b"\xff\xfe{\0}\0", b'"\\ud800"', b"NaN")


def _yaml_attacks(data: bytes) -> Iterator[bytes]:
    laughs = b"a0: &a0 [x, x]\n" + b"".join(
        b"a%d: &a%d [%s]\n" % (n, n, b", ".join([b"*a%d" % (n - 1)] * 10)) for n in range(1, 10)
    )
    yield laughs + data
    yield data + b"\n" + laughs
    merges = b"m0: &m0 {x: 1}\n" + b"".join(
        b"m%d: &m%d {<<: [%s], y%d: 1}\n" % (n, n, b", ".join([b"*m%d" % (n - 1)] * 10), n)
        for n in range(1, 10)
    )
    yield data + b"\n" + merges
    for tag in (b"python/object/apply:os.system ['touch a']", b"python/name:os.system", b"python/module:os"):
        yield b"world: !!" + tag + b"\n"
    yield b"&a [*a]"
    yield b"seed: &a {b: *a}\n" + data
    yield b"{" * _DEEP
    yield b"- " * 5000 + b"a"
    yield b"seed: " + b"9" * 10_000
    yield b"seed: 1:" + b"59:" * 5000 + b"1"
    yield b"seed: ${oc.env:HOME}\nworld: ${oc.decode:'[1'}\n" + data
    yield b"a: ${a}\n" + data
    yield from (b"", b"[]", b"null", b"a", b"\xff\xfe", b"\0", b"? [a]\n: b", b"1: 2", b"seed: 2001-01-01")


def _png_attacks(data: bytes) -> Iterator[bytes]:
    (_, head), *rest = png_chunks(data)
    for side in ((60_000, 60_000), (2**31 - 1, 1), (7_999, 7_999), (0, 5)):
        yield join_png([(b"IHDR", struct.pack(">II", *side) + head[8:]), *rest])
        bomb = [(b"IHDR", struct.pack(">II", *side) + head[8:]), (b"IDAT", _deflated()), (b"IEND", b"")]
        yield join_png(bomb)
    for kind, body in (
        (b"zTXt", b"a\0\0" + _deflated()), (b"iCCP", b"a\0\0" + _deflated()),
        (b"iTXt", b"a\0\1\0\0\0" + _deflated()), (b"tEXt", b"a\0" + b"x" * 10**6),
        (b"acTL", struct.pack(">II", 2**31 - 1, 0)), (b"eXIf", b"MM\0*" + b"\xff" * 64),
    ):  # fmt: skip
        yield join_png([(b"IHDR", head), (kind, body), *rest])
    yield join_png([(b"IHDR", head), *rest[:-1] * 3000, rest[-1]])


def _npy_attacks(data: bytes) -> Iterator[bytes]:
    def header(text: bytes, body: bytes = b"") -> bytes:
        return b"\x93NUMPY\x01\0" + struct.pack("<H", len(text)) + text + body

    for shape in (
        b"(1000000000,)",
        b"(100000, 100000)",
        b"(-1, 3)",
        b"(0, 9)",
        b"()",
        b"(1,)" * 50,
        b"(True, 2)",
    ):
        for kind in (b"<f8", b"|b1", b"<U1000000000", b"|V1000000000", b"<M8[D]", b"<c16"):
            yield header(b"{'descr': '%s', 'fortran_order': False, 'shape': %s}\n" % (kind, shape), bytes(64))
    pickled = b"cposix\nsystem\n(S'touch a'\ntR."
    yield header(b"{'descr': '|O', 'fortran_order': False, 'shape': (1,)}\n", pickled)
    yield pickled
    yield header(b"(" * 9000)
    yield header(b"{'descr': " + b"[('a', " * 500 + b"'<f8'" + b")]" * 500 + b", 'shape': (1,)}")
    yield header(b"{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (2, 2)}\n", bytes(64))
    yield header(b"__import__('os').system('touch a')\n")


def _zip_attacks(data: bytes) -> Iterator[bytes]:
    members = zip_members(data)
    for number in {0, len(members) - 1, len(members) // 2}:
        for body in (bytes(_BOMB_BYTES // 2), b"\x93NUMPY\x01\0" + bytes(100)):
            changed = [*members]
            changed[number] = members[number][0], body
            yield join_zip(changed, zipfile.ZIP_DEFLATED)
    for attack in _npy_attacks(b""):
        yield join_zip([(members[0][0], attack), *members[1:]])
        yield join_zip([*members, ("zz.npy", attack)])
    yield join_zip([(f"../../{name}", body) for name, body in members])
    yield join_zip([("/etc/passwd", b"a"), *members])
    yield join_zip(members * 2) if len(members) < 2 else join_zip([*members, members[0]])
    yield join_zip([*members, *((f"a{number}", b"") for number in range(20_000))])
    yield join_zip([])
    yield join_zip(members, zipfile.ZIP_DEFLATED)


def _pt_attacks(data: bytes) -> Iterator[bytes]:
    members = zip_members(data)
    at = next(number for number, (name, _) in enumerate(members) if name.endswith("data.pkl"))
    for body in (
        b"cposix\nsystem\n(S'touch a'\ntR.", b"cbuiltins\neval\n(S'1'\ntR.",
        b"c__builtin__\ngetattr\n.",
        b"ctorch\nload\n(S'/etc/passwd'\ntR.", b"ctorch.hub\nload\n.", b"cnumpy\nload\n.",
        b"(" * 100_000 + b".", b"]" * 10 + b".", b"\x80\x02]]a.", b"I1\n.", b"}.", b"\x80\x02N.",
        b"\x80\x02}X\x06\x00\x00\x00formatX\x07\x00\x00\x00dune_rls.",
        b"\x80\x02}(X\x06\x00\x00\x00formatX\x07\x00\x00\x00dune_rlX\x07\x00\x00\x00versionK\x03u.",
        b"\x80\x02}(X\x06\x00\x00\x00formatX\x07\x00\x00\x00dune_rlX\x07\x00\x00\x00versionK\x03"
        b"X\x04\x00\x00\x00kindX\x06\x00\x00\x00policyu.",
        b"X\xff\xff\xff\x7f.", b"\x80\x02" + b"]q\0" + b"]" * 50_000 + b"a" * 50_000 + b".",
    ):  # fmt: skip
        changed = [*members]
        changed[at] = members[at][0], body
        yield join_zip(changed)
    yield from (b"cposix\nsystem\n(S'touch a'\ntR.", b"PK\x03\x04", b"")
    yield from _zip_attacks(data)


def _glb_attacks(data: bytes) -> Iterator[bytes]:
    header, rest = split_glb(data)
    text = json.dumps(header)
    for word in OUTSIDE:
        name = word.decode()
        yield join_glb({**header, "buffers": [{"byteLength": 10**9, "uri": name}]}, b"")
        yield join_glb({**header, "images": [{"uri": name}]}, rest)
    for count in (10**9, 2**31, -1, 2**63):
        yield join_glb(re.sub(r'"count": \d+', f'"count": {count}', text).encode(), rest)
        yield join_glb(re.sub(r'"byteLength": \d+', f'"byteLength": {count}', text).encode(), rest)
        accessors = [{key: value for key, value in one.items() if key != "bufferView"} | {"count": count}
                     for one in header["accessors"]]  # fmt: skip
        yield join_glb({**header, "accessors": accessors}, rest)
    nodes = header["nodes"]
    yield join_glb({**header, "nodes": nodes * 30_000}, rest)
    yield join_glb({**header, "nodes": [{**node, "children": [0]} for node in nodes]}, rest)
    yield join_glb(
        {**header, "extensionsUsed": ["KHR_draco_mesh_compression"], "extensionsRequired": ["a"]}, rest
    )
    for deep in _json_attacks(b"{}"):
        yield join_glb(deep, rest)
    yield join_glb({**header, "buffers": [{"byteLength": 10, "uri": "data:a;base64," + "A" * 10**6}]}, rest)
    yield data[:12] + struct.pack("<I", 2**32 - 1) + data[16:]


def _stl_attacks(data: bytes) -> Iterator[bytes]:
    for count in (10**9, 2**32 - 1, 0, 1):
        yield data[:80] + struct.pack("<I", count) + data[84:]
    yield b"solid " + bytes(78) + struct.pack("<I", 10**9)
    yield b"solid a\n" + b"facet normal 0 0 1\nouter loop\nvertex 0 0 nan\n" * 1000
    yield (
        b"solid a\n"
        + b"facet normal 1e999 0 1\nouter loop\n"
        + b"vertex 1 2 3\n" * 3
        + b"endloop\nendfacet\n"
    )
    yield b"solid a\nfacet " + b"9" * 10**6


def _ply_attacks(data: bytes) -> Iterator[bytes]:
    for line in (
        b"element vertex 1000000000", b"element face 99999999999", b"element vertex -5", b"element a 3",
        b"element vertex 4\nproperty list int int x", b"property list uchar int vertex_indices",
        b"comment TextureFile /etc/passwd", b"comment TextureFile ../../etc/passwd", b"property a b",
    ):  # fmt: skip
        yield data.replace(b"end_header", line + b"\nend_header", 1)
        yield re.sub(rb"element vertex \d+", line, data, count=1)
        yield re.sub(rb"element face \d+", line, data, count=1)
    yield re.sub(rb"format \S+", b"format ascii", data)
    yield b"ply\nformat ascii 1.0\n" + b"element a 1\n" * 100_000 + b"end_header\n"
    yield b"ply\nformat ascii 1.0\nelement vertex 1\nproperty list uint float x\nend_header\n4000000000 1\n"


def _obj_attacks(data: bytes) -> Iterator[bytes]:
    for word in OUTSIDE:
        yield b"mtllib " + word + b"\nusemtl a\n" + data
    for face in (
        b"f 1 2 999999999",
        b"f 1 -999999999 2",
        b"f 1/1/1 2//2 3",
        b"f 0 0 0",
        b"f a b c",
        b"f 1",
        b"f " + b"1 2 3 " * 100_000,
        b"v nan inf 1e999\nf 1 2 3",
        b"f 1 2 " + b"9" * 20,
    ):
        yield data + b"\n" + face + b"\n"
        yield b"v 0 0 0\nv 1 0 0\nv 0 1 0\n" + face + b"\n"
    yield b"o a\n" * 100_000 + data
    yield b"usemtl a\ng b\n" * 30_000 + data
    yield data.replace(b"\n", b"\\\n")


def _csv_attacks(data: bytes) -> Iterator[bytes]:
    head, _, body = data.partition(b"\n")
    yield head + b"\n" + b"9" * 200_000 + b"," + body
    yield head + b"\n" + b'"' + b"a" * 10**6
    yield head + (b"," + head) * 3 + b"\n" + body
    yield head + b"\n" + body + b"\0,\0\n"
    yield head + b"\n" + b",\n" * 10_000
    yield b"a," * 100_000 + b"\n" + b"1," * 100_000 + b"\n"
    yield b"\xef\xbb\xbf" + data
    yield data.replace(b"\n", b"\r")
    yield from (b"", b"\n", head, b"\xff\xfe\0", data.decode("latin-1").encode("utf-16"))
    for word in WORDS:
        yield head + b"\n" + b",".join([word] * (head.count(b",") + 1)) + b"\n"
    yield head + b"\n" + body + b"=cmd|' /C calc'!A0" + b"," * head.count(b",") + b"\n"


def _tif_attacks(data: bytes) -> Iterator[bytes]:
    (at,) = struct.unpack_from("<I", data, 4)
    (count,) = struct.unpack_from("<H", data, at)
    for entry in range(count):
        for offset, form, values in (
            (4, "<I", (2**31, 2**32 - 1, 0)),
            (8, "<I", (2**32 - 1, 0, at, 60_000, 5)),
        ):
            for value in values:
                place = at + 2 + 12 * entry + offset
                yield data[:place] + struct.pack(form, value) + data[place + 4 :]
    # A directory that is its own successor, and one pixel map of deflated zeros.
    yield data[: at + 2 + 12 * count] + struct.pack("<I", at) + data[at + 6 + 12 * count :]
    packed = _deflated()
    for side, size in ((8000, len(packed)), (60_000, len(packed)), (100, len(packed))):
        entries = [(256, 4, 1, side), (257, 4, 1, side), (258, 3, 1, 32), (259, 3, 1, 8), (262, 3, 1, 1),
                   (273, 4, 1, 8 + 2 + 10 * 12 + 4), (277, 3, 1, 1), (278, 4, 1, side), (279, 4, 1, size),
                   (339, 3, 1, 3)]  # fmt: skip
        ifd = struct.pack("<H", len(entries)) + b"".join(struct.pack("<HHII", *one) for one in entries)
        yield b"II*\0" + struct.pack("<I", 8) + ifd + bytes(4) + packed


_ATTACKS: dict[str, Callable[[bytes], Iterator[bytes]]] = {
    "xml": _xml_attacks, "dae": _xml_attacks, "sdf": _xml_attacks, "urdf": _xml_attacks,
    "json": _json_attacks,
    "yaml": _yaml_attacks, "png": _png_attacks, "npy": _npy_attacks, "npz": _zip_attacks, "pt": _pt_attacks,
    "glb": _glb_attacks, "stl": _stl_attacks, "ply": _ply_attacks, "obj": _obj_attacks, "csv": _csv_attacks,
    "tif": _tif_attacks,
}  # fmt: skip
