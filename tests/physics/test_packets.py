"""Rays in packets against a ray tracer of twenty lines: Möller and Trumbore's, one triangle after another."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dune_rl.geometry.heightfield import HeightField
from dune_rl.geometry.rays import RayScene

FAR_M = 50.0


def soup(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Loose triangles (vertices, faces) of about a metre, within 4 m of the origin."""
    corners = rng.uniform(-3.0, 3.0, (count, 1, 3)) + rng.normal(0.0, 0.7, (count, 3, 3))
    return corners.reshape(-1, 3), np.arange(3 * count, dtype=np.int32).reshape(-1, 3)


def random_rays(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Origins and unit directions (count, 3)."""
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return rng.uniform(-5.0, 5.0, (count, 3)).astype(np.float32), directions.astype(np.float32)


def crossings(vertices, faces, origins, directions) -> tuple[np.ndarray, np.ndarray]:
    """Range (N, F) at which each ray crosses each triangle, inf for none; and how far inside, 0 on an edge.

    Möller and Trumbore, "Fast, Minimum Storage Ray/Triangle Intersection" (1997), in double precision.
    """
    # What Embree is given, not what it was rounded from.
    a, b, c = (vertices.astype(np.float32).astype(float)[faces[:, k]] for k in range(3))
    o, d = origins.astype(float)[:, None], directions.astype(float)[:, None]
    one, two = b - a, c - a
    p = np.cross(d, two)
    det = np.einsum("nfi,fi->nf", p, one)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = o - a
        u = np.einsum("nfi,nfi->nf", t, p) / det
        q = np.cross(t, one)
        v = np.einsum("nfi,nfi->nf", np.broadcast_to(d, q.shape), q) / det
        away = np.einsum("fi,nfi->nf", two, q) / det
    inside = np.min([u, v, 1.0 - u - v], axis=0)
    return np.where((inside >= 0.0) & (away > 0.0), away, np.inf), np.where(away > 0.0, inside, -1.0)


def compare(vertices, faces, origins, directions) -> int:
    """Assert that packets find what the slow tracer finds; how many rays hit."""
    scene = RayScene(vertices, faces)
    ranges, inside = crossings(vertices, faces, origins, directions)
    nearest, expected = ranges.min(axis=1), ranges.argmin(axis=1)
    # A ray within rounding of an edge, or as near to two triangles, may go either way.
    clear = (np.abs(inside) > 1e-4).all(axis=1)
    clear &= (np.sort(ranges, axis=1)[:, 1] > nearest + 1e-4) | np.isinf(nearest)
    assert clear.mean() > 0.9
    hit = clear & (nearest < FAR_M)
    found = scene.hits(origins, directions, np.full(len(directions), FAR_M, np.float32))
    np.testing.assert_array_equal(found.face[clear], np.where(hit, expected, -1)[clear])
    np.testing.assert_allclose(found.range[clear], np.minimum(nearest, FAR_M)[clear], rtol=1e-5, atol=2e-5)
    corners = vertices[faces[expected[hit]]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    np.testing.assert_allclose(found.normal[hit], normals, rtol=1e-3, atol=1e-4)
    assert (found.normal[found.face < 0] == 0.0).all()
    np.testing.assert_array_equal(scene.any_hit(origins, directions)[clear], np.isfinite(nearest)[clear])
    return int(hit.sum())


@pytest.mark.parametrize(("seed", "triangles"), [(0, 2), (1, 9), (2, 60), (3, 300)])
def test_packets_find_what_a_slow_tracer_finds(seed, triangles):
    rng = np.random.default_rng(seed)
    hits = compare(*soup(rng, triangles), *random_rays(rng, 500))
    assert 0 < hits < 500


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(2, 20), st.integers(1, 70))
def test_any_number_of_rays_and_triangles_will_do(seed, triangles, rays):
    rng = np.random.default_rng(seed)
    scene_at, (origins, directions) = soup(rng, triangles), random_rays(rng, rays)
    together = RayScene(*scene_at).hits(origins, directions, np.full(rays, FAR_M, np.float32))
    for row in (0, rays // 2, rays - 1):
        one = slice(row, row + 1)
        ranges, inside = crossings(*scene_at, origins[one], directions[one])
        if (np.abs(inside) > 1e-4).all():
            assert together.range[row] == pytest.approx(min(FAR_M, ranges.min()), rel=1e-5, abs=2e-5)


@pytest.mark.parametrize("rays", [1, 15, 16, 17, 31, 33, 100])
def test_a_ray_finds_the_same_whatever_rays_go_beside_it(rays):
    rng = np.random.default_rng(4)
    scene = RayScene(*soup(rng, 80))
    origins, directions = random_rays(rng, 200)
    all_of_them = scene.hits(origins, directions, np.full(200, FAR_M, np.float32))
    mixed = rng.permutation(200)[:rays]
    found = scene.hits(origins[mixed], directions[mixed], np.full(rays, FAR_M, np.float32))
    for alone, together in zip(found, all_of_them, strict=True):
        assert alone.tobytes() == together[mixed].tobytes()
    blocked = scene.any_hit(origins, directions)
    assert scene.any_hit(origins[mixed], directions[mixed]).tobytes() == blocked[mixed].tobytes()


def test_no_rays_find_nothing():
    scene = RayScene(*soup(np.random.default_rng(0), 5))
    for origins in (0, 1):
        nothing = np.zeros((origins, 3), np.float32), np.zeros((0, 3), np.float32)
        found = scene.hits(*nothing, np.zeros(0, np.float32))
        assert [part.shape for part in found] == [(0,), (0,), (0, 3)]
        assert scene.any_hit(*nothing).shape == (0,)


@pytest.mark.parametrize(("origins", "each"), [(1, 50), (3, 16), (4, 7), (50, 1)])
def test_an_origin_serves_its_own_rays(origins, each):
    rng = np.random.default_rng(5)
    scene = RayScene(*soup(rng, 120))
    starts, directions = random_rays(rng, origins)[0], random_rays(rng, origins * each)[1]
    ranges = np.full(len(directions), FAR_M, np.float32)
    shared = scene.hits(starts, directions, ranges.copy())
    own = scene.hits(np.repeat(starts, each, axis=0), directions, ranges.copy())
    assert 0 < (shared.face >= 0).sum() < len(directions)
    for one, other in zip(shared, own, strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(
        scene.any_hit(starts, directions), scene.any_hit(np.repeat(starts, each, axis=0), directions)
    )


def test_arrays_of_any_layout_are_read_and_left_as_they_are():
    rng = np.random.default_rng(6)
    scene = RayScene(*soup(rng, 120))
    origins, directions = random_rays(rng, 40)
    expected = scene.hits(origins, directions, np.full(40, FAR_M, np.float32))
    wide = [np.repeat(each, 2, axis=0)[::2] for each in (origins, directions)]
    columns = [np.asfortranarray(each) for each in (origins, directions)]
    locked = [each.copy() for each in (origins, directions)]
    for each in locked:
        each.flags.writeable = False
    assert not wide[1].flags.c_contiguous
    for start, along in (wide, columns, locked):
        before = start.tobytes(), along.tobytes()
        found = scene.hits(start, along, np.full(40, FAR_M, np.float32))
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_array_equal(one, other)
        np.testing.assert_array_equal(scene.any_hit(start, along), scene.any_hit(origins, directions))
        assert (start.tobytes(), along.tobytes()) == before
    single = np.broadcast_to(np.float32([0.0, 0.0, -1.0]), (40, 3))
    np.testing.assert_array_equal(
        scene.any_hit(origins, single), scene.any_hit(origins, np.ascontiguousarray(single))
    )


@pytest.mark.slow
def test_vertices_and_faces_are_copied():
    vertices = np.array([[2.0, -1.0, -1.0], [2.0, 1.0, -1.0], [2.0, 0.0, 1.0]])
    faces = np.array([[0, 1, 2]])
    scene = RayScene(vertices, faces)
    vertices[:], faces[:] = 99.0, 0
    ahead = np.zeros((1, 3), np.float32), np.float32([[1.0, 0.0, 0.0]])
    assert scene.first_hit(*ahead, FAR_M)[0] == pytest.approx([2.0])


def test_a_shorter_range_is_kept():
    square = np.array([[2.0, -9.0, -9.0], [2.0, 9.0, -9.0], [2.0, 0.0, 9.0]])
    near, far = (RayScene(square + np.array([x, 0.0, 0.0]), np.array([[0, 1, 2]])) for x in (0.0, 3.0))
    origins, directions = np.zeros((1, 3), np.float32), np.tile(np.float32([1.0, 0.0, 0.0]), (20, 1))
    limits = np.linspace(1.0, 8.0, 20, dtype=np.float32)
    ranges = limits.copy()
    found = far.hits(origins, directions, ranges)
    assert found.range is ranges
    np.testing.assert_array_equal(ranges, np.minimum(limits, 5.0))
    np.testing.assert_array_equal(found.face, np.where(limits > 5.0, 0, -1))
    near.shorten_ranges(origins, directions, ranges)
    np.testing.assert_array_equal(ranges, np.minimum(limits, 2.0))
    # Asked the other way round, it comes to the same.
    again = limits.copy()
    near.shorten_ranges(origins, directions, again)
    assert (far.hits(origins, directions, again).face[limits > 2.0] == -1).all()
    np.testing.assert_array_equal(again, ranges)
    assert limits[0] == 1.0


def test_normals_point_to_where_the_corners_run_counter_clockwise():
    vertices, faces = HeightField(np.zeros((3, 3)), 1.0, (-1.0, -1.0)).mesh()
    scene = RayScene(vertices, faces)
    origins = np.float32([[0.3, 0.2, 1.0], [0.3, 0.2, -1.0]])
    for z in (-1.0, 1.0):
        directions = np.float32([[0.0, 0.0, z]])
        side = origins[:1] if z < 0.0 else origins[1:]
        normal = scene.first_hit(side, directions, FAR_M)[1][0]
        np.testing.assert_allclose(normal / np.linalg.norm(normal), [0.0, 0.0, 1.0], atol=1e-6)


# -- no leaks -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("spacing", [1.0, 0.25, 0.3])
@pytest.mark.parametrize("corner", [0.0, -7.7, 1000.0])
def test_rain_does_not_leak_through_the_ground_s_edges_and_vertices(spacing, corner):
    ground = HeightField(np.zeros((21, 21)), spacing, (corner, corner))
    scene = RayScene(*ground.mesh())
    # The lines of the grid, its vertices, and the diagonals: in float32, as the vertices are.
    lines = (corner + spacing * np.arange(21)).astype(np.float32)[1:-1]
    between = np.linspace(lines[0], lines[-1], 61, dtype=np.float32)
    x, y = np.meshgrid(lines, between)
    on_lines = np.column_stack([x.ravel(), y.ravel()])
    diagonal = np.column_stack([between, between])
    xy = np.concatenate([on_lines, on_lines[:, ::-1], diagonal])
    origins = np.column_stack([xy, np.full(len(xy), 2.0, np.float32)])
    for z in (-1.0, 1.0):
        origins[:, 2] = -2.0 * z
        directions = np.tile(np.float32([0.0, 0.0, z]), (len(origins), 1))
        found = scene.hits(origins, directions, np.full(len(origins), FAR_M, np.float32))
        assert (found.face >= 0).all()
        np.testing.assert_allclose(found.range, 2.0, rtol=1e-6)
        assert scene.any_hit(origins, directions).all()


@pytest.mark.parametrize("seed", range(6))
def test_nothing_is_seen_through_the_edges_of_rough_ground(seed):
    rng = np.random.default_rng(seed)
    # So flat that from the eye no part of it hides another.
    vertices, faces = HeightField(rng.normal(0.0, 0.02, (31, 31)), 0.5, (-7.5, -7.5)).mesh()
    scene = RayScene(vertices, faces)
    share = rng.uniform(0.0, 1.0, (len(faces), 1))
    first, last = (vertices[faces[:, corner]] for corner in (0, 1))
    on_edges = well_inside(share * first + (1.0 - share) * last)
    on_vertices = well_inside(vertices)
    eye = np.float32([[*rng.uniform(-1.0, 1.0, 2), 4.0]])
    for targets, slip in ((on_edges, 0.0), (on_vertices, 0.005)):
        away = targets.astype(np.float32) - eye
        length = np.linalg.norm(away, axis=1)
        directions = away / length[:, None]
        found = scene.hits(eye, directions, np.full(len(targets), FAR_M, np.float32))
        met = found.face >= 0
        # Embree closes edges. Round a vertex rounding can shut a ray out of all its triangles, rarely.
        assert 1.0 - met.mean() <= slip
        np.testing.assert_allclose(found.range[met], length[met], atol=1e-4)
        assert scene.any_hit(eye, directions)[met].all()


def well_inside(points: np.ndarray) -> np.ndarray:
    return points[(np.abs(points[:, :2]) < 7.2).all(axis=1)]


# -- memory -------------------------------------------------------------------------------------------


# In a process of its own, where no earlier test has left free memory to grow into.
MEMORY = """
import gc
import numpy as np
from dune_rl.geometry.heightfield import HeightField
from dune_rl.geometry.rays import RayScene

mesh = HeightField(np.zeros((120, 120)), 1.0, (0.0, 0.0)).mesh()

def resident_bytes():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * 4096

def growth(times, keep):
    before, scenes = resident_bytes(), []
    for _ in range(times):
        scene = RayScene(*mesh)
        if keep:
            scenes.append(scene)
    del scene
    if not keep:
        gc.collect()
    return resident_bytes() - before

growth(5, True)
kept = growth(10, True)
growth(10, False)
print(kept / 10, growth(60, False))
"""


def test_a_dropped_scene_gives_its_memory_back():
    done = subprocess.run([sys.executable, "-c", MEMORY], capture_output=True, text=True, check=True)
    each, dropped = map(float, done.stdout.split())
    # Otherwise what follows could not fail.
    assert each > 500_000
    assert dropped < 6 * each
