"""The shield: commands that would touch what the LiDAR sees are braked or turned."""

from dataclasses import replace

import numpy as np
import pytest
from drivers import DrivenBodies
from plain_worlds import box, plain
from simulations import act, environment_conf, simulation_on, state_of_group
from states import STEP_S
from yards import yard

from dune_rl.behaviours.drivers.shield import Shield
from dune_rl.config.build import make_simulation
from dune_rl.core.errors import ConfigError
from dune_rl.env.requests import AgentRequest

POST = np.array([[1.5, 0.0, 0.3]])
PERSON_M = 0.25


def drive_on(command: list[float], discs: np.ndarray, steps: int = 80) -> np.ndarray:
    """Poses (steps, 3) of a body that is commanded the same throughout, under the shield."""
    bodies = DrivenBodies(yard(), [0.0, 0.0, 0.0], [9.0, 0.0], np.zeros((0, 4)))
    shield = Shield(1)
    shield.bind(bodies.context(discs))
    shield.reset(np.ones(1, bool))
    poses = []
    for _ in range(steps):
        bodies.move(shield.check(np.array([command]), STEP_S))
        poses.append(bodies.poses[0].copy())
    return np.array(poses)


@pytest.mark.slow
@pytest.mark.parametrize("speed", [1.0, -1.0])
def test_a_body_does_not_touch_what_is_in_its_way(speed: float) -> None:
    post = POST * [np.sign(speed), 1.0, 1.0]
    poses = drive_on([speed, 0.0], post)
    posts = np.tile([*post[0, :2], 0.0, 0.0], (len(poses), 1))
    gap = DrivenBodies(yard(), poses, poses[:, :2], posts).distances().min() - post[0, 2]
    assert gap > 0.0
    # It gets near: the shield acts no sooner than it must.
    assert gap < 0.25


def test_a_command_that_touches_nothing_is_left_as_it_is() -> None:
    bodies = DrivenBodies(yard(), [0.0, 0.0, 0.0], [9.0, 0.0], np.zeros((0, 4)))
    shield = Shield(1)
    shield.bind(bodies.context(POST + np.array([3.0, 0.0, 0.0])))
    for command in ([1.0, 0.3], [-0.6, 2.0], [0.0, 0.0]):
        assert shield.check(np.array([command]), STEP_S).tolist() == [command]


def test_a_body_does_not_drive_into_a_walker_who_crosses_its_way() -> None:
    def gap(*, shielded: bool) -> float:
        walker = [1.5, -1.5, 0.0, 1.0]
        bodies = DrivenBodies(yard(), [0.0, 0.0, 0.0], [9.0, 0.0], walker)
        seen = replace(
            bodies.context(POST),
            observe=lambda: bodies.readings(np.array([[*bodies.walkers[0, 0, :2], PERSON_M]])),
        )
        shield = Shield(1)
        shield.bind(seen)
        lowest = np.inf
        for _ in range(60):
            command = np.array([[1.0, 0.0]])
            bodies.move(shield.check(command, STEP_S) if shielded else command)
            lowest = min(lowest, float(bodies.distances().min()) - PERSON_M)
        return lowest

    assert gap(shielded=False) < 0.0 < gap(shielded=True)


@pytest.mark.slow
def test_go_to_goal_under_the_shield_does_not_touch_the_wall_that_it_would_hit() -> None:
    world = plain(box(2.0, 0.0, 0.2, 6.0, 1.0))
    collided = {}
    for shield in ("none", "brake"):
        simulation = simulation_on(world, sensors={"enabled": ["lidar", "velocity", "goal"]}, shield=shield)
        (robot,) = simulation.external
        request = AgentRequest((0.0, 0.0, 0.0), (3.5, 0.0))
        simulation.reset(requests={0: {robot.names[0]: request}})
        touched = False
        for _ in range(90):
            bearing = float(simulation.observe()["goal"][0, 0, 1])
            act(simulation, [1.0, bearing])
            touched |= bool(state_of_group(simulation).contacts.touching.any())
        collided[shield] = touched
        simulation.close()
    assert collided == {"none": True, "brake": False}


def test_what_the_shield_needs_is_said() -> None:
    conf = environment_conf(sensors={"enabled": ["goal", "lidar"]}, shield="brake")
    with pytest.raises(ConfigError, match=r"shield=brake cannot act for the group rover.*has no velocity"):
        make_simulation(conf, 1, 0)
