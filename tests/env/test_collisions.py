"""Collisions and clearance as both engines have them, and collisions counted once for each body."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import HULL_HALF_LENGTH_M, WHEEL_RADIUS_M, Backend, every_backend

from dune_rl.behaviours.path_follower import PathConf
from dune_rl.bodies.person import PersonConf
from dune_rl.env.agent_group import GroupSetup
from dune_rl.env.collision_counter import CollisionCounter
from dune_rl.env.simulation import VectorSimulation
from dune_rl.geometry.heightfield import HeightField
from dune_rl.metrics.episode import MetricsConf
from dune_rl.physics.interface import PhysicsConf, PhysicsScene, SceneSpec
from dune_rl.robots.rover_zero.robot import RoverZero, RoverZeroConf
from dune_rl.sensors.suite import SensorsConf
from dune_rl.tasks.task import TaskConf, walking_task
from dune_rl.worlds.props import upright_box
from dune_rl.worlds.world import Prop, World


class WallScene:
    """A rover put down beside a wall whose face is at x = 1, and a walker at the test's command."""

    def __init__(self, backend: Backend, x: float) -> None:
        wall = Prop("wall", "wall", *upright_box((1.1, 0.0), 0.0, -0.1, 1.0, 0.2, 4.0))
        terrain = HeightField(np.zeros((21, 21)), 1.0, (-10.0, -10.0))
        scenes: list[PhysicsScene] = []

        def make_scene(spec: SceneSpec) -> PhysicsScene:
            scenes.append(backend(spec))
            return scenes[-1]

        self.simulation = VectorSimulation(
            world=World("yard", terrain, [wall], region=(-8.0, -4.0, -8.0, -4.0)),
            groups=[
                GroupSetup(
                    "rover",
                    1,
                    lambda rows: RoverZero(RoverZeroConf(), rows),
                    sensors=SensorsConf(),
                    task=TaskConf(),
                    metrics=MetricsConf(),
                ),
                GroupSetup(
                    "walker",
                    1,
                    PersonConf(),
                    paths=PathConf(waypoints=((-3.0, 8.0), (3.0, 8.0))),
                    task=walking_task(),
                ),
            ],
            make_scene=make_scene,
            physics=PhysicsConf(),
            num_scenes=1,
        )
        self.simulation.reset()
        scenes[0].robots[0].set_start_pose([x, 0.0, WHEEL_RADIUS_M], [0.0, 0.0, 0.0, 1.0])
        scenes[0].reset(self.walker.poses)

    @property
    def walker(self) -> Any:
        return self.simulation.group("walker").body

    def drive(self, speed: float, seconds: float, walker_speed: float = 0.0) -> None:
        for _ in range(round(seconds / 0.05)):
            self.simulation.step(
                {"rover": np.array([[[speed, 0.0]]]), "walker": np.array([[[walker_speed, 0.0]]])}
            )

    def __getitem__(self, name: str) -> float:
        column = self.simulation.metric_names("rover").index(name)
        return float(self.simulation.metrics("rover")[0, 0, column])


@every_backend
def test_a_long_push_is_one_collision_and_a_later_touch_another(backend: Backend) -> None:
    scene = WallScene(backend, 0.5)
    scene.drive(0.0, 0.5)
    assert scene["collisions"] == 0
    scene.drive(0.5, 4.0)
    assert scene["collisions"] == 1
    assert scene["min_clearance"] == 0.0
    # Off the wall for less than a second is the same collision still.
    scene.drive(-0.5, 0.3)
    scene.drive(0.5, 1.0)
    assert scene["collisions"] == 1
    scene.drive(-0.5, 1.0)
    scene.drive(0.0, 0.5)
    scene.drive(0.5, 2.0)
    assert scene["collisions"] == 2
    scene.simulation.close()


@every_backend
@pytest.mark.parametrize("x", [-2.0, 0.0, 0.3])
def test_clearance_is_never_more_than_there_is(backend: Backend, x: float) -> None:
    # And at most 0.2 m less: a cell of the world's grid, and the circles that stand for the hull.
    scene = WallScene(backend, x)
    scene.drive(0.0, 0.1)
    truly = 1.0 - (x + HULL_HALF_LENGTH_M)
    assert truly - 0.2 < scene["min_clearance"] < truly + 0.01
    scene.simulation.close()


@every_backend
def test_a_walker_counts_beside_the_wall(backend: Backend) -> None:
    scene = WallScene(backend, 0.0)
    scene.walker.poses[0] = -2.0, 0.0, 0.0, 0.0
    scene.drive(0.0, 3.0, walker_speed=1.0)
    # It pushed the rover to the wall: one collision with each.
    assert scene["collisions"] == 2
    scene.drive(0.0, 1.0)
    assert scene["collisions"] == 2
    scene.simulation.close()


@every_backend
def test_a_collision_costs_success_and_lowers_the_reward(backend: Backend) -> None:
    scene = WallScene(backend, 0.5)
    scene.drive(0.5, 3.0)
    assert scene["reward/collision"] == pytest.approx(-0.5 * scene["steps"], abs=1e-3)
    rover = scene.simulation.group("rover")
    rover.goals.source.goals_w[0] = rover.body.motion.position_w[0, :2]
    scene.drive(0.0, 0.05)
    assert (scene["reached"], scene["success"]) == (1.0, 0.0)
    scene.simulation.close()


@every_backend
def test_driving_on_the_ground_is_no_collision(backend: Backend) -> None:
    scene = WallScene(backend, -6.0)
    scene.drive(1.0, 4.0)
    assert scene["collisions"] == 0
    scene.simulation.close()


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
