"""The worlds: their figures, their props' footing, and the clearance they tell."""

import numpy as np
import pytest
from pydantic import ValidationError
from world_digest import digest
from world_measures import SEEDS, cached, digest_in_another_process, grid

from dune_rl.geometry.heightfield import HeightField
from dune_rl.geometry.rays import RayScene
from dune_rl.worlds.flat import FlatConf, build_flat
from dune_rl.worlds.inspection.build import InspectionConf, build_inspection
from dune_rl.worlds.passage import FreeSpace
from dune_rl.worlds.props import beam, merge_meshes, slab, tube, upright_box
from dune_rl.worlds.world import Prop, World

inspection = cached(lambda seed: build_inspection(InspectionConf(seed=seed)))


def level_world(*props: Prop, half: float = 10.0) -> World:
    terrain = HeightField(np.zeros((5, 5)), half / 2, (-half, -half))
    return World("test", terrain, props, region=(-4, 4, -4, 4))


def prop(mesh, **kwargs) -> Prop:
    return Prop("thing", "thing", *mesh, **kwargs)


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


@pytest.mark.parametrize(
    ("mesh", "expected"),
    [
        (slab([1, 2, 3], np.eye(3), [1, 2, 3]), 6.0),
        (upright_box([4, 5], 0.7, -1.0, 2.0, 0.5, 0.4), 0.6),
        (beam([0, 0, 0], [3, 4, 0], 0.2, 0.1), 0.1),
        (tube([0, 0, 0], [0, 0, 2], 1.0, sides=200), 2 * np.pi),
        (tube([1, 1, 1], [2, 3, 0], 0.5, bore=0.25, sides=200), np.pi * (0.25 - 0.0625) * np.sqrt(6)),
    ],
)
def test_primitives_are_closed_and_face_outward(mesh, expected):
    vertices, faces = mesh
    assert volume(vertices, faces) == pytest.approx(expected, rel=1e-3)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    assert len(np.unique(edges, axis=0)) == len(edges)
    assert {tuple(edge) for edge in edges} == {tuple(edge[::-1]) for edge in edges}


def test_flat_is_flat_and_empty():
    world = build_flat(FlatConf())
    xy = np.random.default_rng(0).uniform(-60, 60, (100, 2))
    assert world.extent == (-50, 50, -50, 50)
    assert world.region == (-4, 4, -4, 4)
    assert (world.terrain.height(xy) == 0).all()
    assert (world.clearance(xy) == np.inf).all()
    assert (world.solid_mesh().owner == -1).all()


def test_clearance_is_the_distance_or_a_little_less():
    # Off the grid: whether a ray along a wall's own face meets it is a matter of the last bit.
    box = upright_box([2.013, 1.012], 0.0, -0.2, 3.0, 2.0, 1.0)
    post = tube([-3, -2, -0.4], [-3, -2, 2], 0.05)
    world = level_world(prop(box), prop(post))
    xy = np.random.default_rng(0).uniform(-8, 8, (4000, 2))
    outside = np.maximum(np.abs(xy - [2.013, 1.012]) - [1.0, 0.5], 0.0)
    true = np.minimum(np.hypot(*outside.T), np.maximum(np.hypot(*(xy - [-3, -2]).T) - 0.05, 0.0))
    error = world.clearance(xy) - true
    assert error.max() < 0.025
    assert error.min() > -0.075
    assert -0.03 < error.mean() < 0.0
    assert world.clearance(np.array([2.0, 1.0])) == 0.0


@pytest.mark.parametrize("shift", [0.0, 0.013, 0.025, 0.04])
def test_thin_posts_are_not_missed(shift):
    at = np.array([1.0 + shift, 2.0 - shift])
    world = level_world(prop(tube([*at, -0.4], [*at, 2.5], 0.05, sides=8)))
    assert world.clearance(at) < 0.03
    assert world.clearance(at + np.array([1.0, 0.0])) == pytest.approx(0.95, abs=0.08)


@pytest.mark.parametrize(
    ("bottom", "top", "counts"),
    [(0.5, 1.0, False), (0.4, 1.0, True), (-0.5, 0.02, False), (-0.5, 0.06, True), (-1.0, 9.0, True)],
)
def test_only_what_stands_in_the_band_is_an_obstacle(bottom, top, counts):
    world = level_world(prop(upright_box([0, 0], 0.3, bottom, top, 1.0, 1.0)))
    assert (world.clearance(np.zeros(2)) == 0.0) == counts


def test_an_obstacle_inside_a_roof_is_still_one():
    # The post's top lies within the roof, so that a ray up the post meets the roof's face first.
    roof, post = upright_box([0, 0], 0.0, 2.0, 2.2, 4.0, 4.0), upright_box([0, 0], 0.0, -0.4, 2.1, 0.2, 0.2)
    world = level_world(prop(merge_meshes([roof, post])))
    assert world.clearance(np.zeros(2)) == 0.0
    assert world.clearance(np.array([1.0, 0.0])) == pytest.approx(0.9, abs=0.08)


def test_water_is_no_obstacle_and_not_in_the_mesh_and_a_deck_is_ground():
    box = upright_box([0, 0], 0.0, -0.2, 0.3, 2.0, 2.0)
    water = level_world(prop(box, solid=False))
    assert water.clearance(np.zeros(2)) == np.inf
    assert len(water.solid_mesh().faces) == len(water.terrain.mesh()[1])
    deck = level_world(prop(box, drivable=True))
    assert deck.clearance(np.zeros(2)) == np.inf
    rail = upright_box([0, 0.9], 0.0, 0.2, 1.0, 2.0, 0.1)
    railed = level_world(prop(box, drivable=True), prop(rail))
    assert railed.clearance(np.array([0.0, 0.9])) == 0.0


def test_free_space_labels_what_a_wall_divides():
    walls = prop(upright_box([0, 0], np.pi / 2, -0.2, 2.0, 20.0, 0.3))
    world = level_world(walls)
    free = FreeSpace(world, 0.3, 30.0)
    left, right, far_left, on_wall, beyond = free.component_at(
        np.array([[-3.0, 0.0], [3.0, 0.0], [-8.0, 5.0], [0.0, 0.0], [99.0, 0.0]])
    )
    assert left == far_left != 0
    assert right not in (0, left)
    assert on_wall == 0
    assert beyond == 0


@pytest.mark.slow(all_but=["[0-2]"])
@pytest.mark.parametrize("seed", SEEDS)
def test_inspection_has_the_site_s_figures(seed):
    world = inspection(seed)
    assert world.extent == (-32, 32, -32, 32)
    xy = grid(-30, 30, -30, 30, 0.1)
    height = world.terrain.height(xy)
    assert 7.0 <= np.ptp(height) <= 10.0
    median, steep, steepest = np.percentile(np.rad2deg(world.terrain.slope(xy)), [50, 90, 99])
    assert 11.0 <= median <= 15.0
    assert 22.0 <= steep <= 29.0
    assert 30.0 <= steepest <= 42.0
    gentle, median, steep = np.percentile(
        np.rad2deg(world.terrain.slope(grid(*world.region, 0.1))), [10, 50, 90]
    )
    assert 2.5 <= gentle <= 7.0
    assert 6.0 <= median <= 12.0
    assert 14.0 <= steep <= 22.0
    mesh = world.solid_mesh()
    above = np.column_stack([xy, np.full(len(xy), 40.0)])
    hit, _ = RayScene(mesh.vertices, mesh.faces).first_hit(above, np.tile([0.0, 0, -1], (len(xy), 1)), 90.0)
    assert 0.03 <= (40.0 - hit - height > 0.1).mean() <= 0.05


@pytest.mark.parametrize("seed", SEEDS)
def test_inspection_has_its_objects(seed):
    kinds = [p.kind for p in inspection(seed).props]
    assert kinds.count("solar array") == 2 * 5
    assert kinds.count("bridge") == 2
    assert kinds.count("pipeline") == 3 + 1
    assert kinds.count("culvert") == 5
    assert kinds.count("wall") == 4 + 1
    assert kinds.count("water") == 1
    assert kinds.count("post") >= 9
    names = [p.name for p in inspection(seed).props]
    assert len(set(names)) == len(names)


def bodies(thing: Prop) -> list[np.ndarray]:
    # The vertices of each closed part of a prop.
    root = np.arange(len(thing.vertices))
    for _ in range(len(root)):
        smallest = root[thing.faces].min(axis=1)
        before = root.copy()
        np.minimum.at(root, thing.faces.reshape(-1), np.repeat(smallest, 3))
        if (root == before).all():
            break
    return [thing.vertices[root == r] for r in np.unique(root)]


@pytest.mark.parametrize("seed", SEEDS)
def test_props_stand_in_the_ground_and_not_below_it(seed):
    world = inspection(seed)
    for thing in world.props:
        over = thing.vertices[:, 2] - world.terrain.height(thing.vertices[:, :2])
        if thing.kind == "water":
            continue
        assert over.max() < 5.0, thing.name
        if thing.name.endswith("panel"):
            assert over.min() > 0.1, thing.name
            continue
        assert over.min() < 0.0, f"{thing.name} floats"
        assert over.max() > 0.02 if thing.drivable else over.max() > 0.8 or thing.kind == "pipeline", (
            thing.name
        )
    for kind in ("post", "wall", "culvert", "stand"):
        for thing in (p for p in world.props if p.kind == kind):
            parts = bodies(thing)
            lowest = [p[p[:, 2].argmin()] for p in parts]
            grounded = [low[2] < float(world.terrain.height(low[:2])) for low in lowest]
            # All of a wall's blocks reach the ground; a stand's box is set into its plinth.
            assert all(grounded) if kind != "stand" else any(grounded), f"{thing.name} has a part that floats"


@pytest.mark.slow(all_but=["[0-2]"])
@pytest.mark.parametrize("seed", SEEDS)
def test_bridge_can_be_driven_over(seed):
    world = inspection(seed)
    deck = next(p for p in world.props if p.drivable)
    low = RayScene(deck.vertices, deck.faces)
    centre = deck.vertices.mean(axis=0)[:2]
    long_side = deck.vertices[:, :2] - centre
    ahead = np.linalg.svd(long_side, full_matrices=False)[2][0]
    line = centre + np.linspace(-9.0, 9.0, 181)[:, None] * ahead
    ground = world.terrain.height(line)
    hit, _ = low.first_hit(np.column_stack([line, ground + 30]), np.tile([0.0, 0, -1], (181, 1)), 60.0)
    deck_top = np.where(hit < 60.0, ground + 30 - hit, -np.inf)
    surface = np.maximum(deck_top, ground)
    assert np.abs(np.diff(surface)).max() < 0.1, "a step on the way over"
    assert (surface - ground).max() > 1.2, "no gully under the bridge"
    assert (deck_top > ground)[25:-25].all(), "the ground comes through the deck"
    assert (world.clearance(line) > 0.6).all()


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_yard_obstacles_are_seen_by_a_lidar_and_leave_one_free_part(seed):
    world = inspection(seed)
    thing = [p for p in world.props if p.name.startswith("yard") and p.solid]
    free = FreeSpace(world, 0.45, 30.0)
    xy = grid(*world.region, 0.1)
    parts = free.component_at(xy)
    share = np.bincount(parts[parts > 0]).max() / (parts > 0).sum()
    assert share > 0.98
    assert 0.4 < (parts > 0).mean() < 0.95
    # From places round each obstacle, level rays 0.32 m over the ground find it.
    for p in thing:
        if p.name.endswith("panel"):
            continue
        scene = RayScene(p.vertices, p.faces)
        low, high = p.vertices[:, :2].min(axis=0), p.vertices[:, :2].max(axis=0)
        at = grid(low[0] - 1.0, high[0] + 1.0, low[1] - 1.0, high[1] + 1.0, 0.5)
        origins = np.repeat(np.column_stack([at, world.terrain.height(at) + 0.32]), 72, axis=0)
        angle = np.tile(np.linspace(0, 2 * np.pi, 72, endpoint=False), len(at))
        rays = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)
        hit, _ = scene.first_hit(origins, rays, 12.0)
        seen = (hit.reshape(-1, 72) < 12.0).any(axis=1)
        assert seen.mean() > 0.5, p.name


@pytest.mark.slow
def test_same_seed_same_bytes_in_another_process():
    other = digest_in_another_process("inspection", "InspectionConf(seed=3)")
    assert other == digest(build_inspection(InspectionConf(seed=3)))
    assert digest(inspection(3)) != digest(inspection(4))


def test_fewer_yard_obstacles_leave_the_rest_of_the_yard_as_it_was():
    few = build_inspection(InspectionConf(seed=1, yard_obstacles=3))
    many = {p.name: p.vertices for p in inspection(1).props if p.name.startswith("yard")}
    kept = [p for p in few.props if p.name.startswith("yard")]
    assert kept
    for p in kept:
        np.testing.assert_array_equal(p.vertices, many[p.name])


@pytest.mark.parametrize("wrong", [{"yard_obstacles": -1}, {"seed": -1}, {"friction": 0}, {"sede": 3}])
def test_bad_settings_are_refused(wrong):
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        InspectionConf(**wrong)


def test_solid_mesh_names_the_owner_of_every_face():
    world = inspection(0)
    mesh = world.solid_mesh()
    for index, p in enumerate(world.props):
        mine = mesh.faces[mesh.owner == index]
        assert len(mine) == (len(p.faces) if p.solid else 0)
        if p.solid:
            np.testing.assert_array_equal(mesh.vertices[mine], p.vertices[p.faces])
