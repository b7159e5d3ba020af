"""Robots that see each other: clearance, scanners, cameras, and what walkers observe of them."""

import numpy as np
import pytest
from several_robots import (
    CLOSE,
    KINDS,
    NO_ARRIVAL,
    TWINS,
    bearings_of_each_other,
    distance,
    drive_at_each_other,
    positions,
    simulation_of,
)
from simulations import (
    act,
    observation,
    started_simulation,
    state_of_group,
)

from dune_rl.rendering.scenery import Segment


@pytest.mark.slow
@pytest.mark.parametrize("robots", [KINDS, TWINS], ids=["kinds", "twins"])
def test_clearance_is_the_distance_of_the_hulls(robots: list[str]) -> None:
    task = {"spawn": {"region": [-2.5, 2.5, -2.5, 2.5]}}
    simulation = simulation_of(robots, num_scenes=32, task=task)
    groups = [simulation.group(group.name) for group in simulation.external]
    found = np.stack(
        [
            state_of_group(simulation, group.name).clearance.reshape(32, -1)[:, row]
            for group in groups
            for row in range(group.count)
        ]
    )
    np.testing.assert_array_equal(found[0], found[1])
    between = distance(simulation)
    bodies = [group.body.robot for group in groups for _ in range(group.count)]
    widths = sum(body.description.width_m for body in bodies) / 2
    reach = sum(np.hypot(body.description.length_m, body.description.width_m) for body in bodies) / 2
    assert (found[0] <= between - widths + 1e-6).all()
    assert (found[0] >= between - reach - 1e-6).all()
    simulation.close()


# In the middle of the hull: above it, beams pass over the other's.
SEES = {
    "sensors": {
        "enabled": ["goal", "lidar", "lidar_3d"],
        "lidar": {"mount_b": [0.0, 0.0, 0.0]},
        "lidar_3d": {"mount_b": [0.0, 0.0, 0.0], "outputs": ["segmentation"]},
    },
    "task": CLOSE,
}


@pytest.mark.parametrize("robots", [KINDS, TWINS], ids=["kinds", "twins"])
def test_each_sees_the_other(robots: list[str]) -> None:
    simulation = simulation_of(robots, num_scenes=4, **SEES)
    between = distance(simulation)
    for name, ahead in bearings_of_each_other(simulation).items():
        group, seen = simulation.group(name), observation(simulation, name)
        apart = np.repeat(between, group.count)
        nearest = seen["lidar"].min(axis=1)
        # Round the other's origin its wheels reach to 0.38 m, and its hull is 0.1 m at least.
        assert (nearest > apart - 0.39).all() and (nearest < apart - 0.1).all()
        segment = 2 * np.pi / group.suite.settings["lidar"].n_segments
        toward = -np.pi + (seen["lidar"].argmin(axis=1) + 0.5) * segment
        # Seen from the middle of one, the other is no wider than this.
        off = np.abs((toward - ahead + np.pi) % (2 * np.pi) - np.pi)
        assert (off < 0.39 / nearest + segment).all()
        shown = seen["lidar_3d_segmentation"].reshape(len(apart), -1) == Segment.ROBOT
        assert shown.any(axis=1).all()
    simulation.close()


def test_a_robot_does_not_see_itself() -> None:
    alone = started_simulation("flat", 1, **SEES)
    assert not (observation(alone)["lidar_3d_segmentation"] == Segment.ROBOT).any()
    assert (observation(alone)["lidar"] == 12.0).all()
    alone.close()


def test_a_dog_by_joints_that_is_done_stays_on_its_feet() -> None:
    simulation = simulation_of(["rover_zero", {"name": "hyperdog", "action": "joints"}])
    dog = simulation.group("hyperdog")
    dog.done[:] = True
    start = dog.body.motion.position_w.copy()
    for _ in range(30):
        act(simulation, hyperdog=np.ones(12))
    np.testing.assert_allclose(dog.body.motion.position_w, start, atol=6e-3)
    simulation.close()


# 0.2 m over the ground, which is in the hull of each.
LOW = [
    {"name": name, "mounts": {"scanner_b": [0.2, 0.0, height_m]}}
    for name, height_m in (("rover_zero", 0.075), ("leo_rover", 0.0), ("hyperdog", -0.04))
]


@pytest.mark.parametrize("low", [True, False])
def test_scanners_that_are_mounted_low_see_all_kinds_of_robots(low: bool) -> None:
    robots = LOW if low else [conf["name"] for conf in LOW]
    simulation = simulation_of(robots, num_scenes=8, sensors=["lidar", "goal"], task=CLOSE)
    seen = [observation(simulation, group.name)["lidar"].min(axis=1) for group in simulation.external]
    assert len(seen) == 3
    assert (np.array(seen) < 5.0).all() == low
    simulation.close()


@pytest.mark.slow
@pytest.mark.parametrize("robots", [KINDS, TWINS], ids=["kinds", "twins"])
def test_a_camera_shows_the_other(robots: list[str]) -> None:
    sensors = {"enabled": ["camera"], "camera": {"outputs": ["segmentation", "depth"]}}
    simulation = simulation_of(robots, sensors=sensors, task={**CLOSE, **NO_ARRIVAL})
    for _ in range(60):
        drive_at_each_other(simulation, 0.0)
    for group in simulation.external:
        seen = observation(simulation, group.name)
        for row in range(group.count):
            shown = seen["camera_segmentation"][row] == Segment.ROBOT
            assert shown.sum() > 20
            assert abs(seen["camera_depth"][row][shown].min() - (distance(simulation)[0] - 0.2 - 0.31)) < 0.15
    simulation.close()


@pytest.mark.slow
def test_a_walker_observes_the_nearest_robot() -> None:
    walker = {"controller": "external"}
    simulation = simulation_of([*KINDS, "rover_zero"], "inspection", num_scenes=8, actors=[walker, walker])
    now = state_of_group(simulation, "walker")
    people = now.by_scene(now.motion.position_w[:, :2])
    offset = people[:, :, None] - positions(simulation)[:, None]
    apart = np.hypot(offset[..., 0], offset[..., 1])
    assert len(set(apart.argmin(axis=2).ravel())) == 3
    # At the start each walker keeps its distance from all of them.
    assert (apart > 2.0 - 0.01).all()
    seen = observation(simulation, "walker")["nearest_agent"]
    np.testing.assert_allclose(seen[:, 0], apart.min(axis=2).ravel(), atol=1e-5)
    simulation.close()
