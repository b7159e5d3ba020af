"""Bodies on the rough ground of the rubicon and inspection worlds: nobody floats or sinks."""

import numpy as np
import pytest
from simulations import environment_conf

from dune_rl.bodies.registry import BODIES
from dune_rl.config.build import build_world
from dune_rl.env.kinematic import KinematicBody
from dune_rl.env.room import has_room
from dune_rl.geometry.frames import rotation_from_angles
from dune_rl.rendering.weather import WeatherConf
from dune_rl.worlds.batched_worlds import BatchedWorlds

# Median and largest gap between a wheel or foot and the ground [m].
GAPS = {
    "car": (0.04, 0.25),
    "truck": (0.05, 0.3),
    "tractor": (0.04, 0.25),
    "cow": (0.02, 0.1),
    "sheep": (0.01, 0.06),
    "dog": (0.01, 0.04),
}


@pytest.mark.parametrize("world_name", ["rubicon", "inspection"])
def test_wheels_and_feet_are_on_the_ground(world_name: str) -> None:
    world = build_world(environment_conf(world_name).world)
    rng = np.random.default_rng(0)
    xmin, xmax, ymin, ymax = world.extent
    number = 2000
    xy = rng.uniform([xmin + 4.0, ymin + 4.0], [xmax - 4.0, ymax - 4.0], (number, 2))
    for name, (median, largest) in GAPS.items():
        conf = BODIES.parse_settings({"name": name})
        body = KinematicBody(conf, BatchedWorlds([(world, WeatherConf())]), number, 0.05)
        body.place(0, np.column_stack([xy, world.terrain.height(xy), rng.uniform(-3.0, 3.0, number)]))
        rotation = rotation_from_angles(body.poses[:, [4, 5, 3]])
        feet = np.einsum("nij,pj->npi", rotation[:, :, :2], conf.supports_b) + body.poses[:, None, :3]
        gaps = np.abs(feet[..., 2] - world.terrain.height(feet[..., :2])).max(axis=1)
        stands = has_room(conf, world, xy)
        assert stands.mean() > 0.3
        assert np.median(gaps[stands]) < median
        assert gaps[stands].max() < largest


@pytest.mark.parametrize("name", ["person", "child"])
def test_persons_stand_on_the_ground(name: str) -> None:
    world = build_world(environment_conf("rubicon").world)
    conf = BODIES.parse_settings({"name": name, "looks": "figure"})
    body = KinematicBody(conf, BatchedWorlds([(world, WeatherConf())]), 1, 0.05)
    body.place(0, np.array([[1.0, 1.0, float(world.terrain.height(np.array([1.0, 1.0]))), 0.4]]))
    body.read_start(np.ones(1, bool))
    for _ in range(100):
        body.command(np.array([[1.0, 0.05]]), body.motion)
        body.read()
        frame = body.mesh().frame(body.motion.frames[0])
        lowest = frame.shape.vertices[:, 2].min() + body.poses[0, 2]
        assert lowest == pytest.approx(float(world.terrain.height(body.poses[0, :2])), abs=1e-9)
