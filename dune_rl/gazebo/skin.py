"""COLLADA files of rigid skins: a mesh on a skeleton of one bone, with an animation in which it rests.

Gazebo moves actors whose skin has a skeleton, and older versions draw no others.
"""

from collections.abc import Iterable
from xml.etree.ElementTree import Element

import numpy as np

from dune_rl.gazebo.elements import add, document_text, words
from dune_rl.gazebo.mesh_folder import MeshFolder
from dune_rl.gazebo.painted_mesh import PaintedMesh, corner_rows
from dune_rl.geometry.arrays import Array

_NAMESPACE = "http://www.collada.org/2005/11/COLLADASchema"
_BONE = "bone"
_UNIT = words(np.eye(4).reshape(-1))
# Length of the animation [s], which Gazebo repeats.
_LENGTH_S = 1.0


def write_skin(folder: MeshFolder, name: str, mesh: PaintedMesh) -> str:
    """Write a mesh as the skin of an actor, which is its animation, too; returns the file's path."""
    root = Element("COLLADA", xmlns=_NAMESPACE, version="1.4.1")
    asset = add(root, "asset")
    # The schema wants times; those of the writing would make equal files differ.
    for tag in ("created", "modified"):
        add(asset, tag, "2000-01-01T00:00:00Z")
    add(asset, "unit", name="meter", meter="1")
    add(asset, "up_axis", "Z_UP")
    pictures = [
        None if part.picture is None else folder.write_picture(name, part.picture) for part in mesh.parts
    ]
    _add_materials(root, mesh, pictures)
    count = _add_geometry(root, mesh)
    _add_skin(root, count)
    _add_animation(root)
    _add_scene(root, mesh)
    return folder.write_file(name, ".dae", document_text(root).encode())


def _add_materials(root: Element, mesh: PaintedMesh, pictures: list[str | None]) -> None:
    images, effects, materials = (add(root, f"library_{kind}") for kind in ("images", "effects", "materials"))
    for number, (part, picture) in enumerate(zip(mesh.parts, pictures, strict=True)):
        profile = add(add(effects, "effect", id=f"effect_{number}"), "profile_COMMON")
        if picture is not None:
            add(add(images, "image", id=f"image_{number}"), "init_from", picture)
            surface = add(add(profile, "newparam", sid=f"surface_{number}"), "surface", type="2D")
            add(surface, "init_from", f"image_{number}")
            sampler = add(add(profile, "newparam", sid=f"sampler_{number}"), "sampler2D")
            add(sampler, "source", f"surface_{number}")
        diffuse = add(add(add(profile, "technique", sid="common"), "lambert"), "diffuse")
        if picture is None:
            add(diffuse, "color", words([*part.colour, 1.0]))
        else:
            add(diffuse, "texture", texture=f"sampler_{number}", texcoord="UV")
        material = add(materials, "material", id=f"material_{number}", name=f"material_{number}")
        add(material, "instance_effect", url=f"#effect_{number}")
    if not len(images):
        root.remove(images)


def _add_geometry(root: Element, mesh: PaintedMesh) -> int:
    """Add the mesh with three vertices for each face; returns the number of vertices."""
    geometry = add(add(root, "library_geometries"), "geometry", id="shape", name="shape")
    holder = add(geometry, "mesh")
    rows = [corner_rows(mesh, part) for part in mesh.parts]
    positions, normals, uv = (np.concatenate(column) for column in zip(*rows, strict=True))
    _add_floats(holder, "positions", positions, ("X", "Y", "Z"))
    _add_floats(holder, "normals", normals, ("X", "Y", "Z"))
    _add_floats(holder, "map", uv, ("S", "T"))
    add(add(holder, "vertices", id="vertices"), "input", semantic="POSITION", source="#positions")
    start = 0
    for number, part in enumerate(mesh.parts):
        triangles = add(holder, "triangles", count=str(len(part.faces)), material=f"material_{number}")
        for offset, (semantic, source) in enumerate(
            (("VERTEX", "vertices"), ("NORMAL", "normals"), ("TEXCOORD", "map"))
        ):
            extra = {"set": "0"} if semantic == "TEXCOORD" else {}
            add(triangles, "input", semantic=semantic, source=f"#{source}", offset=str(offset), **extra)
        index = np.arange(start, start + 3 * len(part.faces))
        add(triangles, "p", " ".join(map(str, np.repeat(index, 3).tolist())))
        start += 3 * len(part.faces)
    return start


def _add_skin(root: Element, count: int) -> None:
    """Add the skin: all vertices follow the bone."""
    skin = add(add(add(root, "library_controllers"), "controller", id="skin"), "skin", source="#shape")
    add(skin, "bind_shape_matrix", _UNIT)
    _add_source(skin, "joints", "Name_array", _BONE, (1, 1), ("JOINT",), "name")
    _add_floats(skin, "bind_poses", np.eye(4).reshape(1, 16), ("TRANSFORM",), "float4x4")
    _add_floats(skin, "weights", np.ones((1, 1)), ("WEIGHT",))
    joints = add(skin, "joints")
    add(joints, "input", semantic="JOINT", source="#joints")
    add(joints, "input", semantic="INV_BIND_MATRIX", source="#bind_poses")
    weights = add(skin, "vertex_weights", count=str(count))
    add(weights, "input", semantic="JOINT", source="#joints", offset="0")
    add(weights, "input", semantic="WEIGHT", source="#weights", offset="1")
    add(weights, "vcount", " ".join(["1"] * count))
    add(weights, "v", " ".join(["0 0"] * count))


def _add_animation(root: Element) -> None:
    animation = add(add(root, "library_animations"), "animation", id="rest", name="rest")
    _add_floats(animation, "times", np.array([[0.0], [_LENGTH_S]]), ("TIME",))
    _add_floats(animation, "poses", np.tile(np.eye(4).reshape(1, 16), (2, 1)), ("TRANSFORM",), "float4x4")
    _add_source(
        animation, "interpolations", "Name_array", "LINEAR LINEAR", (2, 1), ("INTERPOLATION",), "name"
    )
    sampler = add(animation, "sampler", id="sampler")
    for semantic, source in (("INPUT", "times"), ("OUTPUT", "poses"), ("INTERPOLATION", "interpolations")):
        add(sampler, "input", semantic=semantic, source=f"#{source}")
    add(animation, "channel", source="#sampler", target=f"{_BONE}/transform")


def _add_scene(root: Element, mesh: PaintedMesh) -> None:
    scene = add(add(root, "library_visual_scenes"), "visual_scene", id="scene", name="scene")
    bone = add(scene, "node", id=_BONE, name=_BONE, sid=_BONE, type="JOINT")
    add(bone, "matrix", _UNIT, sid="transform")
    body = add(scene, "node", id="body", name="body", type="NODE")
    add(body, "matrix", _UNIT, sid="transform")
    instance = add(body, "instance_controller", url="#skin")
    add(instance, "skeleton", f"#{_BONE}")
    bound = add(add(instance, "bind_material"), "technique_common")
    for number, part in enumerate(mesh.parts):
        symbol = f"material_{number}"
        used = add(bound, "instance_material", symbol=symbol, target=f"#{symbol}")
        if part.picture is not None:
            add(used, "bind_vertex_input", semantic="UV", input_semantic="TEXCOORD", input_set="0")
    add(add(root, "scene"), "instance_visual_scene", url="#scene")


def _add_floats(
    parent: Element, name: str, values: Array, params: Iterable[str], kind: str = "float"
) -> None:
    """Add a <source> of `values` (N, n), each row of which has the named `params` of type `kind`."""
    _add_source(parent, name, "float_array", words(values.reshape(-1)), values.shape, params, kind)


def _add_source(
    parent: Element, name: str, tag: str, text: str, shape: tuple[int, ...], params: Iterable[str], kind: str
) -> None:
    """Add a <source>: an array `tag` of `shape` (N, n), each row with the `params` of type `kind`."""
    source, (rows, columns) = add(parent, "source", id=name), shape
    add(source, tag, text, id=f"{name}_array", count=str(rows * columns))
    size = {"count": str(rows), "stride": str(columns)}
    access = add(add(source, "technique_common"), "accessor", source=f"#{name}_array", **size)
    for param in params:
        add(access, "param", name=param, type=kind)
