"""World files for tests of the importers: a bumpy ground with things on it, in every format."""

from pathlib import Path

import numpy as np
import trimesh

Named = dict[str, trimesh.Trimesh]

SHARED_WORLDS = Path(__file__).resolve().parents[3] / "shared" / "data" / "worlds"
Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


def ground_height(xy: np.ndarray) -> np.ndarray:
    return 0.4 * np.sin(xy[..., 0] / 2.0) * np.cos(xy[..., 1] / 3.0)


def bumpy_ground(half_x: float = 10.0, half_y: float = 8.0, step: float = 0.25) -> trimesh.Trimesh:
    x, y = np.arange(-half_x, half_x + 1e-9, step), np.arange(-half_y, half_y + 1e-9, step)
    xy = np.stack(np.meshgrid(x, y), axis=-1)
    vertices = np.concatenate([xy, ground_height(xy)[..., None]], axis=-1).reshape(-1, 3)
    corner = (np.arange(len(y) - 1)[:, None] * len(x) + np.arange(len(x) - 1)).reshape(-1)
    up = np.stack([corner, corner + 1, corner + len(x) + 1], axis=-1)
    down = np.stack([corner, corner + len(x) + 1, corner + len(x)], axis=-1)
    return trimesh.Trimesh(vertices, np.concatenate([up, down]), process=False)


def box(x: float, y: float, bottom: float, size: tuple[float, float, float]) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(size)
    mesh.apply_translation([x, y, bottom + size[2] / 2])
    return mesh


CRATE, BENCH = (4.0, 3.0), (-5.0, -2.0)


def yard() -> Named:
    """A crate of 1 by 1 m, 1 m over the ground, and a bench of 2 by 0.6 m, both set into bumpy ground."""
    crate_ground, bench_ground = (float(ground_height(np.array(at))) for at in (CRATE, BENCH))
    return {
        "Terrain": bumpy_ground(),
        "Crate_01": box(*CRATE, crate_ground - 0.5, (1.0, 1.0, 1.5)),
        "Bench": box(*BENCH, bench_ground - 0.5, (2.0, 0.6, 1.1)),
    }


def joined(named: Named) -> trimesh.Trimesh:
    return trimesh.util.concatenate(
        [trimesh.Trimesh(m.vertices, m.faces, process=False) for m in named.values()]
    )


def write_yard(folder: Path, kind: str, named: Named | None = None) -> Path:
    """The yard as a file of that kind: .glb is y up, .dae is y up and in centimetres."""
    named = yard() if named is None else named
    path = folder / f"yard.{kind}"
    if kind in ("stl", "ply"):
        joined(named).export(path)
    elif kind == "obj":
        path.write_text(obj_text(named))
    elif kind == "glb":
        scene = trimesh.Scene()
        for name, mesh in named.items():
            scene.add_geometry(mesh.copy().apply_transform(Y_UP), node_name=name, geom_name=name)
        scene.export(path)
    elif kind == "dae":
        path.write_text(
            dae_text({n: m.copy().apply_transform(Y_UP).apply_scale(100.0) for n, m in named.items()})
        )
    return path


def obj_text(named: Named, head: str = "", material: str | None = None) -> str:
    lines, start = [head], 1
    for name, mesh in named.items():
        lines.append(f"o {name}")
        lines += [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in mesh.vertices]
        if material:
            lines.append(f"usemtl {material}")
        lines += ["f {} {} {}".format(*(face + start)) for face in mesh.faces]
        start += len(mesh.vertices)
    return "\n".join(lines) + "\n"


def dae_text(
    named: Named,
    *,
    unit: str = '<unit name="centimeter" meter="0.01"/>',
    axis: str = "Y_UP",
    before: str = "",
    picture: str | None = None,
    scene: str | None = None,
) -> str:
    """COLLADA with a node for each mesh, all with one material: a picture, or plain red-brown."""
    geometries, nodes = [], []
    for name, mesh in named.items():
        places = " ".join(f"{value:.5f}" for value in mesh.vertices.reshape(-1))
        uv = " ".join(f"{value:.4f}" for value in (mesh.vertices[:, :2] / 20.0 + 0.5).reshape(-1))
        index = " ".join(f"{v} {v}" for v in mesh.faces.reshape(-1))
        geometries.append(
            f'<geometry id="{name}-mesh" name="{name}"><mesh>'
            f'<source id="{name}-p">'
            f'<float_array id="{name}-pa" count="{mesh.vertices.size}">{places}</float_array>'
            f'<technique_common><accessor source="#{name}-pa" count="{len(mesh.vertices)}" stride="3">'
            '<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>'
            "</accessor></technique_common></source>"
            f'<source id="{name}-t">'
            f'<float_array id="{name}-ta" count="{2 * len(mesh.vertices)}">{uv}</float_array>'
            f'<technique_common><accessor source="#{name}-ta" count="{len(mesh.vertices)}" stride="2">'
            '<param name="S" type="float"/><param name="T" type="float"/>'
            "</accessor></technique_common></source>"
            f'<vertices id="{name}-v"><input semantic="POSITION" source="#{name}-p"/></vertices>'
            f'<triangles count="{len(mesh.faces)}" material="m">'
            f'<input semantic="VERTEX" source="#{name}-v" offset="0"/>'
            f'<input semantic="TEXCOORD" source="#{name}-t" offset="1" set="0"/><p>{index}</p></triangles>'
            "</mesh></geometry>"
        )
        nodes.append(
            f'<node id="{name}" name="{name}"><instance_geometry url="#{name}-mesh"><bind_material>'
            '<technique_common><instance_material symbol="m" target="#mat"/></technique_common>'
            "</bind_material></instance_geometry></node>"
        )
    image = (
        f'<library_images><image id="i"><init_from>{picture}</init_from></image></library_images>'
        if picture
        else ""
    )
    params = (
        '<newparam sid="s"><surface type="2D"><init_from>i</init_from></surface></newparam>'
        '<newparam sid="t"><sampler2D><source>s</source></sampler2D></newparam>'
        if picture
        else ""
    )
    diffuse = '<texture texture="t" texcoord="UV"/>' if picture else "<color>0.6 0.3 0.2 1</color>"
    return (
        f'<?xml version="1.0"?>{before}'
        '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">'
        "<asset><created>2020-01-01T00:00:00Z</created><modified>2020-01-01T00:00:00Z</modified>"
        f"{unit}<up_axis>{axis}</up_axis></asset>{image}"
        f'<library_effects><effect id="e"><profile_COMMON>{params}'
        f'<technique sid="c"><lambert><diffuse>{diffuse}'
        "</diffuse></lambert></technique></profile_COMMON></effect></library_effects>"
        '<library_materials><material id="mat" name="paint">'
        '<instance_effect url="#e"/></material></library_materials>'
        f"<library_geometries>{''.join(geometries)}</library_geometries>"
        f'<library_visual_scenes><visual_scene id="scene">{scene or "".join(nodes)}</visual_scene>'
        '</library_visual_scenes><scene><instance_visual_scene url="#scene"/></scene></COLLADA>'
    )
