"""Tyres: wheels hit obstacles, walkers and robots in their true width, and roll on the ground as ever."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from defusedxml.ElementTree import parse
from scenes import (
    GRAVITY_MPS2,
    SUBSTEPS,
    TIMESTEP_S,
    Backend,
    Drive,
    Stage,
    allowed,
    box,
    every_backend,
    plane,
    plane_field,
    quaternion_of,
    rover_body,
    rover_without_tyres,
    walker,
)

from dune_rl.geometry.frames import rotation_matrices
from dune_rl.physics.contact_gate import ContactGate, TyreActivation
from dune_rl.physics.robot_body import RobotBody, Tyre
from dune_rl.physics.shapes import StaticBody
from dune_rl.robots.leo_rover import LeoRover, LeoRoverConf
from dune_rl.robots.rover_zero import RoverZero, RoverZeroConf
from dune_rl.robots.wheeled import WheeledRobot


@dataclass(frozen=True)
class Case:
    """A robot, the outer face of its tyres [m] from the middle, and kerbs [m] that it climbs and does not."""

    make: Callable[[], WheeledRobot]
    face_m: float
    speed_mps: float
    low_m: float
    high_m: float


CASES = {
    "rover_zero": Case(lambda: RoverZero(RoverZeroConf(), 1), 0.18 + 0.0415, 0.8, 0.08, 0.12),
    "leo_rover": Case(lambda: LeoRover(LeoRoverConf(), 1), 0.1789 + 0.035, 0.4, 0.04, 0.10),
}
every_rover = pytest.mark.parametrize("case", CASES.values(), ids=CASES)


def drive(
    backend: Backend, case: Case, statics: Sequence[StaticBody], steps: int
) -> tuple[Drive, np.ndarray, int]:
    """Drive straight on; the drive, rows of x, y, z, forward speed and pitch, and the steps with contacts."""
    rover = case.make()
    run = Drive(
        backend,
        statics=[plane(), *statics],
        rover=rover,
        position_w=(0.0, 0.0, rover.description.standing_height_m),
    )
    rows, hits = [], 0
    for _ in range(steps):
        run.step(case.speed_mps, 0.0)
        rows.append([*run.stage.position, run.stage.velocity[0], np.arcsin(-run.stage.rotation[2, 0])])
        hits += run.stage.contacts() == {1}
    return run, np.array(rows), hits


def kerb(height_m: float) -> StaticBody:
    return box((0.9 + 5.0, 0.0), 10.0, 4.0, height_m, name="kerb")


@every_backend
@every_rover
def test_a_low_kerb_bumps_and_counts_and_is_climbed(backend, case):
    _, rows, hits = drive(backend, case, [kerb(case.low_m)], 120)
    x, _, z, speed, pitch = rows.T
    assert hits > 20
    # Up with the front wheels first, and slower meanwhile.
    assert pitch.min() < -0.1
    assert speed[10:].min() < 0.6 * case.speed_mps
    assert x[-1] > 1.4
    # A rounded tyre sinks into an edge by a millimetre or two.
    assert z[-1] - z[5] == pytest.approx(case.low_m, abs=4e-3)
    assert abs(pitch[-1]) < 0.02


@every_backend
@every_rover
def test_a_high_kerb_stops_it(backend, case):
    _, rows, hits = drive(backend, case, [kerb(case.high_m)], 120)
    assert hits > 20
    # With wheels that push up against it, but not over it.
    assert rows[-1, 0] < 1.0
    assert abs(rows[-1, 3]) < 0.1


@every_backend
def test_before_there_were_tyres_the_kerb_was_air(backend):
    rover = replace(CASES["rover_zero"], make=bare_rover)
    _, rows, hits = drive(backend, rover, [kerb(0.08)], 60)
    assert hits == 0
    assert rows[10:, 3].min() > 0.75


def bare_rover() -> RoverZero:
    rover = RoverZero(RoverZeroConf(), 1)
    rover.body = rover_without_tyres()
    return rover


@every_backend
@every_rover
def test_a_wall_over_a_tyre_alone_is_a_contact(backend, case):
    # It reaches 4 mm into the tyres of the left side, and stands well clear of everything else.
    wall = box((1.5, case.face_m - 0.004 + 0.1), 6.0, 0.2, 0.6, name="wall")
    run, _, hits = drive(backend, case, [wall], 30)
    assert hits >= 5
    assert run.stage.position[1] < 0.0


@pytest.mark.slow(all_but=["left-*"])
@every_backend
@every_rover
@pytest.mark.parametrize("side", [1, -1], ids=["left", "right"])
def test_along_a_wall_a_centimetre_off_there_is_none(backend, case, side):
    wall = box((1.5, side * (case.face_m + 0.01 + 0.1)), 6.0, 0.2, 0.6, name="wall")
    run, rows, hits = drive(backend, case, [wall], 40)
    assert hits == 0
    # And nothing else is felt of it, while the tyres of that side are there.
    assert run.stage.scene._tyres.active == [{0, 2} if side > 0 else {1, 3}]
    _, free, _ = drive(backend, case, [], 40)
    np.testing.assert_allclose(rows, free, atol=2e-3)


@every_backend
def test_a_post_lower_than_the_hull_passes_between_the_tracks_and_not_in_one(backend):
    # The hull is 9 cm above the ground, and 27.7 cm are between the tyres.
    case = CASES["rover_zero"]
    for y, met in ((0.0, False), (0.115, False), (0.18, True), (-0.15, True)):
        post = box((1.0, y), 0.03, 0.03, 0.085, name="post")
        _, rows, hits = drive(backend, case, [post], 60)
        assert (hits > 0) == met, y
        assert (rows[10:, 3].min() < 0.75) == met, y


@every_backend
@every_rover
def test_a_walker_at_a_tyre_is_a_contact_and_one_beside_it_is_none(backend, case):
    # By the middle of the front tyre, whose top is no higher than the round lower end of the walker.
    rover = case.make()
    axle, top = np.array([1, 2]) * rover.description.contact_radius_m
    for height, gap, met in ((axle, -0.005, True), (top, 0.01, False)):
        half_width = np.sqrt(0.25**2 - (0.25 - height) ** 2)
        y = case.face_m + half_width + gap
        stage = Stage(backend, kinematics=[walker()], robot=rover.body)
        stage.place(
            (0.0, 0.0, rover.description.standing_height_m),
            actors=[[rover.description.contact_centres_b[0, 0], y, 0.0, 0.0]],
        )
        seen = set()
        for _ in range(5):
            stage.step(SUBSTEPS)
            seen |= stage.contacts()
        assert seen == ({1} if met else set())


@pytest.mark.slow
@every_backend
@pytest.mark.parametrize("friction", [0.3, 0.6])
def test_on_an_obstacle_it_holds_by_the_friction_of_its_tyres(backend, friction):
    # A slope that is no ground: nothing but tyres stands on it.
    for share, slides in ((0.85, False), (1.3, True)):
        slope = np.arctan(share * friction)
        vertices, faces = plane_field(slope, half=4, spacing_m=5.0).mesh()
        # Solid, for a mesh that is open has a margin in DART.
        stage = Stage(backend, [plane_below(), StaticBody("slope", vertices, faces, friction, ground=False)])
        quaternion = quaternion_of(0.0, slope)
        up = rotation_matrices(quaternion)[:, 2]
        start = np.array([-1.5, -3.5, -1.5 * np.tan(slope)])
        stage.place(start + 0.128 * up, quaternion)
        stage.step(100)
        before, position = stage.velocity, stage.position
        stage.step(100)
        assert stage.contacts() == {1}
        gained = np.linalg.norm(stage.velocity) - np.linalg.norm(before)
        if slides:
            pull = GRAVITY_MPS2 * (np.sin(slope) - friction * np.cos(slope))
            assert gained / (100 * TIMESTEP_S) == pytest.approx(pull, rel=0.25)
        else:
            assert np.linalg.norm(stage.position - position) < allowed(backend, 0.01, 0.02)


def plane_below() -> StaticBody:
    vertices, faces = plane_field(0.0, half=4, spacing_m=20.0).mesh()
    return StaticBody("ground", vertices - [0.0, 0.0, 50.0], faces, 1.0, ground=True)


# -- far from everything ---------------------------------------------------------------------------


def turn_and_drive(stage: Stage) -> list[bytes]:
    stage.place()
    states = []
    for step in range(60):
        stage.step(SUBSTEPS, [5.0, 3.0, 5.0, 3.0] if step < 30 else [-4.0, 4.0, -4.0, 4.0])
        states.append(stage.state.tobytes() + stage.wheels.tobytes())
    return states


@every_backend
def test_far_from_everything_tyres_change_no_byte(backend):
    far = [plane(), box((15.0, 0.0), 1.0, 1.0, 1.0)]
    assert turn_and_drive(Stage(backend, far)) == turn_and_drive(
        Stage(backend, far, robot=rover_without_tyres())
    )


@every_backend
def test_ground_is_rolled_on_with_tyres_as_without(backend):
    # Between posts it has them all the time, and never touches one.
    near = [plane(), *(box((x, y), 0.1, 0.1, 1.0) for x, y in ((0.0, 0.55), (0.0, -0.55), (0.6, 0.0)))]
    ends = []
    for robot in (rover_body(), rover_without_tyres()):
        stage = Stage(backend, near, robot=robot)
        stage.place()
        yaws, active = [], []
        for _ in range(60):
            stage.step(SUBSTEPS, [-4.0, 4.0, -4.0, 4.0])
            yaws.append(stage.yaw)
            active.append(len(stage.scene._tyres.active[0]))
            assert stage.contacts() == set()
        assert min(active[1:]) >= 2 if robot.tyres else max(active) == 0
        ends.append([*stage.position, np.unwrap(yaws)[-1]])
    np.testing.assert_allclose(*ends, atol=5e-3)


@every_backend
def test_tyres_come_and_go_in_the_middle_of_a_drive(backend):
    stage = Stage(backend, [plane(), box((3.0, 0.4), 0.1, 0.1, 1.0)])
    stage.place()
    stage.engine.set_wheel_contacts([0.9] * 4, [0.0] * 4)
    active, previous = [], np.append(stage.state, stage.wheel_angles)
    for _ in range(160):
        stage.step(SUBSTEPS, 6.0)
        active.append(stage.scene._tyres.active[0])
        state = np.append(stage.state, stage.wheel_angles)
        # No state jumps, wheel angles and speeds included.
        change = np.abs(state - previous)
        assert change[:3].max() < 0.05
        assert change[7:13].max() < 0.7
        assert change[13:].max() < 0.4
        previous = state
    # Those of the left side, one after the other, and together for a while longer.
    assert not active[0] and {0, 2} in active and not active[-1]
    assert set().union(*active) == {0, 2}
    assert sum(one != other for one, other in pairwise(active)) <= 5
    assert stage.position[0] > 5.0
    assert abs(stage.position[1]) < 0.05


@every_backend
def test_a_new_start_leaves_no_tyre_behind(backend):
    stage = Stage(backend, [plane(), box((0.5, 0.0), 0.1, 4.0, 0.08)])
    found = []
    for _ in range(2):
        stage.place()
        states = []
        for _ in range(40):
            stage.step(SUBSTEPS, 5.0)
            states.append((stage.state.tobytes(), stage.contacts()))
        found.append(states)
        # Far off, and then from the start again.
        stage.place((9.0, 9.0, 0.125))
        stage.step(SUBSTEPS, 5.0)
        assert stage.scene._tyres.active == [set()]
    assert found[0] == found[1]
    assert any(contacts for _, contacts in found[0])


@every_backend
def test_a_state_that_diverges_with_tyres_is_no_crash(backend):
    stage = Stage(backend, [plane(), box((0.6, 0.0), 0.1, 4.0, 0.08)])
    stage.place()
    stage.step(SUBSTEPS, 5.0)
    stage.engine.apply_force([1e30, 1e30, 1e30])
    for _ in range(40):
        stage.step(SUBSTEPS, 5.0)
    stage.place()
    stage.step(SUBSTEPS, 5.0)
    assert np.isfinite(stage.state).all()


@dataclass
class Placed:
    """A robot at rest as gate and activation see it, heading along x."""

    x: float
    y: float
    reach_m: float = 0.45
    base_mass_kg: float = 30.0

    def planar_motion(self) -> tuple[float, float, float]:
        return self.x, self.y, 0.0

    def body_state(self) -> tuple[float, ...]:
        return (self.x, self.y, 0.125, 0.0, 0.0, 0.0, 1.0, *[0.0] * 6)


def needed(robot: Placed, *statics: StaticBody, others: Sequence[Placed] = (), walkers=()) -> frozenset[int]:
    """Tyres of a rover that can touch anything in a control step; other robots have none.

    `walkers` have the x, where y is 0, from which and to which each goes.
    """
    old, new = ([[ends[index], *[0.0] * 5] for ends in walkers] for index in (0, 1))
    bodies = [rover_body(), *(rover_without_tyres() for _ in others)]
    gate = ContactGate((plane(), *statics), [walker() for _ in walkers], bodies)
    gate.find_contacts([robot, *others], 0.05, {}, old, new)
    assert not any(gate.needed_tyres[1:])
    return gate.needed_tyres[0]


# What a tyre reaches in a control step of these tests, and by how much the map of obstacles may be too near.
REACH_M, MAP_ERROR_M = np.hypot(0.125, 0.0415) + 0.05 + 0.05, 0.4


@pytest.mark.parametrize("seed", range(5))
def test_tyres_that_can_touch_an_obstacle_are_active_and_far_ones_are_not(seed):
    rng = np.random.default_rng(seed)
    low = rng.uniform(-6.0, 6.0, (6, 2))
    high = low + rng.uniform(0.02, 3.0, (6, 2))
    centres, sizes = (low + high) / 2, high - low
    boxes = [box(tuple(xy), *size, 1.0) for xy, size in zip(centres.tolist(), sizes.tolist(), strict=True)]
    gate = ContactGate((plane(), *boxes), (), [rover_body()])
    seen = []
    for xy in rng.uniform(-7.0, 7.0, (200, 2)):
        places = xy + RoverZero.description.contact_centres_b[:, None, :2]
        outside = np.maximum(np.maximum(low - places, places - high), 0.0)
        apart = np.hypot(*np.moveaxis(outside, 2, 0)).min(axis=1)
        gate.find_contacts([Placed(*xy)], 0.05, {}, (), ())
        active = np.isin(np.arange(4), list(gate.needed_tyres[0]))
        assert active[apart < REACH_M - 1e-9].all()
        assert not active[apart > REACH_M + MAP_ERROR_M].any()
        seen.append(active)
    assert 0.05 < np.mean(seen) < 0.95


def test_tyres_near_a_walker_or_another_robot_are_needed():
    robot = Placed(0.0, 0.0)
    assert needed(robot, walkers=[(0.58, 0.58)]) == {0, 1}
    assert needed(robot, walkers=[(0.58, 0.58), (-0.58, -0.58)]) == {0, 1, 2, 3}
    assert needed(robot, others=[Placed(-0.75, 0.0), Placed(9.0, 0.0)]) == {2, 3}
    assert needed(robot, others=[Placed(9.0, 0.0)], walkers=[(3.0, 3.0)]) == set()
    assert needed(Placed(np.nan, 0.0), walkers=[(0.58, 0.58)]) == set()


def test_a_walker_that_moves_away_is_met_at_every_place_of_its_way():
    assert needed(Placed(0.0, 0.0), walkers=[(0.9, 0.9)]) == set()
    assert needed(Placed(0.0, 0.0), walkers=[(0.55, 0.9)]) == {0, 1}


def test_tyres_stay_a_while_and_go_together():
    tyres, near, far, other = TyreActivation(1), [frozenset({0, 1})], [frozenset()], [frozenset({2, 3})]
    assert tyres.update(near) == [0]
    waited = 1
    while not tyres.update(far):
        assert tyres.active == near
        waited += 1
    assert 5 < waited < 60
    assert tyres.active == far
    # A return starts the count again, and other tyres join.
    assert tyres.update(near) == [0]
    for _ in range(3):
        assert all(tyres.update(far) == [] for _ in range(waited - 1))
        assert tyres.update(near) == []
    assert tyres.update(other) == [0]
    assert tyres.active == [{0, 1, 2, 3}]
    tyres.reset()
    assert tyres.active == far


# -- sizes -----------------------------------------------------------------------------------------


@every_rover
def test_tyres_are_at_the_wheels_and_as_wide_as_these_are_drawn(case):
    robot = case.make()
    assert [tyre.link for tyre in robot.body.tyres] == list(robot.body.ground_links)
    spheres = collision_spheres(robot.body)
    for tyre in robot.body.tyres:
        centre, radius = spheres[tyre.link]
        np.testing.assert_allclose(tyre.centre, centre, atol=1e-9)
        assert (tyre.radius_m, tyre.width_m) == (radius, robot.description.contact_width_m)
    centres = robot.description.contact_centres_b[:, 1]
    np.testing.assert_allclose(
        np.abs(centres) + robot.description.contact_width_m / 2, case.face_m, atol=1e-9
    )
    np.testing.assert_allclose(
        [tyre.position_b for tyre in robot.body.tyres], robot.description.contact_centres_b
    )


def collision_spheres(body: RobotBody) -> dict[str, tuple[np.ndarray, float]]:
    """Centre and radius of the sphere of each link that has one."""
    spheres = {}
    for link in parse(body.urdf).getroot().findall("link"):
        sphere, origin = link.find("collision/geometry/sphere"), link.find("collision/origin")
        if sphere is not None:
            centre = np.zeros(3) if origin is None else np.array(origin.get("xyz").split(), float)
            spheres[link.get("name")] = centre, float(sphere.get("radius"))
    return spheres


@every_backend
def test_a_tyre_of_no_link_is_told(backend):
    robot = replace(rover_body(), tyres=(Tyre("fifth_wheel", 0.1, 0.1, (0.0, 0.0, 0.0)),))
    with pytest.raises(Exception, match="has no link fifth_wheel"):
        Stage(backend, robot=robot).place()
