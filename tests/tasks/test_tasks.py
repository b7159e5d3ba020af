"""Rewards and endings against figures worked out by hand."""

from dataclasses import fields, replace

import numpy as np
import pytest
import yaml
from dune_rl.tasks.point_goal import PointGoalConf
from dune_rl.tasks.snapshot import Snapshot
from pydantic import ValidationError

from dune_rl.actors.actor import ActorConf
from dune_rl.config.build import make_batch
from dune_rl.config.schema import EnvConf
from dune_rl.paths import conf_folder
from dune_rl.physics.interface import PhysicsConf
from dune_rl.tasks.rewards import REWARD_TERMS, RewardConf, reward_terms
from dune_rl.tasks.terminations import TerminationConf, endings
from dune_rl.tasks.walking import WalkingConf, walker_observation, walker_reward
from dune_rl.worlds.flat import FlatConf

PAPER = PointGoalConf()
DUNE_CODE = PointGoalConf.model_validate(
    yaml.safe_load((conf_folder() / "task" / "dune_code.yaml").read_text())
)
NO, YES = np.array([False]), np.array([True])


def moment(**changes) -> Snapshot:
    """One rover in the open, 5 m from its goal and facing it, at rest."""
    one = {
        "position_w": np.zeros((1, 3)),
        "roll_pitch_yaw": np.zeros((1, 3)),
        "tilt": np.zeros(1),
        "speed": np.zeros(1),
        "angular_b": np.zeros((1, 3)),
        "acceleration_b": np.zeros((1, 3)),
        "goal_distance": np.array([5.0]),
        "previous_goal_distance": np.array([5.0]),
        "goal_heading": np.zeros(1),
        "clearance": np.array([np.inf]),
        "new_collisions": np.zeros(1, np.int64),
        "touching": NO,
        "steps": np.ones(1, np.int64),
        "steps_since_moved": np.zeros(1, np.int64),
        "out_of_world": NO,
        "diverged": NO,
    }
    return Snapshot(**one | {name: np.array(value) for name, value in changes.items()})


def earned(now: Snapshot, task: PointGoalConf = PAPER) -> dict[str, float]:
    """Terms that are not nothing, with the endings that belong to the moment."""
    end = endings(now, task.termination)
    terms = reward_terms(now, task.reward, end.reached, end.stuck, end.flipped)
    assert terms.shape == (1, len(REWARD_TERMS))
    return {name: value for name, value in zip(REWARD_TERMS, terms[0], strict=True) if value}


# -- the paper's reward ----------------------------------------------------------------------------


def test_progress_earns_its_metres():
    now = moment(goal_distance=[4.96], speed=[0.8])
    assert earned(now) == pytest.approx(
        {"distance": 1.5 * 0.04 * 0.3, "heading": 1.5 * 0.01, "velocity": 0.0025 * 0.8}
    )


@pytest.mark.parametrize("moved", [0.0, -0.04])
def test_without_progress_a_thousandth_is_lost(moved):
    assert earned(moment(goal_distance=[5.0 - moved]))["distance"] == pytest.approx(1.5 * -0.001)


@pytest.mark.parametrize(
    ("heading", "distance"),
    [(np.pi / 2, 0.04 * 0.3), (-np.pi / 2, 0.04 * 0.3), (np.pi / 2 + 1e-6, -0.001), (-3.0, -0.001)],
)
def test_progress_counts_while_the_goal_is_ahead(heading, distance):
    now = moment(goal_distance=[4.96], goal_heading=[heading])
    assert earned(now)["distance"] == pytest.approx(1.5 * distance)


@pytest.mark.parametrize(
    ("heading", "share"),
    [(0.0, 1.0), (np.pi / 4, 0.5), (-np.pi / 4, 0.5), (3 * np.pi / 4, -0.5), (-np.pi, -1.0), (2.0, -0.27324)],
)
def test_heading_falls_from_one_to_minus_one(heading, share):
    assert earned(moment(goal_heading=[heading]))["heading"] == pytest.approx(1.5 * 0.01 * share, abs=1e-7)


def test_heading_is_nothing_across():
    assert "heading" not in earned(moment(goal_heading=[np.pi / 2]))


def test_backing_off_costs_speed():
    assert earned(moment(speed=[-0.4]))["velocity"] == pytest.approx(-0.001)


@pytest.mark.parametrize(("distance", "reached"), [(0.75, False), (0.7499, True)])
def test_a_goal_comes_instead_of_the_rest(distance, reached):
    got = earned(moment(goal_distance=[distance], speed=[1.0]))
    assert (got == {"goal": 100.0}) == reached
    assert ("distance" in got) == (not reached)


@pytest.mark.parametrize(("clearance", "close"), [(0.2, False), (0.1999, True), (0.0, True)])
def test_too_close_comes_instead_of_the_rest(clearance, close):
    got = earned(moment(clearance=[clearance], speed=[1.0]))
    assert (got == {"collision": -0.5}) == close
    assert ("velocity" in got) == (not close)


def test_to_touch_is_too_close_whatever_the_clearance():
    assert earned(moment(touching=YES)) == {"collision": -0.5}


def test_a_goal_beside_a_wall_is_a_goal():
    assert earned(moment(goal_distance=[0.5], clearance=[0.1], touching=YES)) == {"goal": 100.0}


def test_an_encounter_may_cost_besides_and_once():
    task = PAPER.model_copy(update={"reward": RewardConf(contact=-2.0)})
    assert earned(moment(touching=YES, new_collisions=[1]), task) == {"collision": -0.5, "contact": -2.0}
    assert earned(moment(touching=YES, new_collisions=[0]), task) == {"collision": -0.5}


def test_every_scene_earns_its_own():
    one, two = moment(goal_distance=[0.1]), moment(clearance=[0.1])
    both = Snapshot(
        **{f.name: np.concatenate([getattr(one, f.name), getattr(two, f.name)]) for f in fields(Snapshot)}
    )
    end = endings(both, PAPER.termination)
    terms = reward_terms(both, PAPER.reward, end.reached, end.stuck, end.flipped)
    np.testing.assert_array_equal(terms.sum(axis=1), [100.0, -0.5])


# -- the published code's --------------------------------------------------------------------------


def test_the_code_s_moving_toward_the_goal():
    now = moment(goal_distance=[4.96], speed=[0.8], angular_b=[[5.0, 5.0, -0.5]])
    assert earned(now, DUNE_CODE) == pytest.approx(
        {"distance": 1.5 * 0.3 * 0.04, "velocity": 0.0025 * 0.8 - 0.0015 * 0.5}
    )


@pytest.mark.parametrize(
    ("progress", "degrees", "expected"),
    [
        (0.04, 71.9, 0.012),
        (0.04, -72.1, -0.03),
        (-0.04, 71.9, -0.012),
        (-0.04, 80.0, -0.03),
        (0.0009, 0.0, -0.03),
        (-0.0009, 0.0, -0.03),
        (0.0011, 0.0, 0.00033),
    ],
)
def test_the_code_s_distance_term(progress, degrees, expected):
    now = moment(goal_distance=[5.0 - progress], goal_heading=[np.deg2rad(degrees)])
    assert earned(now, DUNE_CODE)["distance"] == pytest.approx(1.5 * expected)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"goal_distance": [0.499]}, {"goal": 100.0}),
        ({"clearance": [0.29]}, {"collision": -0.5}),
        ({"clearance": [0.29], "steps_since_moved": [600]}, {"collision": -0.5, "ending": -25.0}),
        ({"clearance": [0.29], "tilt": [2.0]}, {"collision": -0.5, "ending": -20.0}),
        ({"clearance": [0.29], "out_of_world": YES}, {"collision": -0.5, "ending": -10.0}),
    ],
)
def test_the_code_s_events(changes, expected):
    assert earned(moment(**changes), DUNE_CODE) == pytest.approx(expected)


def test_the_code_s_thresholds():
    conf = DUNE_CODE.termination
    assert (conf.goal_distance_m, conf.stuck_distance_m, conf.stuck_steps) == (0.5, 0.001, 600)
    assert np.rad2deg(conf.flipped_rad) == pytest.approx(85.0)
    assert "goal" not in earned(moment(goal_distance=[0.6]), DUNE_CODE)
    assert "heading" not in earned(moment(), DUNE_CODE)


# -- endings ---------------------------------------------------------------------------------------

CONF = PAPER.termination
REASONS = ("reached", "stuck", "flipped", "out_of_world", "timeout", "diverged")


def ended(now: Snapshot, conf: TerminationConf = CONF) -> set[str]:
    end = endings(now, conf)
    return {f.name for f in fields(end) if getattr(end, f.name)[0]}


def test_nothing_ends_in_the_open():
    assert ended(moment()) == set()


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"goal_distance": [0.749]}, "reached"),
        ({"steps_since_moved": [300]}, "stuck"),
        ({"roll_pitch_yaw": [[np.deg2rad(86), 0, 0]]}, "flipped"),
        ({"roll_pitch_yaw": [[0, np.deg2rad(-86), 0]]}, "flipped"),
        ({"out_of_world": YES}, "out_of_world"),
    ],
)
def test_what_terminates(changes, reason):
    assert ended(moment(**changes)) == {reason, "terminated"}


@pytest.mark.parametrize(
    "changes",
    [
        {"goal_distance": [0.75]},
        {"steps_since_moved": [299]},
        {"roll_pitch_yaw": [[np.deg2rad(84), np.deg2rad(-84), 3.1]]},
        {"steps": [1999]},
        {"touching": YES, "clearance": [0.0], "new_collisions": [1]},
    ],
)
def test_what_goes_on(changes):
    assert ended(moment(**changes)) == set()


@pytest.mark.parametrize("attitude", [[0.0, 0.0, 0.0], [np.pi, 0.0, 0.0], [0.0, 0.0, np.pi]])
def test_upside_down_is_flipped_however_it_is_told(attitude):
    # Turned over by pitch and by roll, or by neither as some conventions have it: the tilt is half a turn.
    assert "flipped" in ended(moment(tilt=[np.pi], roll_pitch_yaw=[attitude]))


def test_time_truncates_and_does_not_terminate():
    assert ended(moment(steps=[2000])) == {"timeout", "truncated"}


def test_a_goal_in_the_last_step_is_a_goal():
    assert ended(moment(steps=[2000], goal_distance=[0.1])) == {"reached", "terminated"}


def test_diverged_physics_truncates_whatever_else_seems_so():
    now = moment(
        diverged=YES, goal_distance=[0.1], tilt=[3.0], out_of_world=YES, steps=[2000], steps_since_moved=[999]
    )
    assert ended(now) == {"diverged", "truncated"}
    assert earned(replace(now, out_of_world=NO)).keys() <= {"distance", "heading", "velocity"}


def test_an_option_goes_on_after_a_goal():
    on = TerminationConf(continue_after_goal=True)
    assert ended(moment(goal_distance=[0.1]), on) == {"reached"}
    assert ended(moment(goal_distance=[0.1], steps=[2000]), on) == {"reached", "timeout", "truncated"}


@pytest.mark.parametrize("fault", [{"goal_distance_m": 0.0}, {"max_steps": 0}, {"flipped_rad": 4.0}])
def test_thresholds_that_cannot_be_are_refused(fault):
    with pytest.raises(ValidationError):
        TerminationConf(**fault)


# -- walking ---------------------------------------------------------------------------------------


def test_a_walker_senses_in_its_own_frame():
    # At (1, 2), heading along y; the way point is 3 m ahead, the rover 4 m to the right and coming closer.
    seen = walker_observation(
        poses=np.array([[[1.0, 2.0, 0.5, np.pi / 2]]]),
        velocity_w=np.array([[[0.0, 1.2]]]),
        goals_w=np.array([[[1.0, 5.0]]]),
        rover_position_w=np.array([[5.0, 2.0, 0.7]]),
        rover_velocity_w=np.array([[-0.8, 0.2, 9.0]]),
        limit_m=50.0,
    )
    np.testing.assert_allclose(seen["goal"][0, 0], [3.0, 0.0], atol=1e-6)
    # To the walker's left is -x of the world: the rover comes from the right at 0.8 m/s and falls back at 1.
    np.testing.assert_allclose(seen["rover"][0, 0], [4.0, -np.pi / 2, -1.0, 0.8], atol=1e-6)
    np.testing.assert_allclose(seen["velocity"][0, 0], [1.2, 0.0], atol=1e-6)
    assert {values.dtype for values in seen.values()} == {np.dtype(np.float32)}


def test_a_walker_s_distances_are_limited():
    seen = walker_observation(
        np.zeros((2, 3, 4)),
        np.zeros((2, 3, 2)),
        np.full((2, 3, 2), 30.0),
        np.array([[100.0, 0, 0], [1.0, 0, 0]]),
        np.zeros((2, 3)),
        limit_m=20.0,
    )
    assert {name: values.shape for name, values in seen.items()} == {
        "goal": (2, 3, 2),
        "rover": (2, 3, 4),
        "velocity": (2, 3, 2),
    }
    np.testing.assert_allclose(seen["goal"][..., 0], 20.0)
    np.testing.assert_allclose(seen["rover"][:, 0, 0], [20.0, 1.0])


@pytest.mark.parametrize(
    ("apart", "cost"), [(2.0, 0.0), (1.2, 0.0), (0.6, -0.05), (0.0, -0.1), (0.3, -0.075)]
)
def test_a_walker_is_rewarded_for_progress_and_for_room(apart, cost):
    got = walker_reward(np.array([[0.05]]), np.array([[apart]]), WalkingConf())
    assert got == pytest.approx(0.05 + cost)
    assert walker_reward(
        np.array([[-0.05]]), np.array([[apart]]), WalkingConf(progress_scale=2.0)
    ) == pytest.approx(-0.1 + cost)


@pytest.mark.parametrize("control_hz", [4, 20, 50])
def test_a_walker_s_progress_is_rewarded_at_any_control_rate(control_hz):
    walker = ActorConf(controller="external", waypoints=((-8.0, 8.0), (8.0, 8.0)), start_distance_m=0.0)
    conf = EnvConf(world=FlatConf(), actors=(walker,), physics=PhysicsConf(control_hz=control_hz))
    batch = make_batch(conf, 1, seed=0)
    batch.reset()
    batch.actors.poses[0, 0] = -6.0, 8.0, 0.0, 0.0
    for _ in range(3):
        outcome = batch.step(np.zeros((1, 2), np.float32), np.array([[[1.0, 0.0]]], np.float32))
        assert outcome.walker_reward[0, 0] == pytest.approx(1.0 / control_hz, abs=1e-3)
    batch.close()
