"""What counts as a collision, what it costs, and how near the nearest obstacle or agent is."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plain_worlds import box, plain
from scenes import HULL_HALF_LENGTH_M, WHEEL_RADIUS_M, Backend, every_backend
from scipy.spatial import cKDTree
from scripted_physics import ScriptedRobot, scripted_simulation
from simulations import (
    act,
    bearing,
    environment_conf,
    every_engine,
    goals_w,
    metric,
    motion_of_group,
    outcome,
    put_walkers,
    set_goal,
    started_simulation,
    state_of_group,
)

from dune_rl.config.build import group_setups
from dune_rl.env.collision_counter import CollisionCounter
from dune_rl.env.scene_spec import scene_spec
from dune_rl.env.simulation import VectorSimulation
from dune_rl.geometry.heightfield import HeightField
from dune_rl.physics.interface import PhysicsConf, PhysicsScene, SceneSpec
from dune_rl.worlds.props import upright_box
from dune_rl.worlds.world import Prop, World

LENGTH_M, WIDTH_M = 0.62, 0.443
WALKER_RADIUS_M = 0.25

# -- counting --------------------------------------------------------------------------------------

GAP = 4
touches = st.lists(st.sets(st.tuples(st.integers(0, 1), st.integers(0, 2))), max_size=30)


@given(touches)
def test_a_touch_begins_a_collision_unless_the_body_was_touched_lately(
    history: list[set[tuple[int, int]]],
) -> None:
    counter, total = CollisionCounter(2, GAP), np.zeros(2, int)
    counter.make_room(3)
    counter.reset(np.ones(2, bool))
    for step, pairs in enumerate(history, 1):
        lately = set().union(*history[max(step - 1 - GAP, 0) : step - 1])
        begun = [sum(row == agent for row, _ in pairs - lately) for agent in range(2)]
        total += begun
        # Pairs may repeat: a body may touch at several points.
        state = counter.update([*pairs, *pairs], np.full(2, step))
        assert state.new.tolist() == begun
        assert state.total.tolist() == total.tolist()
        assert state.touching.tolist() == [any(row == agent for row, _ in pairs) for agent in range(2)]


def test_a_reset_forgets_the_contacts_of_its_agents_alone() -> None:
    counter = CollisionCounter(2, GAP)
    counter.make_room(1)
    counter.update([(0, 0), (1, 0)], np.array([1, 1]))
    counter.reset(np.array([True, False]))
    state = counter.update([(0, 0), (1, 0)], np.array([1, 2]))
    assert (state.new.tolist(), state.total.tolist()) == ([1, 0], [1, 1])


def counts_of(simulation: VectorSimulation, robot: ScriptedRobot, touches: list[list[int]]) -> list[float]:
    """Running count of collisions after each step, in which the robot touches the bodies in `touches`."""
    counts = []
    for bodies in touches:
        robot.touching = bodies
        act(simulation)
        counts.append(float(metric(simulation, "collisions")[0]))
    return counts


def test_a_lasting_contact_is_one_collision() -> None:
    simulation, (robot,) = scripted_simulation(actors="walkers")
    assert counts_of(simulation, robot, [[], [1], [1], [1, 1], [1]]) == [0, 1, 1, 1, 1]


def test_bouncing_within_a_second_is_the_same_collision() -> None:
    simulation, (robot,) = scripted_simulation(actors="walkers")
    # 20 steps are a second: apart for 19 of them counts as one touch, for more as a second one.
    counts = counts_of(simulation, robot, [[1]] + [[]] * 19 + [[1]] + [[]] * 20 + [[1]])
    assert counts[20] == 1
    assert counts[-1] == 2


def test_a_long_contact_does_not_become_a_second_collision() -> None:
    simulation, (robot,) = scripted_simulation(actors="walkers")
    assert counts_of(simulation, robot, [[1]] * 50)[-1] == 1


def test_each_body_has_its_own_collision() -> None:
    simulation, (robot,) = scripted_simulation(actors="walkers")
    assert counts_of(simulation, robot, [[1], [1, 2], [2], [1]]) == [1, 2, 2, 2]


def test_collisions_belong_to_their_scene_and_episode() -> None:
    simulation, robots = scripted_simulation(num_scenes=3, actors="walkers")
    robots[1].touching = [1, 2]
    act(simulation)
    assert metric(simulation, "collisions").tolist() == [0, 2, 0]
    simulation.reset(np.array([False, True, False]))
    assert metric(simulation, "collisions").tolist() == [0, 0, 0]
    robots[1].touching = [1]
    act(simulation)
    assert metric(simulation, "collisions").tolist() == [0, 1, 0]


def test_collisions_belong_to_their_agent() -> None:
    simulation, robots = scripted_simulation(num_scenes=2, robots=["rover_zero"] * 3)
    # Bodies are the ground, 0, and the three robots; the second robots of both scenes touch others'.
    robots[1].touching = [1, 3]
    robots[4].touching = [3]
    act(simulation)
    assert metric(simulation, "collisions").tolist() == [0, 2, 0, 0, 1, 0]
    contacts = state_of_group(simulation).contacts
    assert contacts.touching.tolist() == [False, True, False, False, True, False]
    assert contacts.new.tolist() == contacts.total.tolist() == [0, 2, 0, 0, 1, 0]


def test_a_walker_that_a_robot_touches_has_a_contact_too() -> None:
    simulation, robots = scripted_simulation(num_scenes=2, actors="external_walkers")
    # Bodies are the ground, 0, two walkers, and the robot.
    robots[1].touching = [2]
    act(simulation)
    assert state_of_group(simulation, "walker").contacts.new.tolist() == [0, 0, 0, 1]
    act(simulation)
    contacts = state_of_group(simulation, "walker").contacts
    assert contacts.touching.tolist() == [False, False, False, True]
    assert contacts.new.tolist() == [0, 0, 0, 0]
    assert contacts.total.tolist() == [0, 0, 0, 1]


def test_contact_earns_the_collision_reward_and_spoils_success() -> None:
    task = {"rewards": {"collision": {"weight": -0.5}, "contact": {"weight": -3.0}}}
    simulation, (robot,) = scripted_simulation(actors="walkers", task=task)
    robot.touching = [1]
    # The collision costs once, to be too close at every step.
    assert outcome(act(simulation)).reward[0] == -3.5
    assert outcome(act(simulation)).reward[0] == -0.5
    assert state_of_group(simulation).proximity.clearance("rover")[0] > 1.0
    assert state_of_group(simulation).clearance[0] == 0.0
    assert metric(simulation, "min_clearance")[0] == 0.0
    robot.touching = []
    robot.put(*goals_w(simulation)[0])
    assert act(simulation).terminated[0]
    assert metric(simulation, "reached")[0] == 1.0
    assert metric(simulation, "success")[0] == 0.0


# -- in true physics -------------------------------------------------------------------------------


@every_engine
def test_a_rover_hits_a_walker(engine: str) -> None:
    walker = {"waypoints": [[0.0, 9.0], [0.0, 12.0]], "speed_mps": 0.01}
    spawn = {"region": [-1.5, 1.5, 5.0, 6.6]}
    simulation = started_simulation(actors=[walker], physics=engine, task={"spawn": spawn})
    for _ in range(240):
        person = motion_of_group(simulation, "walker").position_w[:, :2]
        act(simulation, [1.0, bearing(motion_of_group(simulation), person)[0]])
        if metric(simulation, "collisions")[0]:
            break
    assert metric(simulation, "collisions")[0] == 1
    person = motion_of_group(simulation, "walker").position_w[0, :2]
    apart = np.hypot(*(person - motion_of_group(simulation).position_w[0, :2])) - WALKER_RADIUS_M
    assert WIDTH_M / 2 - 0.05 < apart < np.hypot(LENGTH_M, WIDTH_M) / 2 + 0.05
    simulation.close()


class RoverByWall:
    """A rover at `x` that heads to a wall whose face is at x = 1, and a walker that stands aside."""

    def __init__(self, backend: Backend, x: float) -> None:
        wall = Prop("wall", "wall", *upright_box((1.1, 0.0), 0.0, -0.1, 1.0, 0.2, 4.0))
        terrain = HeightField(np.zeros((21, 21)), 1.0, (-10.0, -10.0))
        scenes: list[PhysicsScene] = []

        def make_scene(spec: SceneSpec) -> PhysicsScene:
            scenes.append(backend(spec))
            return scenes[-1]

        walker = {"controller": "external", "waypoints": [[-3.0, 8.0], [3.0, 8.0]]}
        conf = environment_conf(actors=[walker])
        self.simulation = VectorSimulation(
            world=World("yard", terrain, [wall], region=(-8.0, -4.0, -8.0, -4.0)),
            groups=group_setups(conf),
            make_scene=make_scene,
            physics=conf.physics,
            num_scenes=1,
        )
        self.simulation.reset()
        scenes[0].robots[0].set_start_pose([x, 0.0, WHEEL_RADIUS_M], [0.0, 0.0, 0.0, 1.0])
        scenes[0].reset(self.simulation.group("walker").body.poses)

    def drive(self, speed: float, seconds: float, walker_speed: float = 0.0) -> None:
        for _ in range(round(seconds / 0.05)):
            act(self.simulation, [speed, 0.0], walker=[walker_speed, 0.0])

    def __getitem__(self, name: str) -> float:
        return float(metric(self.simulation, name)[0])


@pytest.mark.slow(all_but=["bullet"])
@every_backend
def test_a_long_push_is_one_collision_and_a_later_touch_another(backend: Backend) -> None:
    rover = RoverByWall(backend, 0.5)
    rover.drive(0.0, 0.5)
    assert rover["collisions"] == 0
    rover.drive(0.5, 4.0)
    assert rover["collisions"] == 1
    assert rover["min_clearance"] == 0.0
    # Off the wall for less than a second is the same collision still.
    rover.drive(-0.5, 0.3)
    rover.drive(0.5, 1.0)
    assert rover["collisions"] == 1
    rover.drive(-0.5, 1.0)
    rover.drive(0.0, 0.5)
    rover.drive(0.5, 2.0)
    assert rover["collisions"] == 2
    rover.simulation.close()


@every_backend
@pytest.mark.parametrize("x", [-2.0, 0.0, 0.3])
def test_clearance_is_never_more_than_there_is(backend: Backend, x: float) -> None:
    # And at most 0.2 m less: a cell of the world's grid, and the circles that stand for the hull.
    rover = RoverByWall(backend, x)
    rover.drive(0.0, 0.1)
    truly = 1.0 - (x + HULL_HALF_LENGTH_M)
    assert truly - 0.2 < rover["min_clearance"] < truly + 0.01
    rover.simulation.close()


@every_backend
def test_a_walker_counts_beside_the_wall(backend: Backend) -> None:
    rover = RoverByWall(backend, 0.0)
    put_walkers(rover.simulation, [-2.0, 0.0, 0.0, 0.0])
    rover.drive(0.0, 3.0, walker_speed=1.0)
    # It pushed the rover to the wall: one collision with each.
    assert rover["collisions"] == 2
    rover.drive(0.0, 1.0)
    assert rover["collisions"] == 2
    assert state_of_group(rover.simulation, "walker").contacts.total.tolist() == [1]
    rover.simulation.close()


@every_backend
def test_a_collision_costs_success_and_is_in_the_reward(backend: Backend) -> None:
    rover = RoverByWall(backend, 0.5)
    rover.drive(0.5, 3.0)
    assert rover["reward/collision"] == pytest.approx(-0.5 * rover["steps"], abs=1e-3)
    set_goal(rover.simulation, 0, motion_of_group(rover.simulation).position_w[0, :2])
    rover.drive(0.0, 0.05)
    assert (rover["reached"], rover["success"]) == (1.0, 0.0)
    rover.simulation.close()


@every_backend
def test_driving_on_the_ground_is_no_collision(backend: Backend) -> None:
    rover = RoverByWall(backend, -6.0)
    rover.drive(1.0, 4.0)
    assert rover["collisions"] == 0
    rover.simulation.close()


# -- clearance -------------------------------------------------------------------------------------


def hull_distance(points: np.ndarray, x: float, y: float, yaw: float) -> np.ndarray:
    """Distance from points (n, 2) to the rectangle of a rover at (x, y, yaw), 0 inside, (n,)."""
    offset = points - [x, y]
    along = np.abs(offset @ [np.cos(yaw), np.sin(yaw)]) - LENGTH_M / 2
    across = np.abs(offset @ [-np.sin(yaw), np.cos(yaw)]) - WIDTH_M / 2
    return np.hypot(np.maximum(along, 0.0), np.maximum(across, 0.0))


def test_clearance_of_walkers_is_that_of_the_hull() -> None:
    simulation, robots = scripted_simulation(num_scenes=64, actors="walkers")
    rng = np.random.default_rng(0)
    poses = np.column_stack([rng.uniform(-3, 3, (64, 2)), rng.uniform(-np.pi, np.pi, 64)])
    for robot, pose in zip(robots, poses, strict=True):
        robot.put(*pose)
    act(simulation)
    walkers = motion_of_group(simulation, "walker").position_w[:, :2].reshape(64, -1, 2)
    true = np.array([hull_distance(walkers[i], *poses[i]).min() - WALKER_RADIUS_M for i in range(64)])
    found = state_of_group(simulation).clearance
    # The circles that stand for the hull hold all of it, and reach 0.14 m beyond its ends.
    assert (found <= true.clip(0.0) + 1e-9).all()
    assert (found >= true.clip(0.0) - 0.145).all()
    assert np.ptp(found) > 1.0


def test_clearance_of_a_walker_is_from_its_circle_to_walkers_and_hulls() -> None:
    simulation, robots = scripted_simulation(num_scenes=64, actors="external_walkers")
    rng = np.random.default_rng(2)
    poses = np.column_stack([rng.uniform(-3, 3, (64, 2)), rng.uniform(-np.pi, np.pi, 64)])
    for robot, pose in zip(robots, poses, strict=True):
        robot.put(*pose)
    put_walkers(simulation, np.pad(rng.uniform(-3, 3, (128, 2)), ((0, 0), (0, 2))))
    act(simulation)
    walkers = motion_of_group(simulation, "walker").position_w[:, :2].reshape(64, 2, 2)
    between = np.hypot(*(walkers[:, 0] - walkers[:, 1]).T)[:, None] - 2 * WALKER_RADIUS_M
    hulls = np.stack([hull_distance(walkers[i], *poses[i]) for i in range(64)]) - WALKER_RADIUS_M
    true = np.minimum(between, hulls).clip(0.0)
    np.testing.assert_allclose(state_of_group(simulation, "walker").clearance, true.ravel(), atol=1e-6)
    assert (between < hulls).any() and (hulls < between).any()


def test_clearance_of_props_is_that_of_the_hull() -> None:
    simulation, robots = scripted_simulation("inspection", num_scenes=48)
    world = simulation.worlds.worlds[0]
    rng = np.random.default_rng(1)
    surface = []
    for prop in world.props:
        if prop.solid and not prop.drivable:
            a, b, c = np.moveaxis(prop.vertices[prop.faces], 1, 0)
            area = np.linalg.norm(np.cross(b - a, c - a), axis=-1) / 2
            faces = rng.choice(len(area), size=int(600 * area.sum()), p=area / area.sum())
            u, v = rng.uniform(size=(2, len(faces), 1))
            u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
            points = a[faces] + u * (b - a)[faces] + v * (c - a)[faces]
            above = points[:, 2] - world.terrain.height(points[:, :2])
            surface.append(points[(above > 0.03) & (above < 0.45), :2])
    points = np.concatenate(surface)
    near = cKDTree(points)
    # On and under a bridge, what stands in the way depends on which of the two it is.
    decks = np.concatenate([prop.vertices[:, :2] for prop in world.props if prop.drivable])
    poses: list[list[float]] = []
    while len(poses) < 48:
        xy = rng.uniform(-25, 25, 2)
        # Outside every prop, so that the distance to a surface is the distance to the solid.
        if 0.5 < world.clearance(xy) < 3.0 and np.hypot(*(decks - xy).T).min() > 8.0:
            poses.append([*xy, rng.uniform(-np.pi, np.pi)])
    for robot, pose in zip(robots, poses, strict=True):
        robot.put(*pose, z=float(world.terrain.height(np.array(pose[:2]))) + 0.125)
    act(simulation)
    around = [points[near.query_ball_point(pose[:2], 4.0)] for pose in poses]
    true = np.array([hull_distance(some, *pose).min() for some, pose in zip(around, poses, strict=True)])
    found = state_of_group(simulation).clearance
    # Half a cell of the distance field, and the sampling of the surface.
    assert (found <= true + 0.08).all()
    assert (found >= true - 0.145 - 0.08).all()


def test_clearance_without_obstacles_is_infinite_and_measured_as_the_range() -> None:
    simulation, _ = scripted_simulation()
    act(simulation)
    assert np.isinf(state_of_group(simulation).clearance).all()
    assert metric(simulation, "clearance")[0] == 12.0


def test_many_obstacles_are_few_bodies_with_the_same_triangles() -> None:
    rows = [(x, y) for x in np.linspace(-8.0, 8.0, 14) for y in np.linspace(-8.0, 8.0, 12)]
    boxes = [box(x, y, 0.2, 0.2, 0.5) for x, y in rows]
    few, many = (scene_spec(plain(*each), (), (), PhysicsConf()).statics for each in (boxes[:160], boxes))
    assert len(few) == 1 + 160 and len(many) == 1 + 64
    corners, expected = (
        sorted(map(tuple, np.concatenate([each.vertices for each in bodies]).tolist()))
        for bodies in (many[1:], boxes)
    )
    assert corners == expected
    assert sum(len(each.faces) for each in many[1:]) == sum(len(prop.faces) for prop in boxes)
    # Each body is the obstacles of a cell.
    assert max(np.ptp(each.vertices[:, :2], axis=0).max() for each in many[1:]) < 3.0
