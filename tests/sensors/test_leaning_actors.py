"""Actors that lean and whose parts move, seen by every kind of sensor."""

import numpy as np
import pytest
import trimesh
from cameras import EVERYTHING, PLAIN, STANDING, look, pinhole_directions
from poses import seen_at
from sensor_contexts import context_of
from sensors_of_rover_zero import camera_conf, depth_strip_conf, lidar_3d_conf, lidar_conf
from states import standing_at

from dune_rl.geometry.frames import rotation_from_angles
from dune_rl.geometry.rays import RayScene
from dune_rl.rendering.light import LightConf
from dune_rl.rendering.moving_mesh import MovingMesh
from dune_rl.rendering.scenery import ColouredMesh, Segment
from dune_rl.sensors.camera import Camera
from dune_rl.sensors.depth_strip import DepthStrip
from dune_rl.sensors.lidar import Lidar
from dune_rl.sensors.lidar_3d import Lidar3d
from dune_rl.worlds.appearance import bake_world, beam_surface

RED, BLUE = (0.8, 0.05, 0.05), (0.05, 0.05, 0.8)
EYE = np.array([0.2, 0.0, 0.3])
SOLID = PLAIN.solid_mesh()


def crate(height_m: float, colour: tuple[float, float, float]) -> ColouredMesh:
    """A cube of 1 m in plan whose origin is on the ground below its centre."""
    mesh = trimesh.creation.box([1.0, 1.0, height_m])
    faces = mesh.faces.astype(np.int32)
    return ColouredMesh(
        np.add(mesh.vertices, [0.0, 0.0, height_m / 2]),
        faces,
        np.tile(np.float32(colour), (len(faces), 1)),
        np.full(len(faces), Segment.ACTOR, np.uint8),
    )


@pytest.fixture(scope="module")
def mesh() -> MovingMesh:
    """A low red box in frame 0, a high blue one in frame 1."""
    return MovingMesh([crate(1.0, RED), crate(2.0, BLUE)])


def camera_of(mesh: MovingMesh) -> Camera:
    conf = camera_conf(outputs=EVERYTHING, width=48, height=48)
    return Camera(conf, bake_world(PLAIN, LightConf()), [mesh])


def distance_to_front(pose: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """How far along rays the plane of the side at x = -0.5 of a crate at `pose` is."""
    turn = rotation_from_angles(pose[[4, 5, 3]])
    normal = -turn[:, 0]
    point = pose[:3] - 0.5 * turn[:, 0]
    return (point - origin) @ normal / (direction @ normal)


LEANING = [
    np.array([4.0, 0.2, -0.1, 0.2, 0.0, 0.35, 0.0]),
    np.array([4.0, -0.2, -0.1, -0.3, 0.3, -0.4, 1.0]),
    np.array([4.0, 0.0, 0.0, 3.0 * np.pi, -0.5, 0.0, 1.0]),
]


@pytest.mark.parametrize("pose", LEANING)
def test_a_camera_sees_the_side_of_a_body_that_leans(mesh, pose):
    front = pose.copy()
    # The third shows its back, whose plane is that of the front of a body that leans to the other side.
    if pose[3] > np.pi:
        front[3:6] = 0.0, 0.5, 0.0
    camera = camera_of(mesh)
    found = look(camera, actors=[pose])
    directions = pinhole_directions(camera.conf)[24, 24]
    depth = distance_to_front(front, EYE, directions)
    assert found["segmentation"][24, 24, 0] == Segment.ACTOR
    assert found["depth"][24, 24, 0] == pytest.approx(depth, abs=1e-3)
    normal = -rotation_from_angles(front[[4, 5, 3]])[:, 0]
    np.testing.assert_allclose(found["normals"][24, 24], normal, atol=1e-4)
    # Of the colour of its frame.
    red, _, blue = found["rgb"][24, 24].astype(int)
    assert (red > blue) == (pose[6] == 0.0)


def test_frames_have_their_own_shapes_and_are_counted_round(mesh):
    camera = camera_of(mesh)
    low, high, again = (look(camera, actors=[(4.0, 0, 0, 0, 0, 0, frame)]) for frame in (0, 1, 2))
    tops = [np.nonzero(seen["segmentation"] == Segment.ACTOR)[0].min() for seen in (low, high)]
    assert tops[1] < tops[0] - 5
    for name in EVERYTHING:
        np.testing.assert_array_equal(again[name], low[name])
    assert mesh.frame(1.0) is mesh.frames[1]


def test_bodies_of_one_mesh_are_seen_in_their_own_frames(mesh):
    conf = camera_conf(outputs=EVERYTHING, width=48, height=48)
    both = Camera(conf, bake_world(PLAIN, LightConf()), [mesh, mesh])
    actors = [(4.0, 1.0, 0, 0, 0, 0, 0), (4.0, -1.0, 0, 0, 0, 0, 1)]
    found = look(both, actors=actors)
    for actor in actors:
        alone = look(camera_of(mesh), actors=[actor])
        seen = alone["segmentation"][..., 0] == Segment.ACTOR
        for name in EVERYTHING:
            np.testing.assert_array_equal(found[name][seen], alone[name][seen])


@pytest.mark.parametrize("pose", LEANING[:2])
def test_beams_end_at_the_side_of_a_body_that_leans(mesh, pose):
    rays = RayScene(SOLID.vertices, SOLID.faces)
    at, level = STANDING[None], np.eye(3)[None]
    lidar = Lidar(lidar_conf(), rays, [mesh])
    middle = lidar.conf.n_beams // 2
    origin = lidar.origin(at, level)[0]
    expected = distance_to_front(pose, origin, lidar.directions_b[middle])
    assert lidar.ranges(at, level, pose[None, None])[0, middle] == pytest.approx(expected, abs=1e-3)
    outputs = ("range", "intensity", "segmentation")
    conf = lidar_3d_conf(n_rings=3, n_beams=64, range_m=20.0, outputs=outputs)
    context = context_of(solid=rays, surfaces=beam_surface(PLAIN), meshes=[mesh])
    rings = Lidar3d("lidar_3d", context, conf)
    found = {name: values[0, 1, 32, 0] for name, values in rings.scan(at, level, pose[None, None]).items()}
    assert found["lidar_3d_range"] == pytest.approx(expected, abs=1e-3)
    assert found["lidar_3d_segmentation"] == Segment.ACTOR
    # A matt side gives back less where it leans away.
    upright = pose.copy()
    upright[4:6] = 0.0
    other = rings.scan(at, level, upright[None, None])
    cosines = [-rotation_from_angles(one[[4, 5, 3]])[0, 0] for one in (pose, upright)]
    fading = [
        1.0 + (length / conf.half_intensity_m) ** 2
        for length in (expected, other["lidar_3d_range"][0, 1, 32, 0])
    ]
    ratio = found["lidar_3d_intensity"] / other["lidar_3d_intensity"][0, 1, 32, 0]
    assert ratio == pytest.approx(cosines[0] / cosines[1] * fading[1] / fading[0], rel=1e-3)
    level_conf = depth_strip_conf(columns=33, rows=1, lowest_elevation_deg=0.0, highest_elevation_deg=0.0)
    strip = DepthStrip("depth_strip", context, level_conf)
    assert strip.depths(at, level, pose[None, None])[0, 16] == pytest.approx(expected, abs=1e-3)


def test_a_motion_leans_with_its_angles_and_has_frame_0_without_others():
    motion = standing_at(np.zeros((2, 3)), np.zeros(2), pitch=0.3)
    np.testing.assert_array_equal(motion.frames, np.zeros(2))
    bare = type(motion)(
        *(
            getattr(motion, name)
            for name in ("position_w", "roll_pitch_yaw", "velocity_w", "angular_w", "diverged")
        )
    )
    np.testing.assert_allclose(bare.rotation, motion.rotation, atol=1e-12)
    np.testing.assert_array_equal(seen_at([[1.0, 2.0]]), [[1.0, 2.0, 0, 0, 0, 0, 0]])
