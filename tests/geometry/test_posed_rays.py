"""Rays at copies of a small scene, and rays in another order, against rays cast one way and singly."""

import numpy as np
import pytest
import trimesh

from dune_rl.geometry.rays import RayScene

FARTHEST = np.float32(12.0)


def scene(seed: int = 0) -> tuple[RayScene, tuple[float, float]]:
    """A bumpy closed shape on the ground, and the sphere on its axis that holds it."""
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=0.6)
    vertices = mesh.vertices * np.random.default_rng(seed).uniform(0.8, 1.2, (len(mesh.vertices), 1))
    vertices += [0.05, -0.1, 0.7]
    radius = float(np.linalg.norm(vertices - [0, 0, 0.7], axis=1).max())
    return RayScene(vertices, mesh.faces), (0.7, radius)


def unit(rng: np.random.Generator, *shape: int) -> np.ndarray:
    directions = rng.normal(size=(*shape, 3)) * [1.0, 1.0, 0.2]
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)


def expected_ranges(rays: RayScene, origins, directions, poses, ranges) -> np.ndarray:
    """The same by carrying every ray into the frame of every copy."""
    rows, count = ranges.shape
    found = ranges.copy()
    for body in range(poses.shape[1]):
        cos, sin = np.cos(poses[:, body, 3]), np.sin(poses[:, body, 3])
        offset = origins - poses[:, body, :3]
        local = np.stack(
            [cos * offset[:, 0] + sin * offset[:, 1], cos * offset[:, 1] - sin * offset[:, 0], offset[:, 2]],
            1,
        )
        x, y = directions[..., 0], directions[..., 1]
        cos, sin = cos[:, None], sin[:, None]
        carried = np.stack([cos * x + sin * y, cos * y - sin * x, directions[..., 2]], -1)
        of_body = ranges.copy().ravel()
        rays.shorten_ranges(local.astype(np.float32), carried.reshape(-1, 3).astype(np.float32), of_body)
        found = np.minimum(found, of_body.reshape(rows, count))
    return found


@pytest.mark.parametrize("bodies", [1, 4])
@pytest.mark.parametrize("count", [1, 16, 37, 128])
def test_copies_shorten_rays_as_each_in_its_own_frame(bodies, count):
    rays, sphere = scene()
    rng = np.random.default_rng(bodies * count)
    rows = 60
    origins = rng.uniform(-5.0, 5.0, (rows, 3)) * [1.0, 1.0, 0.2] + [0, 0, 0.7]
    directions = unit(rng, rows, count)
    poses = np.concatenate(
        [
            rng.uniform(-8.0, 8.0, (rows, bodies, 2)),
            rng.uniform(-0.2, 0.2, (rows, bodies, 1)),
            rng.uniform(-4.0, 4.0, (rows, bodies, 1)),
        ],
        axis=2,
    )
    # Some origins are within a body, some bodies out of reach, and some rays have met something before.
    poses[:5, 0, :3] = origins[:5] - [0, 0, 0.7]
    poses[5:9, 0, 0] += 40.0
    before = rng.uniform(0.5, FARTHEST, (rows, count)).astype(np.float32)
    before[rng.random((rows, count)) < 0.5] = FARTHEST
    expected = expected_ranges(rays, origins, directions, poses, before)
    found = before.copy()
    rays.shorten_posed(origins, directions, poses, sphere, float(FARTHEST), found)
    np.testing.assert_array_equal(found, expected)
    assert (found < before).any()


def test_no_copies_and_no_rows_leave_ranges():
    rays, sphere = scene()
    ranges = np.full((3, 8), FARTHEST, np.float32)
    directions = unit(np.random.default_rng(0), 3, 8)
    rays.shorten_posed(np.zeros((3, 3)), directions, np.zeros((3, 0, 4)), sphere, 12.0, ranges)
    assert (ranges == FARTHEST).all()
    nothing = np.zeros((0, 8), np.float32)
    rays.shorten_posed(np.zeros((0, 3)), directions[:0], np.zeros((0, 2, 4)), sphere, 12.0, nothing)


@pytest.mark.parametrize("count", [16, 48, 50])
def test_an_order_of_rays_changes_no_hit(count):
    rays, _ = scene(1)
    rng = np.random.default_rng(count)
    origins = np.add(2.0 * unit(rng, 7), [0, 0, 0.7])
    targets = np.add(rng.uniform(-0.6, 0.6, (7 * count, 3)), [0, 0, 0.7])
    directions = (targets - np.repeat(origins, count, axis=0)).astype(np.float32)
    origins = origins.astype(np.float32)
    expected = rays.hits(origins, directions, np.full(len(directions), FARTHEST))
    order = rng.permutation(count)
    found = rays.hits(origins, directions, np.full(len(directions), FARTHEST), order)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)
    ranges = np.full(len(directions), FARTHEST)
    np.testing.assert_array_equal(rays.hit_faces(origins, directions, ranges, order), expected.face)
    np.testing.assert_array_equal(ranges, expected.range)
    rays.shorten_ranges(origins, directions, again := np.full(len(directions), FARTHEST), order)
    np.testing.assert_array_equal(again, expected.range)
    assert (expected.face >= 0).sum() > 10


def test_an_order_of_another_number_of_rays_is_refused():
    rays, _ = scene()
    directions = unit(np.random.default_rng(0), 64).astype(np.float32)
    with pytest.raises(ValueError, match="an order of 16 is not that of 32 rays of each origin"):
        rays.shorten_ranges(np.zeros((2, 3), np.float32), directions, np.full(64, FARTHEST), np.arange(16))


@pytest.mark.parametrize("half_angle", [np.pi, 0.6])
def test_hits_of_copies_have_the_faces_of_the_nearest(half_angle):
    rays, sphere = scene(2)
    rng = np.random.default_rng(5)
    rows, bodies, count = 20, 3, 64
    origins = np.add(rng.uniform(-1.0, 1.0, (rows, 3)) * [1.0, 1.0, 0.3], [0, 0, 0.7])
    axes = unit(rng, rows)
    # Rays within the angle of the axis; bodies before, behind and beside the origins.
    directions = axes[:, None] + np.tan(min(half_angle, 1.4)) / np.sqrt(3) * rng.uniform(
        -1, 1, (rows, count, 3)
    )
    directions = (directions / np.linalg.norm(directions, axis=2, keepdims=True)).astype(np.float32)
    poses = rng.uniform(-4.0, 4.0, (rows, bodies, 4)) * [1.0, 1.0, 0.05, 1.0]
    before = np.full((rows, count), FARTHEST)
    found = before.copy()
    view = (axes, half_angle)
    hit = rays.hit_posed(origins, directions, rng.permutation(count), poses, sphere, 12.0, view, found)
    np.testing.assert_array_equal(found, expected_ranges(rays, origins, directions, poses, before))
    np.testing.assert_array_equal(hit.ray, np.flatnonzero(found.ravel() < FARTHEST))
    assert len(hit.ray) > 40
    # Each face is met where its ray ends: in the frame of its copy, on the plane of the triangle.
    row, along = hit.ray // count, found.ravel()[hit.ray].astype(float)
    points = origins[row] + directions.reshape(-1, 3)[hit.ray] * along[:, None]
    pose = poses.reshape(-1, 4)[hit.copy]
    np.testing.assert_array_equal(hit.copy // bodies, row)
    cos, sin = np.cos(pose[:, 3]), np.sin(pose[:, 3])
    offset = points - pose[:, :3]
    local = np.stack(
        [cos * offset[:, 0] + sin * offset[:, 1], cos * offset[:, 1] - sin * offset[:, 0], offset[:, 2]],
        axis=1,
    )
    normal = hit.normal / np.linalg.norm(hit.normal, axis=1, keepdims=True)
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=0.6)
    vertices = mesh.vertices * np.random.default_rng(2).uniform(0.8, 1.2, (len(mesh.vertices), 1))
    corner = np.add(vertices, [0.05, -0.1, 0.7])[mesh.faces[hit.face, 0]]
    np.testing.assert_allclose(np.einsum("ij,ij->i", local - corner, normal), 0.0, atol=1e-4)
