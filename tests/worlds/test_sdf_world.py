"""Worlds from Gazebo files: shapes, poses, includes and lights taken over."""

import re
import shutil
import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh
from gazebo import GROUND, PLANE, include, model, sdf, write_model
from PIL import Image
from simulations import simulation_on
from world_files import SHARED_WORLDS, box, bumpy_ground, dae_text, ground_height, write_yard

from dune_rl.core.untrusted_files import WorldWarning
from dune_rl.tasks.spawn import SpawnConf, Spawner
from dune_rl.worlds.importing.imported_world import ImportedWorld
from dune_rl.worlds.importing.sdf.build import SdfConf, build_sdf

MU = "<surface><friction><ode><mu>{}</mu></ode></friction></surface>"


@pytest.fixture(autouse=True)
def _no_resources(monkeypatch):
    monkeypatch.delenv("GZ_SIM_RESOURCE_PATH", raising=False)


def build(folder: Path, *models: str, **settings) -> ImportedWorld:
    (folder / "w.sdf").write_text(sdf(*models))
    return build_sdf(SdfConf(path=str(folder / "w.sdf"), **settings))


def sizes(world: ImportedWorld) -> dict[str, np.ndarray]:
    return {prop.name: np.ptp(prop.vertices, axis=0) for prop in world.props}


def middles(world: ImportedWorld) -> dict[str, np.ndarray]:
    return {prop.name: (prop.vertices.min(axis=0) + prop.vertices.max(axis=0)) / 2 for prop in world.props}


def test_simple_shapes_stand_where_they_should_on_a_plane(tmp_path):
    world = build(
        tmp_path,
        GROUND,
        model("crate", "<box><size>1 2 3</size></box>", "4 0 1.5 0 0 1.5707963"),
        model("pillar", "<cylinder><radius>0.5</radius><length>2</length></cylinder>", "-4 0 1 0 0 0"),
        model("ball", "<sphere><radius>0.7</radius></sphere>", "0 5 0.6 0 0 0"),
        model("pill", "<capsule><radius>0.3</radius><length>1</length></capsule>", "0 -5 0.8 0 0 0"),
        model("egg", "<ellipsoid><radii>0.3 0.4 0.9</radii></ellipsoid>", "5 5 0.5 0 0 0"),
        model("nothing", "<empty/>"),
    )
    assert world.extent == pytest.approx((-20, 20, -15, 15), abs=0.1)
    assert (world.terrain.heights == 0).all()
    found, at = sizes(world), middles(world)
    expected = {
        "crate": ([2, 1, 3], [4, 0, 1.5]),
        "pillar": ([1, 1, 2], [-4, 0, 1]),
        "ball": ([1.4, 1.4, 1.4], [0, 5, 0.6]),
        "pill": ([0.6, 0.6, 1.6], [0, -5, 0.8]),
        "egg": ([0.6, 0.8, 1.8], [5, 5, 0.5]),
    }
    assert set(found) == set(expected)
    for name, (size, middle) in expected.items():
        np.testing.assert_allclose(found[name], size, atol=0.03, err_msg=name)
        np.testing.assert_allclose(at[name], middle, atol=0.02, err_msg=name)
    assert world.clearance(np.array([4.0, 0.0])) == 0.0
    assert world.clearance(np.array([4.0, 2.5])) == pytest.approx(2.0, abs=0.1)


def test_poses_are_chained_and_may_be_in_degrees_or_quaternions(tmp_path):
    inner = (
        '<model name="outer"><static>1</static><pose degrees="true">1 0 0 0 0 90</pose>'
        '<model name="inner"><static>1</static><pose>2 0 0 0 0 0</pose>'
        '<link name="l"><pose rotation_format="quat_xyzw">0 0 1 0 0 0.70710678 0.70710678</pose>'
        '<collision name="c"><pose>0.5 0 0 0 0 0</pose><geometry><box><size>0.2 0.4 1</size></box></geometry>'
        "</collision></link></model></model>"
    )
    world = build(tmp_path, GROUND, inner)
    (name,) = sizes(world)
    # Half a turn in all: 2 ahead of a model that faces +y, then 0.5 along -x.
    np.testing.assert_allclose(middles(world)[name], [0.5, 2.0, 1.0], atol=1e-4)
    np.testing.assert_allclose(sizes(world)[name], [0.2, 0.4, 1.0], atol=1e-4)


def test_a_mesh_is_scaled_and_its_folder_found(tmp_path):
    own = write_model(
        tmp_path,
        "hut",
        model("hut", "<mesh><uri>model://hut/meshes/hut.dae</uri><scale>2 1 0.5</scale></mesh>"),
    )
    (own / "meshes").mkdir()
    (own / "materials").mkdir()
    Image.new("RGB", (4, 4), (20, 200, 20)).save(own / "materials" / "green.png")
    text = dae_text(
        {"hut": box(0, 0, 0, (1, 1, 2))},
        unit='<unit meter="1"/>',
        axis="Z_UP",
        picture="../materials/green.png",
    )
    (own / "meshes" / "hut.dae").write_text(text)
    world = build(
        tmp_path, GROUND, include("model://hut", "3 1 0 0 0 0", "hut_1"), include("hut", "-3 1 0 0 0 0")
    )
    assert len(world.props) == 2
    for prop, x in zip(world.props, (3, -3), strict=True):
        np.testing.assert_allclose(np.ptp(prop.vertices, axis=0), [2, 1, 1], atol=1e-3)
        np.testing.assert_allclose(prop.vertices[:, 0].mean(), x, atol=1e-3)
        assert prop.colour == pytest.approx((20 / 255, 200 / 255, 20 / 255), abs=0.01)
        assert prop.kind == "hut"


def test_includes_may_be_nested_and_come_from_the_resource_path(tmp_path, monkeypatch):
    post = model("post", "<cylinder><radius>0.2</radius><length>2</length></cylinder>", "0 0 1 0 0 0")
    write_model(tmp_path / "elsewhere", "post", post)
    posts = include("model://post", "0 1 0 0 0 0", "a") + include("package://post", "0 -1 0 0 0 0", "b")
    gate = f'<model name="gate"><static>1</static>{posts}</model>'
    write_model(tmp_path / "here" / "models", "gate", gate)
    with pytest.warns(WorldWarning, match="://post is missing.*GZ_SIM_RESOURCE_PATH"):
        assert not build(tmp_path / "here", GROUND, include("model://gate", "5 0 0 0 0 0")).props
    monkeypatch.setenv("GZ_SIM_RESOURCE_PATH", f"/nowhere:{tmp_path / 'elsewhere'}")
    world = build(tmp_path / "here", GROUND, include("model://gate", "5 0 0 0 0 1.5707963"))
    np.testing.assert_allclose(sorted(m[0] for m in middles(world).values()), [4, 6], atol=1e-3)


def height_map(uri: str, more: str = "", size: str = "20 16 0.8", pos: str = "0 0 0") -> str:
    return f"<heightmap><uri>{uri}</uri><size>{size}</size><pos>{pos}</pos>{more}</heightmap>"


def write_heights(path: Path) -> None:
    x, y = np.linspace(-10, 10, 101), np.linspace(8, -8, 81)
    heights = ground_height(np.stack(np.meshgrid(x, y), axis=-1))
    Image.fromarray(np.round((heights + 0.4) / 0.8 * 65535).astype(np.uint16)).save(path)


def test_a_height_map_is_the_terrain_and_things_stand_on_it(tmp_path):
    write_heights(tmp_path / "h.png")
    world = build(
        tmp_path,
        model("land", height_map("h.png", pos="1 2 -0.4"), "0 0 3 0 0 0"),
        model("crate", "<box><size>1 1 1</size></box>", "4 3 3.2 0 0 0"),
    )
    np.testing.assert_allclose(world.extent, (-9, 11, -6, 10), atol=1e-9)
    xy = np.random.default_rng(0).uniform([-9, -6], [11, 10], (500, 2))
    np.testing.assert_allclose(world.terrain.height(xy), ground_height(xy - [1, 2]) + 3.0, atol=0.004)
    assert [prop.name for prop in world.props] == ["crate"]
    assert world.clearance(np.array([4.0, 3.0])) == 0.0


@pytest.mark.parametrize(("low", "high", "size"), [(-0.98, 5.59, 6.575), (-3.0, -1.0, 2.0)])
def test_heights_in_metres_are_scaled_about_the_lowest(tmp_path, low, high, size):
    # As of a public site whose rocks lay underground.
    x, y = np.meshgrid(np.linspace(0.0, 1.0, 81), np.linspace(0.0, 1.0, 81))
    samples = (low + (high - low) * (0.5 + 0.5 * np.sin(3.0 * x) * np.cos(2.0 * y))).astype(np.float64)
    samples = low + (samples - samples.min()) * ((high - low) / np.ptp(samples))
    np.save(tmp_path / "h.npy", samples)
    world = build(tmp_path, model("land", height_map("h.npy", size=f"20 20 {size}"), "0 0 0 0 0 0"))
    heights = world.terrain.heights
    assert heights.min() == pytest.approx(low, abs=1e-6)
    assert heights.max() == pytest.approx(low + size, abs=1e-6)


def test_a_turned_height_map_is_sampled(tmp_path):
    write_heights(tmp_path / "h.png")
    world = build(tmp_path, model("land", height_map("h.png"), "0 0 -0.4 0 0 1.5707963267948966"))
    np.testing.assert_allclose(world.extent, (-8, 8, -10, 10), atol=0.1)
    xy = np.random.default_rng(0).uniform([-7.8, -9.8], [7.8, 9.8], (500, 2))
    turned = np.stack([xy[:, 1], -xy[:, 0]], axis=1)
    assert np.abs(world.terrain.height(xy) - ground_height(turned)).max() < 0.01


def test_a_terrain_mesh_takes_the_place_of_the_plane(tmp_path):
    write_yard(tmp_path, "obj", {"land": bumpy_ground()})
    with pytest.warns(WorldWarning, match="its <plane> is left out, since the mesh 'hills' is the ground"):
        world = build(tmp_path, GROUND, model("hills", "<mesh><uri>yard.obj</uri></mesh>", "0 0 0.6 0 0 0"))
    assert world.extent == pytest.approx((-10, 10, -8, 8), abs=0.1)
    assert float(world.terrain.height([2.0, 1.0])) == pytest.approx(
        ground_height(np.array([2.0, 1.0])) + 0.6, abs=0.01
    )
    assert not world.props


def test_colours_lights_and_friction(tmp_path):
    paint = "<material><diffuse>0.9 0.1 0.1 1</diffuse></material>"
    red = f"<visual name='v'><geometry><box/></geometry>{paint}</visual>"
    sun = '<light name="sun" type="directional"><direction>-1 0 -1</direction>'
    sun += "<cast_shadows>false</cast_shadows></light>"
    world = build(
        tmp_path,
        sun,
        PLANE.format(surface=MU.format(0.7)),
        model("crate", "<box><size>1 1 1</size></box>", inside=red),
    )
    assert world.props[0].colour == pytest.approx((0.9, 0.1, 0.1), abs=1e-5)
    assert world.friction == 0.7
    assert world.light is not None
    assert (world.light.sun_bearing_deg, world.light.sun_elevation_deg) == pytest.approx((0.0, 45.0))
    assert not world.light.shadows
    assert build(tmp_path, PLANE.format(surface=MU.format(0.7)), friction=0.4).friction == 0.4
    assert build(tmp_path, GROUND).friction == 1.0
    with pytest.warns(WorldWarning, match="has a friction of -1; 0.01 is used"):
        assert build(tmp_path, PLANE.format(surface=MU.format(-1))).friction == 0.01


@pytest.mark.parametrize(("mu", "smaller"), [(100.0, 0.6), (0.4, 0.4)])
def test_of_two_frictions_the_smaller_acts(tmp_path, mu, smaller):
    """Gazebo's stock ground plane has a mu of 100."""
    world = build(tmp_path, PLANE.format(surface=MU.format(mu)))
    simulation = simulation_on(world, robot={"name": "rover_zero", "wheel_friction": 0.6})
    engine = simulation.scenes.robots(0)[0]
    given = []
    engine.set_wheel_contacts = lambda friction, *others: given.append(friction)
    simulation.reset()
    simulation.close()
    assert simulation.scenes._specs[world].statics[0].friction == 1.0
    assert given == ([[0.4] * 4] if smaller == 0.4 else [])


def test_what_can_only_be_seen_stops_nobody(tmp_path):
    ghost = (
        '<model name="ghost"><static>true</static><link name="l"><visual name="v"><pose>3 0 0.5 0 0 0</pose>'
        "<geometry><box><size>1 1 1</size></box></geometry></visual></link></model>"
    )
    world = build(tmp_path, GROUND, ghost)
    assert [(prop.name, prop.solid) for prop in world.props] == [("ghost", False)]
    assert world.clearance(np.array([3.0, 0.0])) == np.inf


def test_what_is_not_supported_is_named_once(tmp_path):
    moving = model(
        "cart", "<box><size>1 1 1</size></box>", "5 5 0.5 0 0 0", "<sensor name='s'/>", static="false"
    )
    with pytest.warns(WorldWarning) as caught:
        build(
            tmp_path,
            GROUND,
            moving,
            moving,
            "<plugin name='p'/><plugin name='q'/><actor name='a'/><road name='r'/><gravity>0 0 -3</gravity>",
            model("line", "<polyline/>"),
            '<light name="lamp" type="point"/>',
            include("https://fuel.gazebosim.org/1.0/openrobotics/models/x"),
            '<model name="odd"><static>1</static><pose relative_to="cart">1 0 0 0 0 0</pose></model>',
        )
    texts = [str(w.message) for w in caught]
    for said in (
        "<plugin> is not supported",
        "the actor 'a' has no <trajectory>",
        "<road> is not supported",
        "<sensor> is not supported",
        "<polyline> as a shape is not supported",
        "lights of type 'point' are left out",
        "https:// addresses are not supported",
        "models that are not <static> do not move here",
        "<pose relative_to> is not supported",
    ):
        assert len([text for text in texts if said in text]) == 1, said
    assert len(texts) == 9


@pytest.mark.skipif(not SHARED_WORLDS.is_dir(), reason="the worlds of others are not here")
def test_the_mars_yard_and_the_farm_in_one_world(tmp_path, monkeypatch):
    folder = SHARED_WORLDS / "marsyard2022_terrain"
    with pytest.warns(WorldWarning) as caught:
        world = build_sdf(SdfConf(path=str(folder)))
    missing = [re.search(r"(\w+)\.png is missing", str(w.message))[1] for w in caught]
    assert sorted(missing) == ["flat_normal", "marsyard2022_terrain_texture"]
    assert world.terrain.heights.shape == (257, 257)
    assert world.terrain.heights.min() == pytest.approx(0.0144, abs=1e-3)
    assert world.terrain.heights.max() == pytest.approx(4.8208, abs=1e-4)
    assert world.extent == (-25, 25, -25, 25)
    assert not world.props
    Spawner(world, SpawnConf(), 0.45).sample(np.random.default_rng(0))
    # As a resource, included by a world elsewhere, with something put on it.
    monkeypatch.setenv("GZ_SIM_RESOURCE_PATH", str(SHARED_WORLDS))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", WorldWarning)
        other = build(
            tmp_path,
            include("model://marsyard2022_terrain", "10 0 1 0 0 0"),
            model("lander", "<box><size>2 2 3</size></box>", "10 0 2 0 0 0"),
        )
    np.testing.assert_allclose(other.terrain.heights, world.terrain.heights + 1.0)
    assert other.extent == (-15, 35, -25, 25)
    assert other.clearance(np.array([10.0, 0.0])) == 0.0


def test_a_folder_that_moved_is_the_same_world(tmp_path):
    own = write_model(tmp_path, "hut", GROUND + model("hut", "<mesh><uri>model://hut/hut.stl</uri></mesh>"))
    (own / "hut.stl").write_bytes(
        trimesh.Trimesh(**box(3, 3, 0, (1, 1, 1)).to_dict()).export(file_type="stl")
    )
    first = build_sdf(SdfConf(path=str(own)))
    shutil.move(own, tmp_path / "elsewhere")
    with pytest.warns(WorldWarning, match="model://hut/hut.stl is missing"):
        assert not build_sdf(SdfConf(path=str(tmp_path / "elsewhere"))).props
    shutil.move(tmp_path / "elsewhere", own)
    np.testing.assert_array_equal(
        build_sdf(SdfConf(path=str(own))).props[0].vertices, first.props[0].vertices
    )
