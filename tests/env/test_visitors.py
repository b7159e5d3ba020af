"""Visitors without paths: where they come, what is left of earlier episodes, and episodes that they end."""

from typing import Any

import numpy as np
import pytest
from conformance import difference
from simulations import act, every_engine, motion_of_group, new_simulation, started_simulation, state_of_group
from tensordict import TensorDictBase
from torchrl.envs import TransformedEnv
from visits import visited, visitors

import dune_rl
from dune_rl.core.errors import WorldError
from dune_rl.env.simulation import VectorSimulation
from dune_rl.env.torchrl import EpisodeMetrics
from dune_rl.evaluation.recorder import EpisodeRecorder
from dune_rl.learning.evaluation import evaluate
from dune_rl.reporting.views.tracks import TrackRecorder

REWARDS = (
    "distance",
    "heading",
    "velocity",
    "goal",
    "collision",
    "contact",
    "stuck",
    "flipped",
    "out_of_world",
)
ENDS = ("goal_reached", "stuck", "flipped", "out_of_world", "time_limit")


def guests(body: str, count: int, controller: Any = "random_waypoint", **presence: Any) -> dict[str, Any]:
    """Settings of a rover among visitors."""
    group = {"body": body, "count": count, "controller": controller, "presence": presence}
    return {"agents": {"rover": {"body": "rover_zero"}, "guest": group}}


def record(simulation: VectorSimulation, steps: int) -> list[Any]:
    """The states of the visitors after each of `steps` steps."""
    found = []
    for _ in range(steps):
        act(simulation, [0.3, 0.0])
        state = state_of_group(simulation, "guest")
        found.append((state.motion.position_w.copy(), state.goal.position_w.copy(), state.absent))
    return found


@pytest.mark.slow(all_but=["sheep", "cow"])
@pytest.mark.parametrize("body", ["sheep", "cow", "car"])
def test_those_who_come_together_stand_beside_each_other(body: str) -> None:
    settings = guests(body, 6, arrive_s=[0.2, 0.2])
    settings["agents"]["guest"]["task"] = {"spawn": {"region": "anywhere" if body == "car" else "world"}}
    simulation = started_simulation(num_scenes=2, **settings)
    for _ in range(4):
        act(simulation)
    state = state_of_group(simulation, "guest")
    assert not state.absent.any()
    assert (state.clearance > 0.05).all()
    simulation.close()


@pytest.mark.slow
@pytest.mark.parametrize("controller", ["go_to_goal", "random_waypoint", "herd"])
def test_an_episode_does_not_depend_on_the_one_before(controller: str) -> None:
    body = "sheep" if controller == "herd" else "dog"
    settings = guests(body, 3, controller, arrive_s=[0.5, 2.0], stay_s=[1.0, 4.0])
    second, fresh = (new_simulation(seed=4, **settings) for _ in range(2))
    second.reset()
    record(second, 30)
    second.reset()
    fresh.reseed(4, 1)
    fresh.reset()
    assert difference(record(second, 60), record(fresh, 60)) is None
    second.close()
    fresh.close()


@pytest.mark.slow
@every_engine
def test_a_second_episode_is_restored_and_equal_beside_other_scenes(engine: str) -> None:
    settings = guests("dog", 3, arrive_s=[0.0, 1.0], stay_s=[0.5, 1.0]) | {"physics": {"backend": engine}}
    one, other, alone = (new_simulation(num_scenes=scenes, seed=3, **settings) for scenes in (2, 2, 1))
    one.reset()
    record(one, 12)
    one.reset()
    first = record(one, 10)
    other.restore(one.save_state())
    assert difference(record(one, 8), record(other, 8)) is None
    alone.reseed(3, 2)
    alone.reset()
    mine = record(alone, 10)
    assert difference([[part[:3] for part in step] for step in first], [list(step) for step in mine]) is None
    for each in (one, other, alone):
        each.close()


def test_drones_come_and_go() -> None:
    settings = guests("drone", 2, "go_to_goal", arrive_s=[0.2, 0.6], stay_s=[1.0, 1.0])
    simulation = started_simulation(**settings)
    there = [~state[2] for state in record(simulation, 40)]
    assert np.any(there, axis=0).all()
    assert not there[-1].any()
    simulation.close()


def test_a_guide_who_comes_later_is_followed() -> None:
    agents = {
        "rover": {"body": "rover_zero"},
        "guide": {"body": "person", "controller": "path", "presence": {"arrive_s": [1.0, 1.0]}},
        "tail": {"body": "person", "controller": {"name": "follow", "target": "guide"}},
    }
    simulation = started_simulation(agents=agents)
    start = motion_of_group(simulation, "tail").position_w.copy()
    for _ in range(160):
        act(simulation)
    moved = np.hypot(*(motion_of_group(simulation, "tail").position_w - start)[0, :2])
    assert moved > 1.0
    simulation.close()


def test_those_who_may_end_an_episode_are_waited_for() -> None:
    limit = {"rewards": {}, "terminations": {"time_limit": {"max_steps": 5}}}
    agents = {
        "rover": {
            "body": "rover_zero",
            "task": {"rewards": dict.fromkeys(REWARDS), "terminations": dict.fromkeys(ENDS)},
        },
        "stranger": {
            "body": "dog",
            "controller": "external",
            "task": limit,
            "presence": {"arrive_s": [0.5, 0.5]},
        },
    }
    simulation = started_simulation(agents=agents)
    over = [bool(act(simulation).done[0]) for _ in range(15)]
    assert over.index(True) == 10 + 5 - 1
    simulation.close()


def test_too_many_who_are_there_at_the_start_are_told_at_once() -> None:
    settings = guests("cow", 60, stay_s=[5.0, 9.0])
    settings["agents"]["guest"]["task"] = {"spawn": {"region": [-6.0, 6.0, -6.0, 6.0]}}
    with pytest.raises(WorldError, match=r"agents\.guest\.count"):
        dune_rl.make("flat", 1, **settings)


def test_states_that_were_handed_out_keep_their_goals() -> None:
    simulation = started_simulation(**guests("dog", 2, "go_to_goal", arrive_s=[0.1, 0.3], stay_s=[0.2, 0.3]))
    kept = []
    for _ in range(14):
        goals = state_of_group(simulation, "guest").goal.position_w
        kept.append((goals, goals.copy()))
        act(simulation)
    assert all((goals == copied).all() for goals, copied in kept)
    simulation.close()


@pytest.mark.slow
def test_pictures_are_of_somebody_who_is_there() -> None:
    agents = {
        "guest": {"body": "dog", "controller": "external", "presence": {"arrive_s": [5.0, 5.0]}},
        "rover": {"body": "rover_zero"},
    }
    env = dune_rl.parallel_env("flat", agents=agents, render_mode="rgb_array")
    env.reset(seed=1)
    assert env.agents == ["rover_0"]
    alone = dune_rl.parallel_env("flat", agents={"rover": agents["rover"]}, render_mode="rgb_array")
    alone.reset(seed=1)
    np.testing.assert_array_equal(env.render(), alone.render())
    env.close()
    alone.close()


# -- records -----------------------------------------------------------------------------------------


def test_tracks_are_of_the_time_in_the_scene() -> None:
    presence = {"arrive_s": [0.2, 0.2], "stay_s": [0.3, 0.3]}
    simulation = started_simulation(**visited(presence))
    recorder = TrackRecorder(simulation)
    for _ in range(12):
        act(simulation, guest=[1.0, 0.0])
        recorder.update()
    tracks = {track.agent: track for track in recorder.tracks(0)}
    xmin, xmax, ymin, ymax = simulation.worlds.extents[0]
    for name in ("guest_0", "guest_1"):
        x, y = tracks[name].points.T
        # From the step in which it comes to its last one.
        assert len(x) == 7
        assert x.min() > xmin and x.max() < xmax and y.min() > ymin and y.max() < ymax
        assert tracks[name].ending == "cut short"
    assert len(tracks["rover_0"].points) == 13
    simulation.close()


@pytest.mark.slow
def test_evaluations_have_rows_of_those_who_came() -> None:
    presence = {"arrive_s": [0.2, 0.2], "stay_s": [0.3, 0.3]}
    later = {
        "guest": visitors("person", 2, **presence),
        "stranger": visitors("dog", 1, arrive_s=[0.7, 6000.0]),
    }
    task = {"rewards": {}, "terminations": {"time_limit": {"max_steps": 16}}}
    for group in later.values():
        group["task"] = task
    env = TransformedEnv(dune_rl.make("flat", 2, actors=later, task=task), EpisodeMetrics())
    recorder = EpisodeRecorder(env.base_env.simulation, steps=True)

    def act_at_random(data: TensorDictBase) -> TensorDictBase:
        return data.update(env.full_action_spec.rand())

    rows = evaluate(act_at_random, env, 3, 1, observer=recorder)
    assert len(rows["guest"]) == 6
    assert rows.get("stranger", []) == []
    for row in rows["guest"]:
        assert row["steps"] == 6.0
        assert abs(row["start_x_m"]) < 100.0
    times = [step["time_s"] for step in recorder.take_steps() if step["agent"] == "guest_0"]
    assert min(times) == pytest.approx(0.25)
    assert max(times) == pytest.approx(0.5)
    env.close()
