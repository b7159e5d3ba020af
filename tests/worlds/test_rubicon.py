"""The wooded hillside: as rough as the site it stands in for, on every seed, and passable."""

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
    is_closed,
    obstructed_share,
    roughness_m,
    rovers_in,
    slope_deg,
    spectrum,
)

from dune_rl.core.errors import WorldError
from dune_rl.geometry.rays import RayScene
from dune_rl.worlds.rubicon import HURST, RubiconConf, build_rubicon
from dune_rl.worlds.world import World

HUNDREDS_OF_M2 = 44.0**2 / 100.0

rubicon = cached(lambda seed: build_rubicon(RubiconConf(seed=seed)))


def other(**settings: float) -> World:
    return build_rubicon(RubiconConf(seed=1, **settings))


@pytest.mark.slow(all_but=["[0-2]"])
@pytest.mark.parametrize("seed", SEEDS)
def test_slopes_and_relief_are_at_least_inspection_s(seed):
    world = rubicon(seed)
    # Inspection's whole site has 13, 25.6 and 35.6 degrees, and its relief is 8.8 m over 60 m, not 44.
    median, steep, steepest = slope_deg(world, world.extent, 50, 90, 99)
    assert 13.0 <= median <= 17.0
    assert 24.0 <= steep <= 29.0
    assert 31.0 <= steepest <= 39.0
    assert 5.0 <= np.ptp(world.terrain.heights) <= 9.0
    # Its training square has 8.8 and 17.7 degrees.
    median, steep = slope_deg(world, world.region, 50, 90)
    assert 9.0 <= median <= 16.0
    assert 17.0 <= steep <= 25.0


@pytest.mark.slow(all_but=["1"])
@pytest.mark.parametrize("seed", SEEDS)
def test_bumps_have_the_spectrum_of_natural_ground(seed):
    terrain = rubicon(seed).terrain
    # Of 0.07 m in all waves up to 6 m, those are left that a filter of 0.8 m takes out.
    assert 0.044 <= roughness_m(terrain, 16.0) <= 0.060
    wavelength, density = spectrum(terrain, 16.0)
    band = (wavelength < 5.0) & (wavelength > 0.95)
    exponent = np.polyfit(np.log(1.0 / wavelength[band]), np.log(density[band]), 1)[0]
    # The hills' foot in the band makes it a little steeper than the bumps alone.
    assert exponent == pytest.approx(-(2.0 * HURST + 2.0), abs=0.6)


@pytest.mark.slow(all_but=["[0-2]"])
@pytest.mark.parametrize("seed", SEEDS)
def test_rocks_and_trunks_stand_in_the_way_and_leave_ways(seed):
    world = rubicon(seed)
    # Less ground than Inspection's 3.6 %, in thirty times as many things.
    assert 0.010 <= obstructed_share(world) <= 0.020
    assert 0.65 <= check_ways(world) <= 0.92


@pytest.mark.parametrize("seed", SEEDS)
def test_numbers_of_rocks_fall_with_their_size_as_a_power(seed):
    rocks = [part for p in rubicon(seed).props if p.kind in ("rock", "stones") for part in bodies(p)]
    widths = np.array([np.ptp(part.reshape(-1, 3)[:, :2], axis=0).mean() for part in rocks])
    assert widths.min() > 0.03
    assert 1.2 <= widths.max() <= 2.2
    counted = (widths > 0.1).sum() / HUNDREDS_OF_M2
    assert counted == pytest.approx(12.0, rel=0.25)
    sizes = np.array([0.08, 0.16, 0.32])
    numbers = [(widths > size).sum() for size in sizes]
    assert np.polyfit(np.log(sizes), np.log(numbers), 1)[0] == pytest.approx(-1.35, abs=0.25)


@pytest.mark.slow(all_but=["[0-2]"])
@pytest.mark.parametrize("seed", SEEDS)
def test_props_are_closed_and_no_gap_shows_under_them(seed):
    world = rubicon(seed)
    kinds = {p.kind for p in world.props}
    assert kinds == {"tree", "leaves", "log", "rock", "stones", "undergrowth"}
    names = [p.name for p in world.props]
    assert len(set(names)) == len(names)
    for p in world.props:
        assert p.solid == (p.kind not in ("leaves", "undergrowth")), p.name
        assert p.drivable == (p.kind == "stones"), p.name
        if not p.solid:
            continue
        assert is_closed(p), p.name
        if p.kind in ("rock", "stones", "tree"):
            # A tree's boughs come after its trunk.
            for part in bodies(p)[:1] if p.kind == "tree" else bodies(p):
                corners = part.reshape(-1, 3)
                around = corners[corners[:, 2] < np.percentile(corners[:, 2], 60)]
                assert corners[:, 2].min() < world.terrain.height(around[:, :2]).min(), (
                    f"{p.name} shows a gap"
                )
                if p.kind == "stones":
                    over = corners[:, 2] - world.terrain.height(corners[:, :2])
                    assert over.max() <= 0.11, "a stone too high to drive over"


def test_trunks_block_and_leaves_do_not():
    world = rubicon(0)
    trunks = [p for p in world.props if p.kind == "tree"]
    assert len(trunks) == round(3.0 * HUNDREDS_OF_M2)
    mesh = world.solid_mesh()
    solid = RayScene(mesh.vertices, mesh.faces)
    met = passed = 0
    for trunk in trunks:
        foot = trunk.vertices[trunk.vertices[:, 2].argmin()]
        at = bodies(trunk)[0].reshape(-1, 3)
        at = at[at[:, 2] < foot[2] + 1.0].mean(axis=0)[:2]
        ground = float(world.terrain.height(at))
        assert world.clearance(at) == 0.0
        level = np.array([[at[0] + 1.0, at[1], ground + 0.5]])
        hit, _ = solid.first_hit(level, np.array([[-1.0, 0.0, 0.0]]), 2.0)
        met += hit[0] < 1.0
        leaves = next(
            p for p in world.props if p.name.startswith(trunk.name.split(" trunk")[0] + " ") and not p.solid
        )
        corners = leaves.vertices[leaves.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        outward = (normals / np.linalg.norm(normals, axis=1, keepdims=True))[::7]
        starts = corners.mean(axis=1)[::7] + 0.05 * outward
        hit, _ = solid.first_hit(starts, -outward, 0.1)
        passed += (hit == np.float32(0.1)).mean()
    assert met == len(trunks)
    # A few leaves touch the boughs.
    assert passed > 0.95 * len(trunks)


@pytest.mark.slow
def test_same_seed_same_bytes_in_another_process():
    assert digest_in_another_process("rubicon", "RubiconConf(seed=3)") == digest(rubicon(3))
    assert digest(rubicon(3)) != digest(rubicon(4))


@pytest.mark.slow
def test_steeper_settings_give_steeper_ground():
    gentle, as_is, steep = (
        slope_deg(other(slope_rad=slope), (-22, 22, -22, 22), 50)[0] for slope in (0.1, 0.23, 0.35)
    )
    assert gentle < as_is - 3.0
    assert steep > as_is + 3.0


@pytest.mark.slow
def test_rougher_settings_give_rougher_ground():
    smooth, as_is, rough = (roughness_m(other(roughness_m=r).terrain, 16.0) for r in (0.0, 0.07, 0.14))
    # The hills alone leave a little.
    assert smooth < 0.03
    assert rough > 1.7 * as_is


@pytest.mark.slow
def test_more_rocks_and_more_trees_obstruct_more():
    bare = obstructed_share(other(rocks_per_100m2=0.0, trees_per_100m2=0.0))
    wooded = obstructed_share(other(rocks_per_100m2=0.0, trees_per_100m2=6.0))
    rocky = obstructed_share(other(rocks_per_100m2=20.0, trees_per_100m2=6.0))
    assert bare == 0.0
    assert wooded > 0.002
    assert rocky > wooded + 0.008


def test_undergrowth_is_seen_only():
    few, many = (other(undergrowth_per_100m2=u) for u in (0.0, 20.0))
    assert not [p for p in few.props if p.kind == "undergrowth"]
    assert sum(len(p.faces) for p in many.props if p.kind == "undergrowth") > 5_000
    np.testing.assert_array_equal(few.solid_mesh().vertices, many.solid_mesh().vertices)


def test_other_rocks_leave_the_trees_where_they_were():
    few = {p.name: p.vertices for p in other(rocks_per_100m2=4.0).props if p.kind == "tree"}
    assert few
    for p in rubicon(1).props:
        if p.kind == "tree":
            np.testing.assert_array_equal(p.vertices, few[p.name])


def test_grass_grows_where_nothing_solid_stands():
    grass = other(grass_cover=0.4, grass_height_m=0.5).grass
    assert grass is not None
    assert (grass.density > 0).mean() == pytest.approx(0.4, abs=0.02)
    assert grass.height_m == 0.5
    assert rubicon(1).grass is None


def test_a_full_world_says_what_to_lower():
    with pytest.raises(WorldError, match=r"world\.rocks_per_100m2=40"):
        other(rocks_per_100m2=40.0, trees_per_100m2=12.0)


@pytest.mark.parametrize(
    "wrong", [{"seed": -1}, {"slope_rad": 0.7}, {"roughness_m": -0.1}, {"rocks_per_100m2": 41}, {"tree": 3}]
)
def test_bad_settings_are_refused(wrong):
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        RubiconConf(**wrong)


@pytest.mark.slow
def test_rovers_stand_and_reach_goals():
    batch = rovers_in(rubicon(0), 6)
    assert all_stand(batch)
    # Driven straight, whatever lies between: some arrive, and not all of them without a touch.
    reached, _ = goals_reached(batch)
    batch.close()
    assert reached >= 3
