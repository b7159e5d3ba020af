"""Files to damage, and ways to damage them."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import tifffile
from PIL import Image
from world_files import SHARED_WORLDS, box, bumpy_ground, ground_height, write_yard

from dune_rl.worlds.importing.heightmap_world import HeightmapConf, build_heightmap
from dune_rl.worlds.importing.mesh_world import MeshConf, build_mesh
from dune_rl.worlds.importing.sdf.build import SdfConf, build_sdf

MESHES = ("obj", "stl", "ply", "glb", "dae")
TEXTS = ("obj", "dae", "sdf")

WORLD = """<?xml version="1.0"?><sdf version="1.9"><world name="w">
<light name="sun" type="directional"><pose>0 0 9 0 0 0</pose><direction>-1 0 -1</direction></light>
<include><uri>model://inner</uri><pose>3 1 0 0 0 1</pose></include>
<model name="plane"><static>true</static><link name="l"><collision name="c"><geometry><plane>
<normal>0 0 1</normal><size>10 10</size></plane></geometry>
<surface><friction><ode><mu>0.8</mu></ode></friction></surface></collision>
</link></model><model name="a"><static>1</static><pose>1 2 0.5 0 0 0</pose><link name="l"><collision name="c">
<geometry><box><size>1 1 1</size></box></geometry></collision><collision name="d"><geometry><cylinder>
<radius>0.3</radius><length>2</length></cylinder></geometry></collision></link></model></world></sdf>"""
INNER = """<sdf version="1.9"><model name="i"><static>1</static><link name="l"><collision name="c"><geometry>
<sphere><radius>0.4</radius></sphere></geometry></collision></link></model></sdf>"""

# What breaks readers of numbers, counts and names.
WORDS = (b"nan", b"inf", b"-1", b"0", b"4294967295", b"99999999999999999999", b"1e308", b"-1e308", b"",
         b"../..", b"/etc/passwd", b"&a;", b"\0", b"<", b">", b"#", b"true", b"\xff\xfe")  # fmt: skip


def seed_file(folder: str, kind: str) -> tuple[Callable[[], object], Path, bytes]:
    """What builds a world, the file that it reads, and that file's bytes, undamaged."""
    root = Path(folder)
    if kind in MESHES:
        named = {"Terrain": bumpy_ground(3.0, 3.0, 0.5), "Crate": box(1, 1, -0.5, (1, 1, 1.5))}
        path = write_yard(root, kind, named)
        return (lambda: build_mesh(MeshConf(path=str(path)))), path, path.read_bytes()
    if kind == "sdf":
        (root / "inner").mkdir()
        (root / "inner" / "model.sdf").write_text(INNER)
        path = root / "w.sdf"
        path.write_text(WORLD)
        return (lambda: build_sdf(SdfConf(path=str(path)))), path, path.read_bytes()
    if kind == "agriculture":
        path = root / "farm.dae"
        path.write_bytes((SHARED_WORLDS / "agriculture_world.dae").read_bytes())
        return (lambda: build_mesh(MeshConf(path=str(path)))), path, path.read_bytes()
    path = root / f"h.{'tif' if kind == 'marsyard' else kind}"
    if kind == "marsyard":
        path.write_bytes(next(SHARED_WORLDS.glob("marsyard*/dem/*.tif")).read_bytes())
    else:
        x, y = np.linspace(-10, 10, 31), np.linspace(8, -8, 25)
        heights = ground_height(np.stack(np.meshgrid(x, y), axis=-1))
        if kind == "tif":
            tifffile.imwrite(path, heights)
        elif kind == "npy":
            np.save(path, heights)
        else:
            Image.fromarray(np.round((heights + 0.4) * 8e4).astype(np.uint16)).save(path)
    conf = HeightmapConf(path=str(path), size_m=(20.0, 16.0), relief_m=1.0)
    return (lambda: build_heightmap(conf)), path, path.read_bytes()


def mutated(data: bytes, rng: np.random.Generator, kind: str) -> bytes:
    """The same file after one to three damages."""
    for _ in range(int(rng.integers(1, 4))):
        way = 5 if kind in TEXTS and rng.random() < 0.7 else int(rng.integers(5))
        out = bytearray(data)
        if len(out) < 8:
            return bytes(out)
        # Half of the damage goes to the head, where counts and names are.
        near = len(out) if rng.random() < 0.5 else min(len(out), 400)
        at = int(rng.integers(near))
        length = int(rng.integers(1, 1 + max(1, len(out) // 8)))
        if way == 0:
            out[at] = int(rng.integers(256))
        elif way == 1:
            out[at : at + 4] = (0xFFFFFFFF, 0x7FFFFFFF, 0, 0x80000000)[int(rng.integers(4))].to_bytes(
                4, "little"
            )
        elif way == 2:
            del out[at : at + (length if rng.random() < 0.5 else 1)]
        elif way == 3:
            out[at:at] = out[at : at + length]
        elif way == 4:
            out = out[: max(8, at)] if rng.random() < 0.5 else out + bytes(rng.bytes(64))
        else:
            numbers = list(re.finditer(rb"[-\w.]+", bytes(out)))
            found = numbers[int(rng.integers(len(numbers)))]
            out[found.start() : found.end()] = WORDS[int(rng.integers(len(WORDS)))]
        data = bytes(out)
    return data
