"""The island: extremely bumpy, with boxes, in the sea, on every seed."""

import numpy as np
import pytest
from pydantic import ValidationError
from world_digest import digest
from world_measures import (
    SEEDS,
    all_stand,
    bodies,
    cached,
    check_ways,
    digest_in_another_process,
    goals_reached,
    grid,
    is_closed,
    obstructed_share,
    roughness_m,
    rovers_in,
    slope_deg,
    spectrum,
)

from dune_rl.core.errors import WorldError
from dune_rl.rendering.scenery import Segment
from dune_rl.worlds.appearance import build_scenery
from dune_rl.worlds.inspection.build import InspectionConf, build_inspection
from dune_rl.worlds.island import IslandConf, build_island
from dune_rl.worlds.world import World

island = cached(lambda seed: build_island(IslandConf(seed=seed)))


def other(**settings: float) -> World:
    return build_island(IslandConf(seed=1, **settings))


@pytest.mark.parametrize("seed", SEEDS)
def test_the_region_is_steep_at_the_length_of_a_rover(seed):
    world = island(seed)
    assert world.region == (-4, 4, -4, 4)
    # Steeper than where the Inspection world is driven (8.8 and 17.7 degrees) ...
    median, steep = slope_deg(world, world.region, 50, 90)
    assert 11.0 <= median <= 18.0
    assert 20.0 <= steep <= 29.0
    assert 0.6 <= np.ptp(world.terrain.height(grid(*world.region, 0.1))) <= 2.2
    # ... and in bumps of some 2 m: they are what most of the slope is made of.
    wavelength, density = spectrum(world.terrain, 5.5)
    share = density / wavelength**4
    assert 1.0 <= wavelength[share.argmax()] <= 3.6
    assert share[(wavelength > 1.0) & (wavelength < 3.7)].sum() > 0.75 * share.sum()


@pytest.mark.parametrize("seed", SEEDS)
def test_bumps_are_as_high_as_set(seed):
    # The region has some of the gentler, longer waves besides.
    assert 0.070 <= roughness_m(island(seed).terrain, 5.0) <= 0.100


def test_a_wheel_feels_more_than_on_the_inspection_site():
    # The ground's bend over a wheelbase [m]: how far it leaves the straight line between two points.
    def bend(world: World) -> float:
        xy = grid(*world.region, 0.1)
        step = np.array([0.25, 0.0])
        height = world.terrain.height
        return float(np.std(height(xy + step) + height(xy - step) - 2.0 * height(xy)))

    assert bend(island(0)) > 2.0 * bend(build_inspection(InspectionConf()))


@pytest.mark.parametrize("seed", SEEDS)
def test_land_is_in_the_middle_and_sea_all_round(seed):
    world = island(seed)
    assert world.terrain.height(grid(*world.region, 0.1)).min() > 0.05
    z = world.terrain.heights
    assert max(z[0].max(), z[-1].max(), z[:, 0].max(), z[:, -1].max()) < -0.3
    land = (z > 0).sum() * world.terrain.spacing_m**2
    assert land == pytest.approx(np.pi * 9.0**2, rel=0.12)
    sea = [p for p in world.props if p.kind == "water"]
    assert len(sea) == 1
    assert not sea[0].solid
    assert (sea[0].vertices[:, 2] == 0.0).all()
    assert (build_scenery(world).props.segments == Segment.WATER).sum() == len(sea[0].faces)
    # It begins under the land on all sides, and goes beyond the world's edge.
    inner, outer = sea[0].vertices[:96, :2], sea[0].vertices[96:, :2]
    assert (world.terrain.height(inner) > 0.0).all()
    assert np.hypot(*outer.T).min() > np.sqrt(2.0) * world.extent[1]


@pytest.mark.parametrize("seed", SEEDS)
def test_boxes_stand_in_the_ground_and_leave_ways(seed):
    world = island(seed)
    boxes = [p for p in world.props if p.kind == "box"]
    assert len(boxes) == 6
    for p in boxes:
        assert is_closed(p), p.name
        assert len(bodies(p)) == 1
        over = p.vertices[:, 2] - world.terrain.height(p.vertices[:, :2])
        low = p.vertices[:, 2] < p.vertices[:, 2].mean()
        assert over[low].max() < -0.2, f"{p.name} shows a gap"
        assert over[~low].max() > 0.3, p.name
        assert (world.terrain.height(p.vertices[:, :2]) > 0.0).all(), f"{p.name} stands in the sea"
    assert 0.003 <= obstructed_share(world) <= 0.012
    assert 0.55 <= check_ways(world) <= 0.92


@pytest.mark.slow
def test_same_seed_same_bytes_in_another_process():
    assert digest_in_another_process("island", "IslandConf(seed=3)") == digest(island(3))
    assert digest(island(3)) != digest(island(4))


def test_rougher_settings_give_rougher_ground():
    smooth, as_is, rough = (roughness_m(other(roughness_m=r).terrain, 5.0) for r in (0.0, 0.085, 0.17))
    assert smooth < 0.04
    assert rough > 1.7 * as_is


def test_longer_bumps_are_gentler():
    short, long = (slope_deg(other(bump_length_m=length), (-4, 4, -4, 4), 90)[0] for length in (1.5, 4.0))
    assert short > 1.4 * long


def test_more_boxes_obstruct_more():
    none, few, many = (obstructed_share(other(boxes_per_100m2=b)) for b in (0.0, 2.0, 5.0))
    assert none == 0.0
    assert 0.0 < 1.8 * few < many


def test_a_larger_island_has_a_larger_region():
    world = other(radius_m=14.0, region_size_m=14.0)
    assert world.region == (-7, 7, -7, 7)
    assert world.terrain.height(grid(*world.region, 0.1)).min() > 0.05
    with pytest.raises(ValidationError, match=r"region_size_m must be at most 8\.\d for radius_m=9"):
        IslandConf(region_size_m=9.0)


def test_a_full_island_says_what_to_lower():
    with pytest.raises(WorldError, match=r"world\.boxes_per_100m2=8"):
        other(boxes_per_100m2=8.0, radius_m=7.0, region_size_m=5.0)


def test_grass_grows_on_land_alone():
    world = other(grass_cover=0.3)
    grass = world.grass
    assert grass is not None
    xmin, xmax, _, _ = world.extent
    axis = xmin + (np.arange(grass.density.shape[1]) + 0.5) * (xmax - xmin) / grass.density.shape[1]
    xy = np.stack(np.meshgrid(axis, axis), axis=-1)
    height = world.terrain.height(xy)
    assert height[grass.density > 0].min() > 0.15
    assert 0.1 < (grass.density > 0)[height > 0.2].mean() < 0.5


@pytest.mark.parametrize(
    "wrong", [{"seed": -1}, {"radius_m": 5}, {"roughness_m": 0.4}, {"bump_length_m": 0.5}, {"boxes": 3}]
)
def test_bad_settings_are_refused(wrong):
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        IslandConf(**wrong)


@pytest.mark.slow
def test_rovers_stand_and_reach_goals():
    batch = rovers_in(island(0), 5)
    assert all_stand(batch)
    reached, _ = goals_reached(batch)
    batch.close()
    assert reached >= 4
