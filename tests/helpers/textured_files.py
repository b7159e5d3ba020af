"""World files with textures for tests and views: a yard of tiles, a sign, a crate with letters and a shed."""

from pathlib import Path

import numpy as np
import trimesh
from PIL import Image, ImageDraw
from trimesh.visual.material import PBRMaterial, SimpleMaterial
from trimesh.visual.texture import TextureVisuals
from world_files import Y_UP, bumpy_ground, ground_height

SIGN, CRATE, SHED = (3.0, 0.0), (0.0, 4.0), (-5.0, -3.0)
SIGN_SIZE = (4.0, 2.0)


def quadrants() -> Image.Image:
    """Red, green, blue and yellow: upper left, upper right, lower left, lower right."""
    colours = np.array([[[220, 40, 40], [40, 180, 60]], [[40, 70, 210], [230, 200, 40]]], np.uint8)
    return Image.fromarray(np.kron(colours, np.ones((64, 64, 1), np.uint8)))


def paving(side: int = 512) -> Image.Image:
    """Stones in rows, a sandy path through their middle and a meadow at the upper edge."""
    rng = np.random.default_rng(3)
    picture = Image.new("RGB", (side, side), (118, 112, 104))
    draw = ImageDraw.Draw(picture)
    stone = side // 32
    for row in range(32):
        for column in range(-1, 32):
            tone = int(rng.integers(138, 186))
            x = column * stone + (row % 2) * stone // 2
            draw.rectangle(
                (x + 1, row * stone + 1, x + stone - 2, (row + 1) * stone - 2), (tone, tone - 6, tone - 16)
            )
    noise = rng.normal(0.0, 7.0, (side, side, 1))
    found = np.asarray(picture, np.float64)
    v, u = np.mgrid[:side, :side] / side
    path = np.abs(u - 0.5 - 0.06 * np.sin(9.0 * v))[..., None]
    found = np.where(path < 0.07, [196.0, 170.0, 122.0], found)
    found = np.where((v < 0.22 + 0.02 * np.sin(30 * u))[..., None], [104.0, 118.0, 62.0], found)
    return Image.fromarray(np.clip(found + noise, 0, 255).astype(np.uint8))


def planks() -> Image.Image:
    """Upright boards of differing browns, dark between them."""
    rng = np.random.default_rng(5)
    board = rng.normal(0.0, 10.0, 8).repeat(32)[None, :, None]
    grain = rng.normal(0.0, 9.0, (1, 256, 1)) + rng.normal(0.0, 4.0, (256, 256, 1))
    found = np.array([140.0, 92.0, 56.0]) + board + grain
    found[:, ::32] = found[:, 1::32] = [48.0, 32.0, 22.0]
    return Image.fromarray(np.clip(found, 0, 255).astype(np.uint8))


def lettered() -> Image.Image:
    """A yellow board with a dark frame and DUNE on it."""
    picture = Image.new("RGB", (256, 256), (226, 178, 48))
    draw = ImageDraw.Draw(picture)
    draw.rectangle((6, 6, 249, 249), outline=(40, 36, 32), width=10)
    draw.text((128, 128), "DUNE", (30, 28, 26), anchor="mm", font_size=84)
    return picture


def pictured(
    mesh: trimesh.Trimesh, uv: np.ndarray, picture: Image.Image, kind: str, name: str
) -> trimesh.Trimesh:
    material = (
        PBRMaterial(name=name, baseColorTexture=picture)
        if kind == "glb"
        else SimpleMaterial(name=name, image=picture)
    )
    mesh.visual = TextureVisuals(uv=uv, material=material)
    return mesh


def panelled_box(x: float, y: float, bottom: float, size: tuple[float, float, float], per_m: float | None):
    """A box and its uv: the whole picture on each side, or `per_m` of it to the metre."""
    sides, faces, uv = [], [], []
    half = np.array(size) / 2
    for axis in range(3):
        for sign in (-1.0, 1.0):
            across, up = [(1, 2), (0, 2), (0, 1)][axis]
            # Seen from outside, the picture is upright and not mirrored.
            flip = sign if axis != 1 else -sign
            corners = np.zeros((4, 3))
            corners[:, axis] = sign * half[axis]
            corners[:, across] = flip * np.array([-1, 1, 1, -1]) * half[across]
            corners[:, up] = np.array([-1, -1, 1, 1]) * half[up]
            at = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
            uv.append(at if per_m is None else at * [size[across] * per_m, size[up] * per_m])
            faces += [np.add([0, 1, 2], 4 * len(sides)), np.add([0, 2, 3], 4 * len(sides))]
            sides.append(corners)
    vertices = np.concatenate(sides) + np.array([x, y, bottom + half[2]])
    return trimesh.Trimesh(vertices, np.array(faces), process=False), np.concatenate(uv)


def textured_yard(kind: str = "glb") -> dict[str, trimesh.Trimesh]:
    """Bumpy ground of 20 by 16 m with one picture over all of it, and things with pictures on their sides."""
    ground = bumpy_ground()
    found = {
        "Terrain": pictured(ground, ground.vertices[:, :2] / [20.0, 16.0] + 0.5, paving(), kind, "paving")
    }
    for name, at, size, picture, per_m in (
        ("Sign", SIGN, (0.1, *SIGN_SIZE), quadrants(), None),
        ("Crate", CRATE, (1.2, 1.2, 1.2), lettered(), None),
        ("Shed", SHED, (4.0, 3.0, 2.6), planks(), 0.5),
    ):
        bottom = float(ground_height(np.array(at))) - (0.3 if name == "Shed" else 0.0)
        found[name] = pictured(*panelled_box(*at, bottom, size, per_m), picture, kind, name.lower())
    return found


def write_textured_yard(folder: Path, kind: str = "glb") -> Path:
    """The yard as .glb with its pictures in it, or as .obj with .mtl and .png files beside it."""
    scene = trimesh.Scene()
    for name, mesh in textured_yard(kind).items():
        mesh = mesh if kind == "obj" else mesh.apply_transform(Y_UP)
        scene.add_geometry(mesh, node_name=name, geom_name=name)
    path = folder / f"textured.{kind}"
    scene.export(path)
    return path
