"""Cameras in plain worlds, for tests of what they see."""

import numpy as np
from people import meshes_of
from poses import seen_at
from sensors_of_rover_zero import camera_conf

from dune_rl.bodies.person import PersonConf
from dune_rl.geometry.heightfield import HeightField
from dune_rl.rendering.light import LightConf
from dune_rl.rendering.scenery import Segment
from dune_rl.sensors.camera import Camera, CameraConf
from dune_rl.worlds.appearance import bake_world
from dune_rl.worlds.props import upright_box
from dune_rl.worlds.world import Prop, World

EVERYTHING = ("rgb", "grey", "depth", "segmentation", "normals")
STANDING = np.array([0.0, 0.0, 0.125])
LEVEL = np.eye(3)
PERSON = PersonConf()
HALF_M = 15.0
NOBODY = np.zeros((1, 0, 7))
# x, y, yaw, length, width and height of a box that stands on the ground.
Box = tuple[float, float, float, float, float, float]
AHEAD: Box = (5.5, 0.0, 0.0, 1.0, 2.0, 1.0)


def standing(name: str, box: Box, colour=(0.6, 0.6, 0.6), **settings) -> Prop:
    x, y, yaw, length, width, height = box
    kind = "box" if settings.get("solid", True) else "water"
    return Prop(name, kind, *upright_box((x, y), yaw, -0.1, height, length, width), colour=colour, **settings)


def plain(*props: Prop) -> World:
    """Level ground, 30 by 30 m, with things on it."""
    ground = HeightField(np.zeros((7, 7)), HALF_M / 3, (-HALF_M, -HALF_M))
    return World("plain", ground, props, region=(-4, 4, -4, 4))


PLAIN = plain()


def with_boxes(*boxes: Box) -> World:
    return plain(*(standing(f"box_{i}", box) for i, box in enumerate(boxes)))


def camera_in(world: World, actors: tuple[PersonConf, ...] = (), light=None, **settings) -> Camera:
    conf = camera_conf(**({"outputs": EVERYTHING, "width": 32, "height": 24} | settings))
    return Camera(conf, bake_world(world, light or LightConf()), meshes_of(actors))


def look(camera: Camera, position=STANDING, rotation=LEVEL, actors=()) -> dict[str, np.ndarray]:
    """What one camera sees, without the axis of scenes; `actors` are (K, 4 or more)."""
    poses = seen_at(np.asarray(actors, float).reshape(1, len(actors), -1) if len(actors) else NOBODY)
    frames = camera.frames(np.asarray(position)[None], np.asarray(rotation)[None], poses)
    return {name: frame[0] for name, frame in frames.items()}


def pinhole_directions(conf: CameraConf) -> np.ndarray:
    """Forward, left and up (height, width, 3) through each pixel's middle, forward being 1."""
    focal_px = conf.width / 2 / np.tan(np.deg2rad(conf.fov_deg) / 2)
    row, column = np.mgrid[0 : conf.height, 0 : conf.width] + 0.5
    across, upward = (conf.width / 2 - column) / focal_px, (conf.height / 2 - row) / focal_px
    return np.stack([np.ones_like(across), across, upward], axis=-1)


def actor_pixels(found: dict[str, np.ndarray]) -> np.ndarray:
    return found["segmentation"][..., 0] == Segment.ACTOR
