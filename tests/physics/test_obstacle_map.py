"""The distance to obstacles from a grid: never too far, near enough, and built in bounded memory."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import box, plane

from dune_rl.physics.contact_gate import ObstacleMap, _surface_points


def sampled(triangles: np.ndarray, spacing_m: float) -> tuple[np.ndarray, int]:
    """All points on triangles, and the size of the largest batch."""
    batches = list(_surface_points(triangles, spacing_m))
    return np.concatenate(batches), max(map(len, batches))


SHAPES = {
    "a wall seen from above": [[0.0, 0.0], [105.0, 0.0], [105.0, 0.0]],
    "a wall with a middle corner": [[0.0, 0.0], [3.0, 4.0], [30.0, 40.0]],
    "a sliver": [[0.0, 0.0], [40.0, 0.3], [20.0, 0.0]],
    "a large one": [[0.0, 0.0], [12.0, 1.0], [3.0, 9.0]],
    "a small one": [[0.0, 0.0], [0.03, 0.0], [0.0, 0.05]],
    "a point": [[1.0, 1.0], [1.0, 1.0], [1.0, 1.0]],
}


@pytest.mark.slow(all_but=["a wall seen from above", "a sliver"])
@pytest.mark.parametrize("name", SHAPES)
def test_every_point_of_a_triangle_is_near_a_sample(name: str) -> None:
    corners = np.array(SHAPES[name])
    points, _ = sampled(corners[None], 0.1)
    shares = np.random.default_rng(0).dirichlet(np.ones(3), 500)
    apart = np.linalg.norm((shares @ corners)[:, None] - points[None], axis=2).min(axis=1)
    assert apart.max() <= 0.1 / np.sqrt(3) + 1e-9


def test_a_long_wall_takes_points_along_its_length_alone() -> None:
    wall = box((0.0, 0.0), 105.0, 0.2, 2.0)
    points, _ = sampled(wall.vertices[wall.faces][..., :2], 0.1)
    # Twelve triangles of at most 2,049 points in a row, of which the upper and lower four have nine rows.
    assert len(points) < 12 * 2049 * 17


@pytest.mark.slow
def test_batches_of_large_triangles_are_bounded() -> None:
    triangles = np.repeat(np.array([[[0.0, 0.0], [80.0, 0.0], [0.0, 80.0]]]), 3, axis=0)
    points, largest = sampled(triangles, 0.1)
    assert len(points) > 1_000_000
    assert largest < 210_000


def test_the_bound_is_below_the_distance_to_a_slanting_wall_and_close_to_it() -> None:
    angle = np.deg2rad(30.0)
    along = np.array([np.cos(angle), np.sin(angle)])
    wall = box((0.0, 0.0), 60.0, 0.2, 2.0)
    rotation = np.array([along, [-along[1], along[0]]])
    turned = np.column_stack([wall.vertices[:, :2] @ rotation, wall.vertices[:, 2]])
    wall = replace(wall, vertices=turned)
    obstacles = ObstacleMap((plane(), wall))
    for x, y in np.random.default_rng(1).uniform((-20.0, -14.0), (20.0, 14.0), (500, 2)).tolist():
        true = max(abs(-along[1] * x + along[0] * y) - 0.1, 0.0)
        bound = obstacles.distance(x, y)
        assert bound <= true + 1e-6
        # The map's bytes end at 64 cells.
        assert bound >= min(true, 6.3) - 4.0 * obstacles.cell_m - 1e-6
