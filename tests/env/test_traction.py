"""What surfaces do to wheels: they grip, bounce, give and roll as the parameters say, wheel by wheel."""

from dataclasses import replace

import numpy as np
import pytest
from robot_fixtures import MIDDLE, RoverOnGround, named, slope_world
from rollouts import digest_of
from scenes import GRAVITY_MPS2, MASS_KG, WHEEL_RADIUS_M, allowed, box, every_backend
from simulations import act, motion_of_group, started_simulation

from dune_rl.env.scene_spec import scene_spec
from dune_rl.geometry.heightfield import HeightField
from dune_rl.physics.interface import PhysicsConf
from dune_rl.robots.rover_zero import RoverZero, RoverZeroConf, RoverZeroDriveConf
from dune_rl.worlds.surfaces import SURFACE_NAMES, SURFACES, SurfaceMap
from dune_rl.worlds.world import Prop, World

LOAD_N = MASS_KG * GRAVITY_MPS2 / 4
# Wheels that roll are sped up and slowed down too: mass and four inertias over the radius squared.
ROLLING_MASS_KG = MASS_KG + 4 * 0.01008 / WHEEL_RADIUS_M**2
FREE_WHEELS = RoverZeroConf(drive=RoverZeroDriveConf(no_load_speed_radps=None, max_torque_nm=1e-9))


def slides(rover: RoverOnGround) -> bool:
    """Whether a rover with locked wheels gathers speed."""
    rover.step(count=10)
    speed, start = np.linalg.norm(rover.motion.velocity_w[0]), rover.position.copy()
    rover.step(count=10)
    faster = np.linalg.norm(rover.motion.velocity_w[0]) > speed + 0.02
    assert (np.linalg.norm(rover.position - start) > 0.035) == faster
    return bool(faster)


@every_backend
@pytest.mark.parametrize("name", ["mud", "grass", "sand", "rock"])
def test_a_rover_holds_on_a_slope_up_to_the_friction_of_its_surface(backend, name):
    surface = named(name)
    for share in (0.94, 1.06):
        slope = np.arctan(share * surface.friction)
        assert slides(RoverOnGround(backend, slope_world(surface, slope))) == (share > 1.0)


@every_backend
@pytest.mark.parametrize("mapped", [True, False])
def test_a_scene_s_factor_multiplies_friction(backend, mapped):
    surface = named("concrete")
    world = slope_world(surface if mapped else None, 0.45)
    friction = surface.friction if mapped else 1.0
    for share in (0.9, 1.1):
        factor = np.tan(0.45) / friction * share
        assert slides(RoverOnGround(backend, world, factors=(factor, 1.0))) == (share < 1.0)


@pytest.mark.slow(all_but=["*bullet*"])
@every_backend
@pytest.mark.parametrize("name", ["mud", "gravel", "concrete"])
def test_the_steepest_climb_is_what_friction_leaves_over_rolling_resistance(backend, name):
    surface = named(name)
    steepest = surface.friction - surface.rolling_resistance
    for tangent, climbs in ((0.9 * steepest, True), (1.06 * surface.friction, False)):
        rover = RoverOnGround(backend, slope_world(surface, np.arctan(tangent)))
        start = rover.position.copy()
        rover.step(0.5 / WHEEL_RADIUS_M, count=50)
        ahead = (rover.position - start) @ rover.motion.rotation[0, :, 0]
        assert (ahead > 0.5) if climbs else (ahead < 0.1)


@pytest.mark.slow(all_but=["concrete-*", "sand-*"])
@every_backend
@pytest.mark.parametrize("sinkage", [False, True])
@pytest.mark.parametrize("name", ["concrete", "gravel", "grass", "sand"])
def test_a_rover_coasts_as_far_as_rolling_resistance_lets_it(backend, name, sinkage):
    # Down a ramp, and along level ground within one large triangle: edges take some of a wheel's speed.
    x = np.arange(-2, 3) * 8.0
    terrain = HeightField(np.tile(np.tan(0.3) * np.maximum(-x, 0.0), (3, 1)), 8.0, (-16.0, 0.0))
    surface = named(name)
    surfaces = SurfaceMap([[0]], terrain.extent, [surface], sinkage=sinkage)
    world = World("ramp", terrain, region=(-1, 1, -1, 1), surfaces=surfaces)
    rover = RoverOnGround(backend, world, at=(-3.0, 7.0), conf=FREE_WHEELS)
    while rover.position[0] < 0.6:
        rover.step()
    speeds = []
    while rover.position[0] < 4.5 and rover.speed > 0.3:
        rover.step()
        speeds.append(rover.speed)
    coefficient = surface.rolling_resistance
    if sinkage and surface.soil is not None:
        wheel = LOAD_N, 2 * WHEEL_RADIUS_M, RoverZero.description.contact_width_m
        coefficient = 0.015 + surface.soil.compaction_n(*wheel) / LOAD_N
    expected = coefficient * GRAVITY_MPS2 * MASS_KG / ROLLING_MASS_KG
    # What lands from the ramp bounces at first.
    speeds = speeds[len(speeds) // 2 :]
    assert (speeds[0] - speeds[-1]) / ((len(speeds) - 1) * 0.05) == pytest.approx(expected, rel=0.05)


@every_backend
@pytest.mark.parametrize("name", ["concrete", "grass", "sand"])
def test_a_rover_rolls_down_a_slope_as_fast_as_rolling_resistance_lets_it(backend, name):
    surface = named(name)
    rover = RoverOnGround(backend, slope_world(surface, 0.3), conf=FREE_WHEELS)
    rover.step(count=4)
    speed = rover.speed
    rover.step(count=10)
    pull = np.sin(0.3) - surface.rolling_resistance * np.cos(0.3)
    expected = GRAVITY_MPS2 * pull * MASS_KG / ROLLING_MASS_KG
    assert (speed - rover.speed) / 0.5 == pytest.approx(expected, rel=0.03)


@every_backend
def test_rolling_resistance_stops_a_rover_and_never_drives_it(backend):
    for slope in (0.0, 0.1):
        rover = RoverOnGround(backend, slope_world(named("sand"), slope), conf=FREE_WHEELS)
        for _ in range(60):
            rover.step()
            # Below what sand holds, a rover creeps by what gravity adds in one control step, and no more.
            creep = GRAVITY_MPS2 * np.sin(slope) * 0.05
            assert -1.05 * creep - 1e-4 < rover.speed < 1e-3
    free = RoverOnGround(backend, slope_world(named("concrete"), 0.1), conf=FREE_WHEELS)
    free.step(count=60)
    assert free.speed < -1.5


@pytest.mark.slow(all_but=["sand-bullet"])
@every_backend
@pytest.mark.parametrize("name", ["sand", "mud", "rock"])
def test_wheels_stand_as_deep_as_bekker_says(backend, name):
    surface = named(name)
    rover = RoverOnGround(backend, slope_world(surface, sinkage=True))
    rover.step(count=40)
    depth = LOAD_N / surface.stiffness_npm
    if surface.soil is not None:
        depth += surface.soil.sinkage_m(LOAD_N, 2 * WHEEL_RADIUS_M, RoverZero.description.contact_width_m)
        assert depth > 1e-3
    # DART's ground is never harder than 2e5 N/m.
    assert -rover.height == pytest.approx(depth, rel=0.03, abs=allowed(backend, 5e-5, 1.5e-4))
    firm = RoverOnGround(backend, slope_world(surface))
    firm.step(count=40)
    assert -firm.height < 1e-3


@every_backend
@pytest.mark.parametrize("factor", [1.0, 0.5])
@pytest.mark.parametrize("stiffness", [2e3, 2e4])
def test_ground_gives_way_by_load_over_stiffness(backend, stiffness, factor):
    surface = replace(named("grass"), stiffness_npm=stiffness, damping_nspm=200.0)
    rover = RoverOnGround(backend, slope_world(surface), factors=(1.0, factor))
    rover.step(count=60)
    assert -rover.height == pytest.approx(LOAD_N / (stiffness * factor), rel=0.03)


@pytest.mark.slow(all_but=["concrete-bullet", "mud-bullet", "wood-dart", "rock-bullet", "grass-dart"])
@every_backend
@pytest.mark.parametrize("name", SURFACE_NAMES)
def test_a_rover_bounces_as_restitution_says(backend, name):
    surface = named(name)
    bounces = []
    for drop_m in (0.2, 0.3, 0.4, 0.5):
        rover = RoverOnGround(backend, slope_world(surface), drop_m=drop_m)
        rises = []
        for _ in range(110):
            rover.step(substeps=1)
            rises.append(rover.motion.velocity_w[0, 2])
        impact = int(np.argmin(rises))
        bounces.append(-max(rises[impact : impact + 25]) / rises[impact])
    # How deep a wheel is when the step of the impact ends is a matter of chance.
    assert np.mean(bounces) == pytest.approx(surface.restitution, abs=0.1)


@pytest.mark.slow(all_but=["*mud*", "*concrete*"])
@every_backend
@pytest.mark.parametrize("sinkage", [False, True])
@pytest.mark.parametrize("name", SURFACE_NAMES)
def test_no_surface_makes_a_rover_tremble(backend, name, sinkage):
    rover = RoverOnGround(backend, slope_world(named(name), 0.15, sinkage=sinkage))
    rover.step(count=30)
    for _ in range(60):
        rover.step(substeps=1)
        assert np.abs(rover.motion.velocity_w).max() < 0.02
        assert np.abs(rover.motion.angular_w).max() < 0.02
    rover.step(0.5 / WHEEL_RADIUS_M, count=60)
    assert rover.speed == pytest.approx(0.5, rel=0.05)


@every_backend
def test_grip_on_one_side_turns_a_rover(backend):
    ice = replace(named("concrete"), friction=0.02)
    terrain = slope_world(None, 0.1).terrain
    rows = np.zeros((8, 1), int)
    world = World("split", terrain, region=(-1, 1, -1, 1))
    # Rows run along y, so that the left wheels stand on the upper half; number 1 is ice.
    for slippery, sign in ((0, -1.0), (1, 1.0)):
        rows[4:], rows[:4] = slippery, 1 - slippery
        world.surfaces = SurfaceMap(rows, terrain.extent, [named("concrete"), ice])
        rover = RoverOnGround(backend, world, at=(-1.5, 0.0))
        rover.step(0.5 / WHEEL_RADIUS_M, count=20)
        assert sign * rover.motion.roll_pitch_yaw[0, 2] > 0.05


class Witness:
    """An engine that writes down the friction of its wheels whenever it is set."""

    def __init__(self) -> None:
        self.frictions: list[list[float]] = []

    def set_wheel_contacts(self, friction, restitution, stiffness, damping) -> None:
        self.frictions.append(friction)


@every_backend
def test_wheels_change_their_friction_one_after_another(backend):
    terrain = slope_world(None).terrain
    surfaces = SurfaceMap([[SURFACE_NAMES.index("concrete"), SURFACE_NAMES.index("mud")]], terrain.extent)
    world = World("border", terrain, region=(-1, 1, -1, 1), surfaces=surfaces)
    rover = RoverOnGround(backend, world, at=(-0.5, -3.5), yaw=0.5)
    witness = Witness()
    crossed = []
    for _ in range(60):
        rover.traction.update([witness], rover.motion)
        wheels = rover.position + rover.robot.description.contact_centres_b @ rover.motion.rotation[0].T
        crossed.append((wheels[:, 0] > 0.0).tolist())
        rover.step(0.6 / WHEEL_RADIUS_M)
    assert crossed[0] == [False] * 4
    assert crossed[-1] == [True] * 4
    expected = [row for row, before in zip(crossed[1:], crossed, strict=False) if row != before]
    assert len(expected) == 4
    mud, concrete = named("mud").friction, named("concrete").friction
    assert witness.frictions == [[mud if over else concrete for over in row] for row in expected]


@every_backend
def test_a_deck_is_of_its_own_surface_and_what_is_under_it_is_not(backend):
    terrain = slope_world(None).terrain
    deck = box((0.0, 0.0), 4.0, 2.0, 1.0)
    vertices = deck.vertices.copy()
    vertices[:, 2] = np.where(vertices[:, 2] < 0.5, 0.9, 1.0)
    prop = Prop("deck", "bridge", vertices, deck.faces, drivable=True, surface="wood")
    mud = SurfaceMap([[SURFACE_NAMES.index("mud")]], terrain.extent)
    world = World("bridge", terrain, [prop], region=(-1, 1, -1, 1), surfaces=mud)
    under, beside = RoverOnGround(backend, world, at=(0.0, 0.0)), RoverOnGround(backend, world, at=(0.0, 3.0))
    over = RoverOnGround(backend, world, at=(0.0, 0.0), drop_m=1.0)
    over.step(count=10)
    assert over.position[2] == pytest.approx(1.0 + WHEEL_RADIUS_M, abs=2e-3)
    for rover, name in ((under, "mud"), (beside, "mud"), (over, "wood")):
        assert {SURFACES[number].name for number in rover.traction.surfaces[0]} == {name}


@every_backend
def test_wheels_in_the_air_and_wheels_that_spin_roll_on_nothing(backend):
    surface = named("sand")
    for world, drop_m, wheels in (
        (slope_world(surface), 1.0, 5.0),
        (slope_world(replace(surface, friction=1e-3)), 0.0, 5.0),
    ):
        rover = RoverOnGround(backend, world, drop_m=drop_m)
        rover.step(wheels, count=4)
        force = rover.traction.update([rover.engine], rover.motion)
        assert np.abs(force).max() < 0.2
    rolling = RoverOnGround(backend, slope_world(surface))
    rolling.step(5.0, count=20)
    force = rolling.traction.update([rolling.engine], rolling.motion)
    np.testing.assert_allclose(force[0], [-0.2 * MASS_KG * GRAVITY_MPS2, 0.0, 0.0], atol=0.1)


@every_backend
def test_a_world_without_a_map_is_left_alone(backend):
    robot = RoverZero(RoverZeroConf(), 1)
    spec = scene_spec(slope_world(None), (robot.body,), (), PhysicsConf())
    assert [(body.friction, body.restitution) for body in spec.statics] == [(1.0, 0.0)]
    rover = RoverOnGround(backend, slope_world(None), at=MIDDLE)
    witness = Witness()
    assert rover.traction.update([witness], rover.motion) is None
    assert not rover.traction.needs_wheels
    assert witness.frictions == []


NATURAL = {"surfaces": "natural", "sinkage": True}


@pytest.mark.slow
@pytest.mark.parametrize(("world", "robots"), [("flat", 2), ("island", 1)])
def test_natural_worlds_repeat_themselves(world, robots):
    def rollout(**other: bool) -> str:
        simulation = started_simulation(
            {"name": world} | NATURAL | other,
            num_scenes=2,
            robots=["rover_zero"] * robots,
            task={"terminations": {"time_limit": {"max_steps": 25}}},
        )
        digests = []
        for _ in range(2):
            simulation.reseed(0)
            digests.append(digest_of(simulation, 30))
        simulation.close()
        assert digests[0] == digests[1], "a reset leaves something behind"
        return digests[0]

    assert rollout() == rollout()
    assert rollout(sinkage=False) != rollout()


@pytest.mark.slow
def test_a_restored_simulation_goes_on_alike():
    simulation, other = (started_simulation({"name": "flat"} | NATURAL, num_scenes=2) for _ in range(2))
    for _ in range(15):
        act(simulation, [0.8, 0.1])
    other.restore(simulation.save_state())
    surfaces = [each.group().body.traction.surfaces for each in (simulation, other)]
    np.testing.assert_array_equal(*surfaces)
    for _ in range(15):
        positions = []
        for each in (simulation, other):
            act(each, [0.8, 0.1])
            positions.append(motion_of_group(each).position_w)
        np.testing.assert_array_equal(*positions)
    simulation.close()
    other.close()
