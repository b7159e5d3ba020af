"""Worlds from mesh files: ground and things told apart, units and axes kept, bad files refused."""

import json
import os
import re
import struct

import numpy as np
import pytest
import trimesh
from batches import idle, metric
from PIL import Image
from pydantic import ValidationError
from world_files import (
    BENCH,
    CRATE,
    SHARED_WORLDS,
    box,
    bumpy_ground,
    dae_text,
    ground_height,
    joined,
    obj_text,
    write_yard,
    yard,
)

from dune_rl.config.compose import compose_environment
from dune_rl.env.batch import Batch
from dune_rl.errors import WorldError
from dune_rl.physics.bullet import BulletScene
from dune_rl.robots.rover_zero import RoverZero
from dune_rl.tasks.spawn import SpawnConf, Spawner
from dune_rl.worlds.importing.import_files import MAX_FILE_BYTES, WorldWarning
from dune_rl.worlds.importing.imported import ImportedWorld
from dune_rl.worlds.importing.imported_mesh import MeshConf, build_mesh
from dune_rl.worlds.importing.topology import boundary, welded

FORMATS = ("obj", "stl", "ply", "glb", "dae")
_built: dict[str, ImportedWorld] = {}


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    def of(kind: str) -> ImportedWorld:
        if kind not in _built:
            _built[kind] = build_mesh(MeshConf(path=str(write_yard(tmp_path_factory.mktemp(kind), kind))))
        return _built[kind]

    return of


def build(tmp_path, named, **settings) -> ImportedWorld:
    return build_mesh(MeshConf(path=str(write_yard(tmp_path, "obj", named)), **settings))


def batch_in(world) -> Batch:
    conf = compose_environment("flat", (), {"actors": "none"})
    batch = Batch(
        world=world,
        make_robot=lambda scenes: RoverZero(conf.robot, scenes),
        make_scene=BulletScene,
        actors=conf.actors,
        sensors=conf.sensors,
        physics=conf.physics,
        task=conf.task,
        metrics=conf.metrics,
        num_scenes=1,
        seed=3,
    )
    batch.reset()
    return batch


@pytest.mark.parametrize("kind", FORMATS)
def test_ground_and_things_are_recovered_from_every_format(built, kind):
    world = built(kind)
    np.testing.assert_allclose(world.extent, (-10, 10, -8, 8), atol=0.06)
    xy = np.random.default_rng(0).uniform([-9.8, -7.8], [9.8, 7.8], (4000, 2))
    # Half a cell of the file's own grid, bent by 0.1 / m: a few millimetres.
    assert np.abs(world.terrain.height(xy) - ground_height(xy)).max() < 0.01
    assert len(world.props) == 2
    crate, bench = sorted(world.props, key=lambda prop: -prop.vertices[:, 0].max())
    np.testing.assert_allclose(np.ptp(crate.vertices, axis=0), [1.0, 1.0, 1.5], atol=1e-3)
    np.testing.assert_allclose(np.ptp(bench.vertices, axis=0), [2.0, 0.6, 1.1], atol=1e-3)
    np.testing.assert_allclose(crate.vertices.mean(axis=0)[:2], CRATE, atol=1e-3)
    outside = np.maximum(np.abs(xy - CRATE) - 0.5, 0.0), np.maximum(np.abs(xy - BENCH) - [1.0, 0.3], 0.0)
    true = np.minimum(np.hypot(*outside[0].T), np.hypot(*outside[1].T))
    assert np.abs(world.clearance(xy) - true).max() < 0.11
    assert world.clearance(np.array(CRATE)) == 0.0


@pytest.mark.parametrize("kind", ["obj", "glb", "dae"])
def test_names_in_the_file_become_names_and_kinds(built, kind):
    assert {(prop.name, prop.kind) for prop in built(kind).props} == {
        ("Crate_01", "crate"),
        ("Bench", "bench"),
    }


@pytest.mark.parametrize("kind", FORMATS)
def test_props_are_closed_and_face_outward(built, kind):
    for prop in built(kind).props:
        start, _ = boundary(welded(prop.vertices, prop.faces))
        assert not len(start)
        a, b, c = np.moveaxis(prop.vertices[prop.faces], 1, 0)
        volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
        assert volume == pytest.approx(np.ptp(prop.vertices, axis=0).prod(), rel=1e-3)


def test_unit_and_axis_settings_stand_in_for_what_a_file_does_not_say(tmp_path):
    turned = joined(yard()).apply_transform([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    turned.apply_scale(1000.0)
    turned.export(tmp_path / "mm.stl")
    world = build_mesh(MeshConf(path=str(tmp_path / "mm.stl"), unit_m=0.001, up="y"))
    np.testing.assert_allclose(world.extent, (-10, 10, -8, 8), atol=0.06)
    assert abs(float(world.terrain.height([2.0, 1.0])) - ground_height(np.array([2.0, 1.0]))) < 0.01


def test_a_dae_in_metres_with_z_up_is_taken_as_it_is(tmp_path):
    path = tmp_path / "yard.dae"
    path.write_text(dae_text(yard(), unit='<unit name="meter" meter="1"/>', axis="Z_UP"))
    np.testing.assert_allclose(build_mesh(MeshConf(path=str(path))).extent, (-10, 10, -8, 8), atol=0.06)


def test_roofs_and_bridges_are_things_and_what_is_under_them_is_ground(tmp_path):
    canopy = trimesh.util.concatenate(
        [
            box(0, 5, 2.4, (3.0, 3.0, 0.1)),
            *(box(x, 5 + y, -0.8, (0.12, 0.12, 3.25)) for x in (-1.3, 1.3) for y in (-1.3, 1.3)),
        ]
    )
    deck = box(-4.0, 4.0, 0.9, (6.0, 2.0, 0.2))
    world = build(tmp_path, {"Terrain": bumpy_ground(), "canopy": canopy, "deck": deck})
    xy = np.array([[0.0, 5.0], [-4.0, 4.0]])
    np.testing.assert_allclose(world.terrain.height(xy), ground_height(xy), atol=0.01)
    assert {prop.name for prop in world.props} == {"canopy", "deck"}
    assert world.clearance(xy).min() > 0.5
    assert world.clearance(np.array([1.3, 6.3])) == 0.0


def test_a_roof_as_wide_as_the_floor_is_not_the_ground(tmp_path):
    floor, roof = box(0, 0, -0.2, (16, 12, 0.2)), box(0, 0, 3.0, (16.4, 12.4, 0.2))
    world = build(tmp_path, {"a": floor, "b": roof, "c": box(0, 0, 0, (0.5, 0.5, 3.1))})
    assert float(world.terrain.height([3.0, 3.0])) == pytest.approx(0.0, abs=1e-6)
    assert {prop.name for prop in world.props} == {"b", "c"}


def test_mounds_plates_and_tiles_join_the_ground(tmp_path):
    tiles = {f"tile{x}{y}": box(8 * x, 8 * y, -0.3, (8, 8, 0.3)) for x in (0, 1) for y in (0, 1)}
    mound = trimesh.creation.icosphere(3, 1.0)
    mound.vertices *= [2.5, 2.0, 0.3]
    mound.apply_translation([4.0, 4.0, -0.03])
    plate = box(8.0, 0.0, 0.0, (2.0, 1.0, 0.03))
    world = build(
        tmp_path, {**tiles, "mound": mound, "plate": plate, "block": box(0, 0, 0, (0.8, 0.8, 0.14))}
    )
    np.testing.assert_allclose(world.extent, (-4, 12, -4, 12), atol=0.06)
    assert float(world.terrain.height([4.0, 4.0])) == pytest.approx(0.27, abs=0.03)
    assert float(world.terrain.height([8.0, 0.0])) == pytest.approx(0.03, abs=1e-3)
    assert float(world.terrain.height([10.0, 10.0])) == pytest.approx(0.0, abs=1e-6)
    assert "block" in {prop.name for prop in world.props}
    assert not {"mound", "tile00", "tile11"} & {prop.name for prop in world.props}
    assert world.clearance(np.zeros(2)) == 0.0
    # A wheel takes the mound, but 0.14 m is an obstacle.
    assert world.clearance(np.array([4.0, 4.0])) > 2.0


def test_a_block_that_is_one_piece_with_the_ground_is_still_a_thing(tmp_path):
    ground = bumpy_ground(step=0.5)
    raised = (np.abs(ground.vertices[:, 0] - 3) < 0.8) & (np.abs(ground.vertices[:, 1] - 3) < 0.8)
    # Steep sides a tenth of a metre wide, as a scan would have them.
    ground.vertices[raised, 2] += 2.0
    world = build(tmp_path, {"scan": ground})
    assert world.clearance(np.array([3.0, 3.0])) == 0.0
    assert world.clearance(np.array([6.0, 3.0])) == pytest.approx(2.0, abs=0.4)
    (prop,) = world.props
    assert not len(boundary(welded(prop.vertices, prop.faces))[0])


def test_open_sheets_are_made_closed_and_block(tmp_path):
    wall = trimesh.Trimesh([[2, -4, -1], [2, 4, -1], [2, 4, 2], [2, -4, 2]], [[0, 1, 2], [0, 2, 3]])
    awning = trimesh.Trimesh([[-8, -2, 2], [-4, -2, 2], [-4, 2, 2], [-8, 2, 2]], [[0, 1, 2], [0, 2, 3]])
    shed = box(-3, -5, -1.0, (1.5, 1.5, 2.5))
    shed.update_faces(shed.face_normals[:, 2] > -0.5)
    world = build(tmp_path, {"Terrain": bumpy_ground(), "wall": wall, "awning": awning, "shed": shed})
    for prop in world.props:
        assert not len(boundary(welded(prop.vertices, prop.faces))[0]), prop.name
    assert world.clearance(np.array([2.0, 0.0])) < 0.05
    # Under the awning is free, and a box without a bottom is solid all the same.
    assert world.clearance(np.array([-6.0, 0.0])) > 1.0
    assert world.clearance(np.array([-3.0, -5.0])) == 0.0


def test_wires_thinner_than_a_cell_count_and_faces_on_each_other_do_not_block(tmp_path):
    wire = box(0, -4, -0.6, (0.01, 0.01, 3.0))
    lintel, roof = box(0, 4, 2.0, (4, 0.1, 0.4)), box(0, 4, 2.4, (6, 3, 0.2))
    world = build(tmp_path, {"Terrain": bumpy_ground(), "wire": wire, "lintel": lintel, "roof": roof})
    assert world.clearance(np.array([0.0, -4.0])) < 0.05
    x = np.linspace(-1.9, 1.9, 200)
    assert world.clearance(np.stack([x, np.full(200, 4.0)], axis=1)).min() > 1.0


def test_a_dome_for_the_sky_is_left_out_and_costs_nothing(tmp_path):
    dome = trimesh.creation.icosphere(2, 5000.0)
    with pytest.warns(WorldWarning, match="'dome' reaches far beyond the ground"):
        world = build(tmp_path, yard() | {"dome": dome, "sail": box(30, 0, -1, (60, 0.05, 40))})
    assert {prop.name for prop in world.props} == {"Crate_01", "Bench", "sail"}
    assert world.clearance(np.array([5.0, 0.0])) < 0.05
    assert world.clearance(np.array([-5.0, 4.0])) > 2.0


def test_holes_are_filled_smoothly_and_warned_of(tmp_path):
    ground = bumpy_ground()
    centre = ground.triangles_center
    ground.update_faces(np.hypot(centre[:, 0] + 4, centre[:, 1] - 2) > 1.5)
    path = write_yard(tmp_path, "obj", {"Terrain": ground})
    with pytest.warns(WorldWarning, match=r"yard.obj: 2\.\d% of its rectangle of 20 by 16 m has no ground"):
        world = build_mesh(MeshConf(path=str(path)))
    xy = np.stack(np.meshgrid(np.linspace(-5.5, -2.5, 30), np.linspace(0.5, 3.5, 30)), axis=-1)
    assert np.abs(world.terrain.height(xy) - ground_height(xy)).max() < 0.2
    assert np.rad2deg(world.terrain.slope(xy)).max() < 30.0


def test_names_of_the_ground_can_be_given(tmp_path):
    named = {"low": box(0, 0, -1, (20, 20, 1)), "high": box(0, 0, 4, (12, 12, 1))}
    assert build(tmp_path, named).terrain.heights.max() == pytest.approx(0.0, abs=1e-6)
    assert build(tmp_path, named, ground=("hi*",)).terrain.heights.max() == pytest.approx(5.0, abs=1e-6)
    with pytest.raises(WorldError, match="names none of the file's parts; it has high, low"):
        build(tmp_path, named, ground=("mid*",))


def test_a_finer_grid_is_finer_and_a_huge_one_refused(tmp_path):
    path = write_yard(tmp_path, "stl")
    world = build_mesh(MeshConf(path=str(path), spacing_m=0.5))
    assert world.terrain.heights.shape == (33, 41)
    with pytest.raises(
        WorldError, match=r"world.spacing_m=0.001? makes more|world.spacing_m=0.01 makes more"
    ):
        build_mesh(MeshConf(path=str(path), unit_m=10.0, spacing_m=0.01))
    with pytest.raises(WorldError, match=r"set world.unit_m|unit is right"):
        build_mesh(MeshConf(path=str(path), unit_m=1e4))


def test_a_region_is_chosen_where_there_is_room_and_a_user_s_is_kept(built, tmp_path):
    world = built("obj")
    xmin, xmax, ymin, ymax = world.region
    assert (xmax - xmin, ymax - ymin) == (8.0, 8.0)
    spawner = Spawner(world, SpawnConf(), 0.45)
    for seed in range(20):
        place = spawner.sample(np.random.default_rng(seed))
        assert world.clearance(np.array([place.x, place.y])) > 0.45
    path = write_yard(tmp_path, "stl")
    assert build_mesh(MeshConf(path=str(path), region=(-9, -7, 3, 5))).region == (-9, -7, 3, 5)
    with pytest.raises(WorldError, match=r"world.region must be"):
        build_mesh(MeshConf(path=str(path), region=(2, 1, 0, 1)))


def test_a_rover_stands_and_its_lidar_sees_the_things(tmp_path):
    path = write_yard(tmp_path, "glb")
    # Beside the crate, which is the nearest thing from all of it.
    world = build_mesh(MeshConf(path=str(path), region=(1.0, 3.0, 2.0, 4.0)))
    batch = batch_in(world)
    for _ in range(30):
        batch.step(idle(batch))
    position = batch.motion.position_w[0]
    assert 0.0 < float(position[2] - world.terrain.height(position[:2])) < 0.4
    assert np.abs(batch.motion.velocity_w[0]).max() < 0.02
    assert metric(batch, "collisions")[0] == 0
    away = np.maximum(np.abs(position[:2] - CRATE) - 0.5, 0.0)
    # The LiDAR sits 0.2 m from the rover's middle, and its beams are some 11 degrees apart.
    assert batch.observe()["lidar"].min() == pytest.approx(np.hypot(*away), abs=0.35)
    batch.close()


def picture(folder, name="paint.png") -> None:
    # Left half red, right half blue.
    pixels = np.zeros((8, 8, 3), np.uint8)
    pixels[:, :4], pixels[:, 4:] = (200, 20, 20), (20, 20, 200)
    Image.fromarray(pixels).save(folder / name)


def test_textures_colour_ground_and_things(tmp_path):
    picture(tmp_path)
    path = tmp_path / "yard.dae"
    path.write_text(dae_text(yard(), unit='<unit meter="1"/>', axis="Z_UP", picture="paint.png"))
    world = build_mesh(MeshConf(path=str(path)))
    # The texture is laid over x from -10 to 10.
    crate = next(prop for prop in world.props if prop.kind == "crate")
    bench = next(prop for prop in world.props if prop.kind == "bench")
    assert crate.colour == pytest.approx((20 / 255, 20 / 255, 200 / 255), abs=0.01)
    assert bench.colour == pytest.approx((200 / 255, 20 / 255, 20 / 255), abs=0.01)
    assert crate.face_colours.shape == (len(crate.faces), 3)
    columns = world.ground_colours.shape[1]
    assert world.ground_colours[:, : columns // 2 - 8, 0].min() > 0.7
    assert world.ground_colours[:, columns // 2 + 8 :, 2].min() > 0.7
    # The ground's one look is the mean of both.
    assert world.ground.low[0] == pytest.approx(world.ground.low[2], abs=0.02)


def test_textures_of_obj_and_glb_and_colours_of_vertices(tmp_path):
    picture(tmp_path)
    (tmp_path / "paint.mtl").write_text("newmtl paint\nKd 1 1 1\nmap_Kd paint.png\n")
    quad = "v -5 -5 0\nv 5 -5 0\nv 5 5 0\nv -5 5 0\nvt 0.6 0\nvt 1 0\nvt 1 1\nvt 0.6 1\n"
    (tmp_path / "q.obj").write_text(
        f"mtllib paint.mtl\no q\n{quad}usemtl paint\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"
    )
    blue = build_mesh(MeshConf(path=str(tmp_path / "q.obj"))).ground_colours
    np.testing.assert_allclose(blue.reshape(-1, 3).mean(axis=0), [20 / 255, 20 / 255, 200 / 255], atol=0.01)
    trimesh.load_scene(tmp_path / "q.obj", process=False).export(tmp_path / "q.glb")
    up = build_mesh(MeshConf(path=str(tmp_path / "q.glb"), up="z")).ground_colours
    np.testing.assert_allclose(up.reshape(-1, 3).mean(axis=0), [20 / 255, 20 / 255, 200 / 255], atol=0.01)
    sheet = trimesh.Trimesh([[-5, -5, 0], [5, -5, 0], [5, 5, 0], [-5, 5, 0]], [[0, 1, 2], [0, 2, 3]])
    sheet.visual.vertex_colors = [51, 102, 153, 255]
    sheet.export(tmp_path / "c.ply")
    own = build_mesh(MeshConf(path=str(tmp_path / "c.ply"))).ground_colours
    np.testing.assert_allclose(own.reshape(-1, 3), np.tile([0.2, 0.4, 0.6], (own.size // 3, 1)), atol=0.01)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("missing.png", "missing.png is missing"),
        ("../secret.png", "'../secret.png' leads out of the folder|../secret.png leads out of the folder"),
        ("/etc/hostname", "/etc/hostname leads out of the folder"),
        ("file:///etc/hostname", "leads out of the folder"),
        ("link.png", "link.png leads out of the folder"),
        ("bomb.png", "bomb.png is left out: it is no picture"),
        ("text.png", "text.png is left out: it is no picture"),
        (".", "is missing"),
    ],
)
@pytest.mark.parametrize("kind", ["dae", "obj"])
def test_textures_that_cannot_be_had_are_warnings(tmp_path, kind, name, said):
    folder = tmp_path / "world"
    folder.mkdir()
    picture(tmp_path, "secret.png")
    (folder / "link.png").symlink_to(tmp_path / "secret.png")
    (folder / "text.png").write_text("no picture")
    (folder / "bomb.png").write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + b"\0\0\0\rIHDR"
        + struct.pack(">IIBBBBB", 60000, 60000, 8, 2, 0, 0, 0)
        + b"\0" * 40
    )
    path = folder / f"q.{kind}"
    if kind == "dae":
        path.write_text(dae_text(yard(), unit='<unit meter="1"/>', axis="Z_UP", picture=name))
    else:
        (folder / "q.mtl").write_text(f"newmtl paint\nmap_Kd {name}\n")
        path.write_text(obj_text(yard(), "mtllib q.mtl", "paint"))
    with pytest.warns(WorldWarning, match=said) as caught:
        world = build_mesh(MeshConf(path=str(path)))
    assert len([w for w in caught if re.search(said, str(w.message))]) == 1
    assert len(world.props) == 2


def refused(path, match: str, **settings) -> None:
    with pytest.raises(WorldError, match=match) as caught:
        build_mesh(MeshConf(path=str(path), **settings))
    assert len(str(caught.value).splitlines()) <= 2


def test_what_is_no_mesh_is_refused_in_words(tmp_path):
    def file(name: str, data: bytes):
        path = tmp_path / name
        path.write_bytes(data)
        return path

    refused(tmp_path / "none.stl", "there is no file")
    refused(tmp_path, "ending|no plain file")
    refused(
        file("world.txt", b"hello"), r"has the ending .txt; meshes are read from .dae, .obj, .stl, .ply, .glb"
    )
    refused(file("empty.obj", b""), "is empty")
    for kind in FORMATS:
        refused(file(f"noise.{kind}", np.random.default_rng(1).bytes(5000)), "export it again")
        refused(file(f"text.{kind}", b"this is no mesh at all\n" * 9), "export|no triangles")
    refused(file("points.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"), "no triangles|that can be read")
    refused(
        file("wall.obj", b"v 0 0 0\nv 9 0 0\nv 9 0 3\nv 0 0 3\nf 1 2 3\nf 1 3 4\n"),
        "no triangle that faces up",
    )
    refused(file("tiny.obj", b"v 0 0 0\nv .1 0 0\nv .1 .1 0\nf 1 2 3\n"), "too little to drive on")
    refused(
        file("nan.obj", b"v 0 0 nan\nv 9 0 nan\nv 9 9 nan\nf 1 2 3\n"),
        "no triangles that can be used|that can be read",
    )
    refused(file("out.obj", b"v 0 0 0\nv 9 0 0\nv 9 9 0\nf 1 2 77\n"), "no triangles|that can be read")


def test_triangles_with_nan_are_left_out_with_a_warning(tmp_path):
    mesh = joined(yard())
    vertices = mesh.vertices.copy()
    vertices[100] = np.nan
    (tmp_path / "nan.stl").write_bytes(
        trimesh.Trimesh(vertices, mesh.faces, process=False).export(file_type="stl")
    )
    with pytest.warns(WorldWarning, match=r"nan.stl: has vertices that are NaN or infinite"):
        world = build_mesh(MeshConf(path=str(tmp_path / "nan.stl")))
    assert np.isfinite(world.terrain.heights).all()


def test_counts_that_a_file_does_not_hold_are_refused(tmp_path):
    stl = tmp_path / "claim.stl"
    stl.write_bytes(b"\0" * 80 + struct.pack("<I", 4_000_000_000) + b"\0" * 500)
    refused(stl, "claims 4,000,000,000 triangles and has room for 10")
    ply = tmp_path / "claim.ply"
    for form in (b"ascii", b"binary_little_endian"):
        ply.write_bytes(
            b"ply\nformat " + form + b" 1.0\nelement vertex 4000000000\nproperty float x\nproperty float y\n"
            b"property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
            + b"\0"
            * 99
        )
        refused(ply, "claims 4000000000 items of 'vertex'")
    header = json.dumps(
        {
            "asset": {"version": "2.0"},
            "accessors": [{"componentType": 5126, "count": 4_000_000_000, "type": "VEC3"}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
            "nodes": [{"mesh": 0}],
            "scenes": [{"nodes": [0]}],
        }
    ).encode()
    header += b" " * (-len(header) % 4)
    glb = tmp_path / "claim.glb"
    glb.write_bytes(struct.pack("<IIIII", 0x46546C67, 2, 20 + len(header), len(header), 0x4E4F534A) + header)
    refused(glb, "an accessor claims 4000000000 items")


def glb_with_nodes(path, nodes) -> None:
    # A real one, with its nodes exchanged.
    data = path.read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    header = json.loads(data[20 : 20 + length])
    header["nodes"] = nodes(header["nodes"])
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    path.write_bytes(
        struct.pack("<IIIII", 0x46546C67, 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A) + text + rest
    )


def test_nodes_that_contain_themselves_or_multiply_are_refused(tmp_path):
    path = write_yard(tmp_path, "glb")
    glb_with_nodes(path, lambda nodes: [{"children": [1]}, {"children": [0], "mesh": 0}, *nodes[2:]])
    refused(path, "loop")
    path = write_yard(tmp_path, "glb")
    glb_with_nodes(path, lambda nodes: [*nodes, *({"mesh": 0} for _ in range(3000))])
    refused(path, "more than 4,000,000 triangles")
    # A COLLADA whose nodes are instances of nodes, tenfold on each of nine levels.
    levels = "".join(
        f'<node id="n{k}">' + f'<instance_node url="#n{k - 1}"/>' * 10 + "</node>" for k in range(1, 10)
    )
    ends = '<node id="n0"><instance_geometry url="#Crate_01-mesh"/></node>'
    (tmp_path / "many.dae").write_text(dae_text(yard(), scene=f"{ends}{levels}"))
    refused(tmp_path / "many.dae", "nodes that contain themselves|more than 20,000|more than 4,000,000")


ENTITIES = '<!DOCTYPE x [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;">]>'


@pytest.mark.parametrize(
    "before",
    [
        ENTITIES,
        '<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]>',
        '<!DOCTYPE x [<!ENTITY % a SYSTEM "http://127.0.0.1:9/x.dtd"> %a;]>',
    ],
)
def test_xml_entities_are_refused(tmp_path, before):
    path = tmp_path / "bomb.dae"
    path.write_text(
        dae_text({"a": box(0, 0, 0, (5, 5, 1))}, before=before).replace(
            "paint", "&b;" if before is ENTITIES else "&a;"
        )
    )
    refused(path, "declares XML entities or refers to external ones")


def test_deep_xml_and_archives_are_refused(tmp_path):
    (tmp_path / "deep.dae").write_bytes(b"<a>" * 200_000 + b"</a>" * 200_000)
    refused(tmp_path / "deep.dae", "nested more than 128 deep")
    (tmp_path / "zip.dae").write_bytes(b"PK\x03\x04" + b"\0" * 100)
    refused(tmp_path / "zip.dae", "no valid XML")


def test_files_that_are_too_large_or_no_files_are_not_read(tmp_path):
    large = tmp_path / "large.stl"
    with large.open("wb") as file:
        file.truncate(5 * 2**30)
    refused(large, f"has 5,120 MiB, and at most {MAX_FILE_BYTES // 2**20} are read")
    os.mkfifo(tmp_path / "pipe.obj")
    refused(tmp_path / "pipe.obj", "no plain file")


def test_a_mesh_far_from_its_origin_is_moved_there(tmp_path):
    mesh = joined(yard())
    mesh.apply_translation([500_000.0, 5_000_000.0, 1200.0])
    (tmp_path / "utm.obj").write_text(obj_text({"Terrain": mesh}))
    with pytest.warns(WorldWarning, match="lies far from its origin and is moved there"):
        world = build_mesh(MeshConf(path=str(tmp_path / "utm.obj")))
    np.testing.assert_allclose(world.extent, (-10, 10, -8, 8), atol=1.0)
    assert np.ptp(world.terrain.heights) < 1.0


@pytest.mark.parametrize(
    "wrong", [{"path": ""}, {"spacing_m": 0}, {"unit_m": -1}, {"up": "w"}, {"friction": 0}, {"pathh": "x"}]
)
def test_bad_settings_are_refused(wrong):
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        MeshConf(**({"path": "x"} | wrong))


def test_the_same_file_gives_the_same_world(built, tmp_path):
    again = build_mesh(MeshConf(path=str(write_yard(tmp_path, "glb"))))
    np.testing.assert_array_equal(again.terrain.heights, built("glb").terrain.heights)
    for first, second in zip(again.props, built("glb").props, strict=True):
        np.testing.assert_array_equal(first.vertices, second.vertices)


@pytest.mark.skipif(not SHARED_WORLDS.is_dir(), reason="the worlds of others are not here")
def test_the_agriculture_world():
    path = SHARED_WORLDS / "agriculture_world.dae"
    with pytest.warns(WorldWarning) as caught:
        world = build_mesh(MeshConf(path=str(path)))
    assert all(re.search(r"\.jpg is missing: what it colours", str(w.message)) for w in caught)
    assert len({str(w.message) for w in caught}) == len(caught) == 6
    np.testing.assert_allclose(np.diff(world.extent)[[0, 2]], [120, 160], atol=0.5)
    assert world.terrain.heights.min() == pytest.approx(-4.84, abs=0.05)
    assert world.terrain.heights.max() == pytest.approx(1.70, abs=0.05)
    kinds = [prop.kind for prop in world.props]
    assert kinds.count("solar panels") == 43
    assert "barn" in kinds
    # Through the barn's door, and not through its walls.
    assert world.clearance(np.array([-1.5, 4.8])) > 2.0
    assert world.clearance(np.array([-10.0, 4.8])) < 0.1
    assert world.clearance(np.array([-1.5, 20.0])) > 5.0
    place = Spawner(world, SpawnConf(), 0.45).sample(np.random.default_rng(0))
    assert world.clearance(np.array([place.x, place.y])) > 0.45
