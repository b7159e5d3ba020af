"""Figures of worlds, measured on what physics and rays meet rather than asked of the code that built them."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from simulations import act, goals_w, metric, motion_of_group, simulation_on

from dune_rl.env.simulation import VectorSimulation
from dune_rl.geometry.heightfield import HeightField
from dune_rl.geometry.rays import RayScene
from dune_rl.tasks.spawn import SpawnConf, Spawner
from dune_rl.worlds.world import Prop, World

SEEDS = range(10)
RADIUS_M = 0.38
# What a goal must be reachable at: the task's own defaults.
MAX_SLOPE_DEG = 25.0

# Less than half of the rover's width.
_UNDER_M = 0.15


def grid(xmin: float, xmax: float, ymin: float, ymax: float, step: float) -> np.ndarray:
    x, y = np.arange(xmin + step / 2, xmax, step), np.arange(ymin + step / 2, ymax, step)
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def slope_deg(world: World, rectangle: tuple[float, float, float, float], *percent: float) -> np.ndarray:
    """Percentiles of the slope [deg] over a rectangle."""
    return np.percentile(np.rad2deg(world.terrain.slope(grid(*rectangle, 0.1))), percent)


def obstructed_share(world: World) -> float:
    """Share of the ground with something solid more than 0.1 m above it."""
    xy = grid(*world.extent, 0.1)
    mesh = world.solid_mesh()
    above = np.column_stack([xy, np.full(len(xy), 60.0)])
    hit, _ = RayScene(mesh.vertices, mesh.faces).first_hit(above, np.tile([0.0, 0, -1], (len(xy), 1)), 120.0)
    return float((60.0 - hit - world.terrain.height(xy) > 0.1).mean())


def roughness_m(terrain: HeightField, half_m: float, smooth_m: float = 0.8) -> float:
    """Root mean square [m] of what a Gaussian of `smooth_m` takes from the heights round the middle."""
    z = terrain.heights - ndimage.gaussian_filter(terrain.heights, smooth_m / terrain.spacing_m)
    middle, reach = z.shape[0] // 2, round(half_m / terrain.spacing_m)
    inner = z[middle - reach : middle + reach + 1, middle - reach : middle + reach + 1]
    return float(np.sqrt((inner**2).mean()))


def spectrum(terrain: HeightField, half_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Wavelengths [m] and power per area of wave numbers, both (K,), of the square round the middle."""
    middle, reach = terrain.heights.shape[0] // 2, round(half_m / terrain.spacing_m)
    z = terrain.heights[middle - reach : middle + reach, middle - reach : middle + reach]
    row, column = np.indices(z.shape).reshape(2, -1)
    plane = np.column_stack([row, column, np.ones(row.size)])
    z = z - (plane @ np.linalg.lstsq(plane, z.ravel(), rcond=None)[0]).reshape(z.shape)
    window = np.hanning(len(z))
    power = np.abs(np.fft.fft2(z * np.outer(window, window))) ** 2
    number = np.hypot(*np.meshgrid(*2 * [np.fft.fftfreq(len(z), terrain.spacing_m)]))
    edges = np.geomspace(2.0 / (2 * half_m), 0.5 / terrain.spacing_m, 13)
    ring = np.digitize(number, edges)
    found = [(power[ring == i].mean(), np.sqrt(edges[i - 1] * edges[i])) for i in range(1, len(edges))]
    density, middle_number = np.array(found).T
    return 1.0 / middle_number, density


def is_closed(thing: Prop) -> bool:
    """Whether every edge is used once in each direction, and the volume inside is positive."""
    faces = thing.faces
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    forth = {tuple(edge) for edge in edges.tolist()}
    matched = len(forth) == len(edges) and forth == {(b, a) for a, b in forth}
    return matched and all(_volume(part) > 0.0 for part in bodies(thing))


def bodies(thing: Prop) -> list[np.ndarray]:
    """The triangles (F, 3, 3) of each part of a prop that hangs together."""
    count = len(thing.vertices)
    edges = np.concatenate([thing.faces[:, [0, 1]], thing.faces[:, [1, 2]]])
    joined = coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), (count, count))
    number, part = connected_components(joined, directed=False)
    of_face = part[thing.faces[:, 0]]
    return [thing.vertices[thing.faces[of_face == i]] for i in range(number) if (of_face == i).any()]


def _volume(triangles: np.ndarray) -> float:
    a, b, c = np.moveaxis(triangles - triangles.reshape(-1, 3).mean(axis=0), 1, 0)
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum())


def _module(name: str) -> str:
    return name if name in ("flat", "island", "rubicon") else f"{name}.build"


def digest_in_another_process(name: str, conf: str) -> str:
    """The digest of the world `name` with the settings `conf` (source text), built by a fresh interpreter."""
    code = (
        "from world_digest import digest\n"
        f"from dune_rl.worlds.{_module(name)} import *\n"
        f"print(digest(build_{name}({conf})))"
    )
    here = Path(__file__).parent
    run = subprocess.run([sys.executable, "-c", code], cwd=here, capture_output=True, text=True, check=True)
    return run.stdout.strip()


def check_ways(world: World, count: int = 150) -> float:
    """Asserts that spawns and goals keep their promises and are joined; returns the region's free share.

    The ways are looked for on a grid of our own, which lies otherwise than the spawner's. A rover that
    stands on one gentle triangle between steep ones, narrower than itself, is on the ground beside it too.
    """
    spawner = Spawner(world, SpawnConf(max_slope_deg=MAX_SLOPE_DEG), RADIUS_M)
    rng = np.random.default_rng(0)
    placed = [spawner.sample(rng) for _ in range(count)]
    points = np.array([[p.x, p.y] for p in placed] + [[p.goal_x, p.goal_y] for p in placed])
    xmin, xmax, ymin, ymax = world.region
    assert (points >= [xmin, ymin]).all()
    assert (points <= [xmax, ymax]).all()
    assert np.rad2deg(world.terrain.slope(points)).max() <= MAX_SLOPE_DEG + 1e-6
    assert world.clearance(points).min() >= RADIUS_M + 0.1 - 1e-6
    cell, low = 0.07, np.maximum(np.array([xmin, ymin]) - 5.03, np.array(world.extent)[[0, 2]])
    high = np.minimum(np.array([xmax, ymax]) + 5.0, np.array(world.extent)[[1, 3]])
    x, y = (np.arange(low[i] + cell / 2, high[i], cell) for i in (0, 1))
    centres = np.stack(np.meshgrid(x, y), axis=-1)
    gentle = np.rad2deg(world.terrain.slope(centres)) <= MAX_SLOPE_DEG
    free = gentle & (world.clearance(centres) >= RADIUS_M)
    column, row = ((points - low) / cell).astype(int).T
    parts, _ = ndimage.label(free)
    inside = ((centres > [xmin, ymin]) & (centres < [xmax, ymax])).all(axis=-1)
    main = parts == np.bincount(parts[inside & free]).argmax()
    away = ndimage.distance_transform_edt(~main, sampling=cell)
    assert away[row, column].max() <= _UNDER_M, "a spawn or a goal has no way to it"
    assert main[inside].sum() > 0.95 * free[inside].sum(), "the region is cut up"
    return float(main[inside].mean())


def rovers_in(world: World, scenes: int) -> VectorSimulation:
    """Rovers in true physics in any world, which are not reset."""
    return simulation_on(world, scenes, sensors=["goal"])


def all_stand(simulation: VectorSimulation) -> bool:
    """Whether all rovers, left alone for half a second after a reset, stand upright on the ground."""
    simulation.reset()
    start = motion_of_group(simulation).position_w[:, :2].copy()
    for _ in range(10):
        act(simulation)
    motion = motion_of_group(simulation)
    position = motion.position_w
    height = position[:, 2] - simulation.worlds.height(position[:, :2])
    upright = motion.rotation[:, 2, 2] > np.cos(np.deg2rad(40.0))
    still = np.hypot(*(position[:, :2] - start).T) < 0.1
    return bool((upright & still & (height > 0.06) & (height < 0.25)).all())


def goals_reached(simulation: VectorSimulation, steps: int = 450) -> tuple[int, int]:
    """Of one episode a scene driven straight at its goal: goals reached, and collisions."""
    simulation.reset()
    ended = np.zeros(simulation.num_scenes, bool)
    reached = collisions = 0
    for _ in range(steps):
        motion = motion_of_group(simulation)
        away = goals_w(simulation) - motion.position_w[:, :2]
        turn = np.arctan2(away[:, 1], away[:, 0]) - motion.yaw
        turn = (turn + np.pi) % (2 * np.pi) - np.pi
        now = act(simulation, np.stack([0.7 * np.maximum(np.cos(turn), 0.0), turn], axis=1)).done & ~ended
        reached += int(metric(simulation, "reached")[now].sum())
        collisions += int(metric(simulation, "collisions")[now].sum())
        ended |= now
        if ended.all():
            break
    return reached, collisions


def cached(build: Callable[[int], World]) -> Callable[[int], World]:
    """`build`, which makes each seed's world once."""
    built: dict[int, World] = {}

    def get(seed: int) -> World:
        if seed not in built:
            built[seed] = build(seed)
        return built[seed]

    return get
