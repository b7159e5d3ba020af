"""LiDARs and cameras against PyBullet's own rays and pictures of the same site, people included."""

import numpy as np
import pybullet
import pytest
import trimesh
from people import meshes_of
from poses import seen_at
from scanning import lidar_in, turned
from scenes import about
from sensor_contexts import context_of
from sensors_of_rover_zero import camera_conf, lidar_3d_conf, lidar_conf

from dune_rl.bodies.person import PersonConf
from dune_rl.config.build import build_world
from dune_rl.geometry.frames import rotation_matrices
from dune_rl.geometry.rays import RayScene
from dune_rl.rendering.light import LightConf
from dune_rl.rendering.scenery import Segment
from dune_rl.sensors.camera import Camera
from dune_rl.sensors.lidar import LidarConf
from dune_rl.sensors.lidar_3d import Lidar3d, Lidar3dConf
from dune_rl.worlds.appearance import bake_world, beam_surface
from dune_rl.worlds.inspection.build import InspectionConf
from dune_rl.worlds.world import World

PEOPLE = (PersonConf(), PersonConf(radius_m=0.4, height_m=1.6), PersonConf())
TOLERANCE_M = 0.01
# How far aside to look for the edge that explains a beam which differs: a person is drawn with flat
# sides, up to 7 mm inside the capsule that PyBullet has.
ASIDE_RAD, ASIDE_M = 1e-3, 8e-3
# What lies behind an edge may slant away.
BEHIND_M = 0.05
# PyBullet answers no larger batch.
MOST_RAYS = 16_383


class Site:
    """An inspection site in PyBullet, without a rover: what physics meets, and water to look at."""

    def __init__(self, seed: int) -> None:
        self.world: World = build_world(InspectionConf(seed=seed))
        self.client = pybullet.connect(pybullet.DIRECT)
        self.segments: dict[int, Segment] = {-1: Segment.SKY}
        self._add(*self.world.terrain.mesh(), Segment.GROUND)
        for prop in self.world.props:
            standing = Segment.DECK if prop.drivable else Segment.OBSTACLE
            self._add(prop.vertices, prop.faces, standing if prop.solid else Segment.WATER)
        self._people = [self._add_person(person) for person in PEOPLE]
        self._rng = np.random.default_rng(seed)

    def _add(self, vertices: np.ndarray, faces: np.ndarray, segment: Segment) -> None:
        mesh = {"vertices": vertices.tolist(), "indices": faces.ravel().tolist()}
        seen = pybullet.createVisualShape(pybullet.GEOM_MESH, **mesh, physicsClientId=self.client)
        solid = -1
        if segment != Segment.WATER:
            concave = pybullet.GEOM_FORCE_CONCAVE_TRIMESH
            solid = pybullet.createCollisionShape(
                pybullet.GEOM_MESH, **mesh, flags=concave, physicsClientId=self.client
            )
        body = pybullet.createMultiBody(0.0, solid, seen, physicsClientId=self.client)
        self.segments[body] = segment

    def _add_person(self, conf: PersonConf) -> int:
        middle = conf.height_m - 2 * conf.radius_m
        solid = pybullet.createCollisionShape(
            pybullet.GEOM_CAPSULE, radius=conf.radius_m, height=middle, physicsClientId=self.client
        )
        # PyBullet's own picture of a capsule is coarse; this one is round to half a millimetre.
        mesh = trimesh.creation.capsule(height=middle, radius=conf.radius_m, count=[64, 64])
        mesh.apply_translation([0.0, 0.0, -mesh.bounds.mean(axis=0)[2]])
        seen = pybullet.createVisualShape(
            pybullet.GEOM_MESH,
            vertices=mesh.vertices.tolist(),
            indices=mesh.faces.ravel().tolist(),
            physicsClientId=self.client,
        )
        body: int = pybullet.createMultiBody(0.0, solid, seen, physicsClientId=self.client)
        self.segments[body] = Segment.ACTOR
        return body

    def draw(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A rover's position (3,) and rotation (3, 3) anywhere on the site, and people (K, 4) round it."""
        rng, height = self._rng, self.world.terrain.height
        while True:
            xy = rng.uniform(-26.0, 26.0, 2)
            if self.world.clearance(xy) > 0.5:
                break
        lean = rotation_matrices(about([1, 0, 0], rng.uniform(-0.15, 0.15)))
        dip = rotation_matrices(about([0, 1, 0], rng.uniform(-0.15, 0.15)))
        rotation = turned(rng.uniform(-np.pi, np.pi)) @ lean @ dip
        towards, apart = rng.uniform(-np.pi, np.pi, 3), rng.uniform(1.5, 8.0, 3)
        at = xy + apart[:, None] * np.column_stack([np.cos(towards), np.sin(towards)])
        people = np.column_stack([at, height(at), rng.uniform(-np.pi, np.pi, 3)])
        for conf, body, (x, y, z, yaw) in zip(PEOPLE, self._people, people, strict=True):
            pybullet.resetBasePositionAndOrientation(
                body, (x, y, z + conf.height_m / 2), about([0, 0, 1], yaw), physicsClientId=self.client
            )
        return np.array([*xy, height(xy) + 0.2]), rotation, seen_at(people)

    def cast(
        self, origin: np.ndarray, directions: np.ndarray, range_m: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Ranges (N,) of PyBullet's rays (N, 3) from `origin` (3,), and the segments (N,) they meet."""
        hits = []
        for part in np.split(directions, np.arange(MOST_RAYS, len(directions), MOST_RAYS)):
            starts = np.tile(origin, (len(part), 1)).tolist()
            ends = (origin + range_m * part).tolist()
            hits += pybullet.rayTestBatch(starts, ends, physicsClientId=self.client)
        return np.array([range_m * hit[2] for hit in hits]), np.array([self.segments[hit[0]] for hit in hits])

    def reach(
        self, origin: np.ndarray, directions: np.ndarray, ranges: np.ndarray, range_m: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """The nearest and farthest (N,) that PyBullet sees close beside rays of `ranges` (N,)."""
        across = np.cross(directions, [0.0, 0.0, 1.0])
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        upward = np.cross(across, directions)
        aside = np.maximum(ASIDE_RAD, ASIDE_M / ranges)[:, None]
        found = []
        for turn in np.linspace(0.0, 2 * np.pi, 17)[:-1]:
            for share in (0.3, 1.0):
                ray = directions + share * aside * (np.cos(turn) * across + np.sin(turn) * upward)
                ray /= np.linalg.norm(ray, axis=1, keepdims=True)
                found.append(self.cast(origin, ray, range_m)[0])
        return np.min(found, axis=0), np.max(found, axis=0)

    def depths(self, camera: Camera, position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        """TinyRenderer's depths (height, width) [m] along the optical axis of `camera` on a rover."""
        conf = camera.conf
        # The buffer's float32 steps grow with the square of the depth: 6e-5 m at 10 m with this near plane.
        near, far = 0.1, conf.range_m
        tilt = rotation_matrices(about([0, 1, 0], np.deg2rad(conf.pitch_deg)))
        ahead, _, up = (rotation @ tilt).T
        eye = camera.origin(position[None], rotation[None])[0]
        view = pybullet.computeViewMatrix(eye.tolist(), (eye + ahead).tolist(), up.tolist())
        half = near * np.tan(np.deg2rad(conf.fov_deg) / 2)
        # It takes a pixel's value at its lower left corner, not at its centre.
        shift = half / conf.width
        window = [-half + shift, half + shift] * 2
        lens = pybullet.computeProjectionMatrix(*window, near, far)
        picture = pybullet.getCameraImage(
            conf.width,
            conf.height,
            view,
            lens,
            renderer=pybullet.ER_TINY_RENDERER,
            physicsClientId=self.client,
        )
        buffer = np.reshape(picture[3], (conf.height, conf.width)).astype(np.float64)
        return far * near / (far - (far - near) * buffer)


@pytest.fixture(scope="module", params=[3, 8])
def site(request):
    made = Site(request.param)
    yield made
    pybullet.disconnect(made.client)


def agreement(
    site: Site, found: np.ndarray, origin: np.ndarray, beams: np.ndarray, conf: LidarConf | Lidar3dConf
) -> float:
    """Share of ranges (N,) that are PyBullet's; the rest must lie at an edge that PyBullet's rays show."""
    slow, _ = site.cast(origin, beams, conf.range_m)
    wrong = np.abs(found - np.maximum(slow, conf.min_range_m)) > TOLERANCE_M
    if wrong.any():
        nearest, farthest = site.reach(origin, beams[wrong], np.minimum(found, slow)[wrong], conf.range_m)
        assert (found[wrong] > nearest - BEHIND_M).all()
        assert (found[wrong] < farthest + BEHIND_M).all()
    return float(1.0 - wrong.mean())


def beside(picture: np.ndarray, depths: np.ndarray) -> np.ndarray:
    """Whether each of `depths` (height, width) lies among those of `picture` at and round its pixel."""
    around = [np.roll(picture, (down, right), (0, 1)) for down in (-1, 0, 1) for right in (-1, 0, 1)]
    return (depths > np.min(around, axis=0) - BEHIND_M) & (depths < np.max(around, axis=0) + BEHIND_M)


@pytest.mark.slow(all_but=["3"])
def test_the_planar_lidar_is_pybullet_s(site):
    conf = lidar_conf()
    lidar = lidar_in(site.world, PEOPLE, conf)
    bearing = -np.pi + 2 * np.pi / 128 * np.arange(128)
    beams_b = np.column_stack([np.cos(bearing), np.sin(bearing), np.zeros(128)])
    shares, returns, people_seen = [], 0, 0
    away = seen_at(np.full((1, 3, 3), 99.0))
    for _ in range(30):
        position, rotation, people = site.draw()
        found = lidar.ranges(position[None], rotation[None], people[None])[0]
        origin = position + rotation @ conf.mount_b
        shares.append(agreement(site, found, origin, beams_b @ rotation.T, conf))
        returns += np.sum(found < conf.range_m)
        people_seen += np.sum(found < lidar.ranges(position[None], rotation[None], away)[0])
    assert np.mean(shares) >= 0.99
    assert returns > 1000
    assert people_seen > 50


@pytest.mark.slow
def test_the_rings_are_pybullet_s(site):
    conf = lidar_3d_conf(outputs=("range", "segmentation"))
    solid = site.world.solid_mesh()
    rays = RayScene(solid.vertices, solid.faces)
    lidar = Lidar3d(
        "lidar_3d", context_of(solid=rays, surfaces=beam_surface(site.world), meshes=meshes_of(PEOPLE)), conf
    )
    elevation, bearing = np.meshgrid(
        np.deg2rad(np.linspace(15.0, -15.0, 16)), -np.pi + 2 * np.pi / 512 * np.arange(512), indexing="ij"
    )
    beams_b = np.stack(
        [np.cos(elevation) * np.cos(bearing), np.cos(elevation) * np.sin(bearing), np.sin(elevation)], axis=-1
    ).reshape(-1, 3)
    shares, alike = [], []
    kinds: set[int] = set()
    for _ in range(6):
        position, rotation, people = site.draw()
        found = lidar.scan(position[None], rotation[None], people[None])
        origin, beams = position + rotation @ conf.mount_b, beams_b @ rotation.T
        shares.append(agreement(site, found["lidar_3d_range"].ravel(), origin, beams, conf))
        segments = found["lidar_3d_segmentation"].ravel()
        alike.append(np.mean(segments == site.cast(origin, beams, conf.range_m)[1]))
        kinds |= set(segments.tolist())
    assert np.mean(shares) >= 0.99
    assert np.mean(alike) >= 0.99
    assert kinds >= {Segment.SKY, Segment.GROUND, Segment.OBSTACLE, Segment.ACTOR}


@pytest.mark.slow(all_but=["3"])
def test_the_camera_s_depths_are_pybullet_s(site):
    conf = camera_conf(width=96, height=96, outputs=("depth", "segmentation"), range_m=40.0, pitch_deg=6.0)
    look = bake_world(site.world, LightConf())
    camera = Camera(conf, look, meshes_of(PEOPLE))
    upward = np.array([[0.0, 0.0, 1.0]], np.float32)
    errors, people_errors = [], []
    while len(errors) < 12:
        position, rotation, people = site.draw()
        # TinyRenderer leaves out faces seen from behind, as from inside a deck or under water.
        if look.rays.any_hit(position[None].astype(np.float32), upward)[0]:
            continue
        frames = camera.frames(position[None], rotation[None], people[None])
        found, segments = (frames[name][0, ..., 0] for name in ("depth", "segmentation"))
        slow = site.depths(camera, position, rotation)
        # The outermost pixels lack neighbours to show an edge.
        inner = np.zeros(found.shape, bool)
        inner[1:-1, 1:-1] = True
        near, person = inner & (found < 10.0), segments == Segment.ACTOR
        error = np.abs(found - slow)
        errors.append(error[near & ~person])
        people_errors.append(error[near & person])
        # Seen aslant, a person's flat sides lie up to a few centimetres behind the round ones.
        wrong = near & (error > np.where(person, BEHIND_M, TOLERANCE_M))
        assert (beside(slow, found) | beside(found, slow))[wrong].all()
    still, walking = np.concatenate(errors), np.concatenate(people_errors)
    assert len(still) > 30_000
    assert np.mean(still <= TOLERANCE_M) >= 0.99
    assert np.median(still) < 1e-4
    assert len(walking) > 500
    assert np.mean(walking <= TOLERANCE_M) >= 0.9
