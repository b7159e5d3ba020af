"""Rays at copies of a small scene, and rays in another order, against rays cast one way and singly."""

import numpy as np
import pytest
import trimesh

from dune_rl.geometry.frames import rotation_from_angles
from dune_rl.geometry.posed_rays import PosedScenes
from dune_rl.geometry.rays import RayScene

FARTHEST = np.float32(12.0)


HEIGHT_M = 0.7


def bumpy(seed: int) -> trimesh.Trimesh:
    """A bumpy closed shape on the ground."""
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=0.6)
    mesh.vertices *= np.random.default_rng(seed).uniform(0.8, 1.2, (len(mesh.vertices), 1))
    mesh.vertices += [0.05, -0.1, HEIGHT_M]
    return mesh


def posed(*seeds: int) -> tuple[PosedScenes, list[RayScene]]:
    """Shapes as the frames of one that moves, and the ray scene of each."""
    meshes = [bumpy(seed) for seed in seeds]
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    radius = float(np.linalg.norm(vertices - [0, 0, HEIGHT_M], axis=1).max())
    rays = [RayScene(mesh.vertices, mesh.faces) for mesh in meshes]
    return PosedScenes([one for one in rays], (HEIGHT_M, radius)), rays


def somewhere(
    rng: np.random.Generator, rows: int, bodies: int, reach_m: float, lean_rad: float
) -> np.ndarray:
    """Poses (N, K, 7) that lean by up to `lean_rad`, in frames 0 and 1."""
    low = [-reach_m, -reach_m, -0.2, -4.0, -lean_rad, -lean_rad]
    poses = rng.uniform(low, np.negative(low), (rows, bodies, 6))
    return np.concatenate([poses, rng.integers(0, 2, (rows, bodies, 1))], axis=2)


def unit(rng: np.random.Generator, *shape: int) -> np.ndarray:
    directions = rng.normal(size=(*shape, 3)) * [1.0, 1.0, 0.2]
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)


def expected_ranges(frames: list[RayScene], origins, directions, poses, ranges) -> np.ndarray:
    """The same by carrying every ray into the frame of every copy."""
    found = ranges.copy()
    for row, body in np.ndindex(*poses.shape[:2]):
        pose = poses[row, body]
        turn = rotation_from_angles(pose[[4, 5, 3]])
        local = ((origins[row] - pose[:3]) @ turn).astype(np.float32)
        carried = (directions[row] @ turn).astype(np.float32)
        frames[int(pose[6]) % len(frames)].shorten_ranges(local[None], carried, found[row])
    return found


@pytest.mark.parametrize("lean_rad", [0.0, 0.5])
@pytest.mark.parametrize("bodies", [1, 4])
@pytest.mark.parametrize("count", [1, 16, 37, 128])
def test_copies_shorten_rays_as_each_in_its_own_frame(bodies, count, lean_rad):
    copies, frames = posed(0, 3)
    rng = np.random.default_rng(bodies * count)
    rows = 60
    origins = rng.uniform(-5.0, 5.0, (rows, 3)) * [1.0, 1.0, 0.2] + [0, 0, 0.7]
    directions = unit(rng, rows, count)
    poses = somewhere(rng, rows, bodies, 8.0, lean_rad)
    # Some origins are within a body, some bodies out of reach, and some rays have met something before.
    poses[:5, 0, :3] = origins[:5] - [0, 0, 0.7]
    poses[5:9, 0, 0] += 40.0
    before = rng.uniform(0.5, FARTHEST, (rows, count)).astype(np.float32)
    before[rng.random((rows, count)) < 0.5] = FARTHEST
    expected = expected_ranges(frames, origins, directions, poses, before)
    found = before.copy()
    copies.shorten_ranges(origins, directions, poses, float(FARTHEST), found)
    np.testing.assert_allclose(found, expected, rtol=1e-4)
    assert (found < before).any()
    upright = poses.copy()
    upright[..., 4:] = 0.0
    copies.shorten_ranges(origins, directions, upright, float(FARTHEST), other := before.copy())
    # The other frame, and leaning, make a difference.
    assert count == 1 or (other != found).any()


def test_no_copies_and_no_rows_leave_ranges():
    copies, _ = posed(0)
    ranges = np.full((3, 8), FARTHEST, np.float32)
    directions = unit(np.random.default_rng(0), 3, 8)
    copies.shorten_ranges(np.zeros((3, 3)), directions, np.zeros((3, 0, 7)), 12.0, ranges)
    assert (ranges == FARTHEST).all()
    nothing = np.zeros((0, 8), np.float32)
    copies.shorten_ranges(np.zeros((0, 3)), directions[:0], np.zeros((0, 2, 7)), 12.0, nothing)


def test_poses_without_roll_pitch_and_frame_are_refused():
    copies, _ = posed(0)
    ranges, directions = np.full((1, 8), FARTHEST), unit(np.random.default_rng(0), 1, 8)
    with pytest.raises(ValueError, match=r"poses have 7 columns .*, got 4"):
        copies.shorten_ranges(np.zeros((1, 3)), directions, np.zeros((1, 2, 4)), 12.0, ranges)


@pytest.mark.parametrize("count", [16, 48, 50])
def test_an_order_of_rays_changes_no_hit(count):
    rays = posed(1)[1][0]
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
    rays = posed(0)[1][0]
    directions = unit(np.random.default_rng(0), 64).astype(np.float32)
    with pytest.raises(ValueError, match="an order of 16 is not that of 32 rays of each origin"):
        rays.shorten_ranges(np.zeros((2, 3), np.float32), directions, np.full(64, FARTHEST), np.arange(16))


@pytest.mark.parametrize("lean_rad", [0.0, 0.4])
@pytest.mark.parametrize("half_angle", [np.pi, 0.6])
def test_hits_of_copies_have_the_faces_of_the_nearest(half_angle, lean_rad):
    copies, frames = posed(2, 4)
    rng = np.random.default_rng(5)
    rows, bodies, count = 20, 3, 64
    origins = np.add(rng.uniform(-1.0, 1.0, (rows, 3)) * [1.0, 1.0, 0.3], [0, 0, 0.7])
    axes = unit(rng, rows)
    # Rays within the angle of the axis; bodies before, behind and beside the origins.
    directions = axes[:, None] + np.tan(min(half_angle, 1.4)) / np.sqrt(3) * rng.uniform(
        -1, 1, (rows, count, 3)
    )
    directions = (directions / np.linalg.norm(directions, axis=2, keepdims=True)).astype(np.float32)
    poses = somewhere(rng, rows, bodies, 4.0, lean_rad)
    before = np.full((rows, count), FARTHEST)
    found, order = before.copy(), rng.permutation(count)
    hit = copies.hits(origins, directions, order, poses, 12.0, (axes, half_angle), found)
    expected = expected_ranges(frames, origins, directions, poses, before)
    np.testing.assert_allclose(found, expected, rtol=1e-4)
    np.testing.assert_array_equal(hit.ray, np.flatnonzero(found.ravel() < FARTHEST))
    assert len(hit.ray) > 40
    # Each face is met where its ray ends, in the world: faces of the second frame follow those of the first.
    row, along = hit.ray // count, found.ravel()[hit.ray].astype(float)
    points = origins[row] + directions.reshape(-1, 3)[hit.ray] * along[:, None]
    meshes = [bumpy(2), bumpy(4)]
    frame, face = np.divmod(hit.face, len(meshes[0].faces))
    assert set(frame) == {0, 1}
    triangles = np.stack([mesh.triangles for mesh in meshes])[frame, face]
    turns = rotation_from_angles(poses[row][..., [4, 5, 3]])
    corners = np.einsum("rkij,rcj->rkci", turns, triangles) + poses[row][:, :, None, :3]
    normals = np.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    apart = np.abs(np.einsum("rki,rki->rk", points[:, None] - corners[:, :, 0], normals))
    turned = np.abs(np.einsum("rki,ri->rk", normals, hit.normal))
    # One of the row's bodies has that face there, and the normal is its.
    fits = (apart < 1e-4) & (turned > 1.0 - 1e-4) & (poses[row][..., 6] == frame[:, None])
    assert fits.any(axis=1).all()
    np.testing.assert_allclose(np.linalg.norm(hit.normal, axis=1), 1.0, rtol=1e-5)
