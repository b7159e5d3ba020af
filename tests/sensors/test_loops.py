"""The compiled loops of cameras and scans, against the same in arrays of numpy."""

import numpy as np
import pytest

from dune_rl.geometry.frames import rotation_matrices
from dune_rl.sensors.beam_loops import (
    find_ends,
    nearest_in_segments,
    nearest_seen_from,
    nearest_upright,
    turn_beams,
)
from dune_rl.sensors.pixels import depths_along_axis, look_up_colours, tile_order, unpack_colours

RNG = np.random.default_rng(0)


@pytest.mark.parametrize(("height", "width"), [(64, 64), (8, 12), (7, 5), (1, 1), (3, 16)])
def test_tiles_have_each_pixel_once(height, width):
    order = tile_order(height, width)
    np.testing.assert_array_equal(np.sort(order), np.arange(height * width))
    row, column = np.divmod(order[:16], width)
    assert row.max() < max(4, 16 // min(width, 4)) and column.max() < width


def test_a_tile_is_four_by_four():
    order = tile_order(8, 8)
    assert order[:16].tolist() == [0, 1, 2, 3, 8, 9, 10, 11, 16, 17, 18, 19, 24, 25, 26, 27]
    assert order[16] == 4 and order[32] == 32


def test_colours_are_those_of_ground_faces_and_sky():
    pictures, pixels, ground_faces, columns, rows = 3, 40, 100, 9, 5
    count = pictures * pixels
    directions = RNG.normal(size=(count, 3)).astype(np.float32)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ranges = RNG.uniform(0.1, 9.0, count).astype(np.float32)
    faces = RNG.integers(-1, 150, count).astype(np.int32)
    faces[RNG.random(count) < 0.3] = -1
    start, texels = RNG.uniform(0, 5, (pictures, 2)).astype(np.float32), np.float32([1.5, 0.7])
    last = np.float32([columns - 1, rows - 1])
    ground, colours, sky = (RNG.integers(0, 2**24, n).astype(np.uint32) for n in (columns * rows, 150, 7))
    found = np.empty(count, np.uint32)
    look_up_colours(
        directions, ranges, faces, start, texels, last, columns, ground, ground_faces, colours, sky, found
    )
    at = directions[:, :2] * ranges[:, None] * texels + np.repeat(start, pixels, axis=0)
    column, row = np.clip(at, 0.0, last).astype(int).T
    level = np.clip(((directions[:, 2] + 1.0) * 3.5).astype(int), 0, 6)
    expected = np.where(faces < ground_faces, ground[row * columns + column], colours[faces])
    np.testing.assert_array_equal(found, np.where(faces < 0, sky[level], expected))
    assert min((faces < 0).sum(), (faces >= ground_faces).sum(), ((faces >= 0) & (faces < 100)).sum()) > 10
    bytes_of = np.empty((count, 3), np.uint8)
    unpack_colours(found, bytes_of)
    np.testing.assert_array_equal(bytes_of, found.astype("<u4").view(np.uint8).reshape(-1, 4)[:, :3])


def test_depths_end_where_nothing_is_met():
    ranges = RNG.uniform(0.0, 12.0, (4, 9)).astype(np.float32)
    ranges[:, ::3] = 10.0
    cosines = RNG.uniform(0.5, 1.0, 9).astype(np.float32)
    found = np.empty_like(ranges)
    depths_along_axis(ranges, cosines, np.float32(10.0), found)
    np.testing.assert_array_equal(found, np.where(ranges >= 10.0, np.float32(10.0), ranges * cosines))


def test_segments_have_their_nearest_beam():
    ranges = RNG.uniform(0.1, 12.0, (5, 24)).astype(np.float32)
    for segments in (1, 8, 24):
        found = np.empty((5, segments), np.float32)
        nearest_in_segments(ranges, found)
        np.testing.assert_array_equal(found, ranges.reshape(5, segments, -1).min(axis=2))


def rotations(count: int) -> np.ndarray:
    quaternions = RNG.normal(size=(count, 4))
    return rotation_matrices(quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True))


def test_beams_are_turned_with_their_sensors():
    directions, rotation = RNG.normal(size=(6, 3)), rotations(4)
    found, found32 = np.empty((4, 6, 3)), np.empty((4, 6, 3), np.float32)
    turn_beams(directions, rotation, found, found32)
    np.testing.assert_allclose(found, np.einsum("nij,bj->nbi", rotation, directions), rtol=1e-12)
    np.testing.assert_array_equal(found32, found.astype(np.float32))


def test_beams_that_meet_nothing_end_nowhere():
    directions, ranges = RNG.normal(size=(6, 3)), RNG.uniform(0.1, 5.0, (4, 6)).astype(np.float32)
    ranges[1, 2:4] = 5.0
    origin, rotation = RNG.normal(size=(4, 3)), rotations(4)
    found = np.empty((4, 6, 3))
    find_ends(directions, ranges, (np.float32(5.0), np.float32(1e6)), origin, rotation, found)
    ended_b = directions * np.where(ranges < 5.0, ranges, np.float32(1e6))[..., None]
    ended = origin[:, None] + np.einsum("nij,nbj->nbi", rotation, ended_b)
    np.testing.assert_allclose(found, ended, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("full_circle", [True, False])
def test_ends_count_where_they_lie(full_circle):
    segments, limits = 8, (np.float32(0.5), np.float32(9.0))
    span = 2 * np.pi if full_circle else np.pi
    first, per_rad = np.float32(-span / 2 - 0.05), np.float32(segments / span)
    ends_b = RNG.uniform(-7.0, 7.0, (6, 50, 3))
    ends_b[0] *= 100.0
    origin, rotation = RNG.normal(size=(6, 3)), rotations(6)
    ends = origin[:, None] + np.einsum("nij,nbj->nbi", rotation, ends_b)
    found = np.empty((6, segments), np.float32)
    seen_from = origin.astype(np.float32), rotation.astype(np.float32)
    nearest_seen_from(ends.astype(np.float32), *seen_from, first, per_rad, full_circle, limits, found)
    bearings = np.arctan2(ends_b[..., 1], ends_b[..., 0])
    place = np.floor((bearings - first) * per_rad).astype(int)
    place = place % segments if full_circle else place
    for row in range(6):
        for segment in range(segments):
            there = np.hypot(*ends_b[row, place[row] == segment, :2].T)
            expected = np.clip(min(there, default=9.0), 0.5, 9.0)
            np.testing.assert_allclose(found[row, segment], expected, rtol=1e-5)
    assert (found[0] == 9.0).all() and (found[1:] < 9.0).any()


def rings_over_a_slope(slope: float, wall_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Ranges and sines of seven rings, 0.3 m over ground that rises by `slope`, with a wall of 1.6 m."""
    elevation = np.deg2rad(np.arange(-15.0, 16.0, 5.0))
    level, up = np.cos(elevation), np.sin(elevation)
    with np.errstate(divide="ignore"):
        ground = np.where(up < slope * level, 0.3 / (slope * level - up), np.inf)
    height = up * wall_m / level + 0.3 - slope * wall_m
    wall = np.where((height > 0.0) & (height < 1.6), wall_m / level, np.inf)
    ranges = np.minimum(np.minimum(ground, wall), 12.0).astype(np.float32)
    return ranges[None, :, None], up[None, :, None]


@pytest.mark.parametrize("slope", [-0.25, 0.0, 0.25, 0.45])
def test_rings_see_no_slopes(slope: float) -> None:
    found = np.zeros((1, 1), np.float32)
    nearest_upright(*rings_over_a_slope(slope, 50.0), 0.1, 12.0, found)
    assert found[0, 0] == pytest.approx(12.0)


@pytest.mark.parametrize("slope", [-0.25, 0.0, 0.25])
@pytest.mark.parametrize("wall_m", [0.15, 0.3, 0.43, 1.0, 3.0])
def test_rings_see_walls_on_slopes(slope: float, wall_m: float) -> None:
    found = np.zeros((1, 1), np.float32)
    nearest_upright(*rings_over_a_slope(slope, wall_m), 0.1, 12.0, found)
    assert found[0, 0] == pytest.approx(wall_m, abs=1e-4)


def test_rings_see_a_bar_before_the_ground() -> None:
    """Of a bar at the LiDAR's height, the ring below passes under it."""
    ranges, rises = rings_over_a_slope(0.0, 50.0)
    ranges[0, 3] = 1.5
    found = np.zeros((1, 1), np.float32)
    nearest_upright(ranges, rises, 0.1, 12.0, found)
    assert found[0, 0] == pytest.approx(1.5)


@pytest.mark.parametrize(("lowest_m", "seen_m"), [(0.7, 4.0), (1.3, 12.0)])
def test_rings_see_nothing_overhead(lowest_m: float, seen_m: float) -> None:
    over_m = np.array([lowest_m, lowest_m + 0.4])
    along_m = np.hypot(4.0, over_m)
    found = np.zeros((1, 1), np.float32)
    ranges, rises = along_m.astype(np.float32)[None, :, None], (over_m / along_m)[None, :, None]
    nearest_upright(ranges, rises, 0.1, 12.0, found)
    assert found[0, 0] == pytest.approx(seen_m, abs=1e-4)
