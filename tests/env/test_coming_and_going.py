"""Agents that come and go: what they, their neighbours, physics and metrics make of it."""

from functools import partial
from typing import Any

import numpy as np
import pytest
import torch
from conformance import (
    check_kept,
    check_no_leak,
    check_parallel_api,
    check_seeding,
    check_spaces,
    check_torchrl,
    check_values,
    difference,
)
from pettingzoo import ParallelEnv
from simulations import (
    act,
    every_engine,
    metric,
    motion_of_group,
    new_simulation,
    rest,
    started_simulation,
    state_of_group,
)
from visits import visited, visitors

import dune_rl
from dune_rl.core.errors import ConfigError
from dune_rl.env.simulation import VectorSimulation

LIMIT = 24
SHORT = {"terminations": {"time_limit": {"max_steps": LIMIT}}}
ONE = {
    "agents": {
        "person": visitors("person", 1, arrive_s=[0.0, 0.0], stay_s=[0.2, 0.4]),
        "rover": {"body": "rover_zero", "controller": "go_to_goal"},
    }
}
THREE = {"actors": {"person": visitors("person", 1), "drone": visitors("drone", 1)}}
TWENTY = {
    "actors": {
        "person": visitors("person", 7),
        "sheep": visitors("sheep", 6),
        "drone": visitors("drone", 6),
    }
}


@pytest.fixture(scope="module", params=[ONE, THREE, TWENTY], ids=["1 agent", "3 agents", "20 agents"])
def settings(request: pytest.FixtureRequest) -> dict[str, Any]:
    return request.param


def make(settings: dict[str, Any]) -> ParallelEnv:
    return dune_rl.parallel_env("flat", task=SHORT, **settings)


# -- the interfaces ----------------------------------------------------------------------------------


@pytest.mark.slow(all_but=["3 agents-*"])
@pytest.mark.parametrize("check", [check_parallel_api, check_values, check_kept, check_spaces])
def test_parallel_env(check: Any, settings: dict[str, Any]) -> None:
    env = make(settings)
    check(env)
    env.close()


@pytest.mark.slow(all_but=["3 agents-check_seeding"])
@pytest.mark.parametrize("check", [check_seeding, check_no_leak])
def test_parallel_env_over_resets(check: Any, settings: dict[str, Any]) -> None:
    check(partial(make, settings))


@pytest.mark.slow(all_but=["3 agents"])
def test_torchrl_env(settings: dict[str, Any]) -> None:
    env = dune_rl.make("flat", 2, task=SHORT, **settings)
    check_torchrl(env)
    env.close()


def test_agents_are_listed_while_they_are_there() -> None:
    env = make(TWENTY)
    env.reset(seed=2)
    assert "rover_0" in env.agents
    assert len(env.agents) < 20
    seen, gone = set(env.agents), set()
    for _ in range(LIMIT):
        before = env.agents
        results = env.step({agent: np.zeros_like(env.action_space(agent).low) for agent in env.agents})
        told = set(before) | set(env.agents)
        assert all(set(result) == told for result in results)
        _, _, terminated, truncated, _ = results
        ended = {agent for agent in told if terminated[agent] or truncated[agent]}
        assert ended == set(before) - set(env.agents)
        assert not gone & told
        gone |= ended
        seen |= told
    assert seen == gone == set(env.possible_agents)
    env.close()


def test_flags_of_torchrl_cover_the_time_before_and_after_a_visit() -> None:
    presence = {"arrive_s": [0.2, 0.2], "stay_s": [0.3, 0.3]}
    env = dune_rl.make("flat", 2, actors={"person": visitors("person", 2, **presence)}, task=SHORT)
    data = env.rollout(12)
    first = data[:, 0]["person", "done"]
    later = data["next", "person", "done"].squeeze(-1)
    assert first.all()
    # Control steps are 0.05 s long: they come in step 4 and leave in step 10.
    expected = torch.ones(12, dtype=torch.bool)
    expected[3:9] = False
    assert (later == expected[None, :, None]).all()
    assert not data["next", "rover", "done"].any()
    env.close()


# -- the simulation ----------------------------------------------------------------------------------


def steps_there(simulation: VectorSimulation, steps: int, group: str = "guest") -> Any:
    """Which agents of a group were there after each of `steps` steps, (steps + 1, N)."""
    there = [~state_of_group(simulation, group).absent]
    for _ in range(steps):
        act(simulation)
        there.append(~state_of_group(simulation, group).absent)
    return np.array(there)


def test_visits_are_of_the_drawn_times() -> None:
    presence = {"arrive_s": [0.2, 1.0], "stay_s": [0.5, 1.0]}
    simulation = started_simulation(num_scenes=3, **visited(presence, count=4))
    there = steps_there(simulation, 45)
    arrival, stay = there.argmax(axis=0), there.sum(axis=0)
    assert ((arrival >= 4) & (arrival <= 20)).all()
    assert len(set(arrival.tolist())) > 4
    # In the step after the last one of their stay they are gone.
    assert ((stay >= 10 + 1) & (stay <= 20 + 1)).all()
    assert not there[-1].any()
    simulation.close()


def test_a_member_more_changes_no_visits_of_the_others() -> None:
    presence = {"arrive_s": [0.0, 1.0], "stay_s": [0.3, 1.0]}
    few, many = (started_simulation(**visited(presence, count=count)) for count in (2, 3))
    assert (steps_there(few, 30) == steps_there(many, 30)[:, :2]).all()


@every_engine
def test_guests_come_at_rest_where_there_is_room_and_act_from_the_next_step_on(engine: str) -> None:
    presence = {"arrive_s": [0.2, 0.2]}
    simulation = started_simulation(physics={"backend": engine}, **visited(presence))
    for _ in range(3):
        act(simulation)
    before = motion_of_group(simulation, "guest")
    assert (np.abs(before.position_w[:, :2]) > 1e4).all()
    act(simulation)
    come = motion_of_group(simulation, "guest")
    xmin, xmax, ymin, ymax = simulation.worlds.extents[0]
    assert ((come.position_w[:, 0] > xmin) & (come.position_w[:, 0] < xmax)).all()
    assert ((come.position_w[:, 1] > ymin) & (come.position_w[:, 1] < ymax)).all()
    assert not come.velocity_w.any()
    state = state_of_group(simulation, "guest")
    assert (state.clearance > 0.0).all()
    assert not state.done.any()
    assert not state.episode.steps.any()
    act(simulation, guest=[1.0, 0.0])
    now = motion_of_group(simulation, "guest")
    moved = np.hypot(*(now.position_w - come.position_w)[:, :2].T)
    assert np.allclose(moved, 0.05, atol=0.01)
    assert (state_of_group(simulation, "guest").episode.steps == 1).all()
    simulation.close()


@every_engine
def test_nobody_feels_it_when_guests_come_and_go(engine: str) -> None:
    presence = {"arrive_s": [0.1, 0.5], "stay_s": [0.2, 0.5]}
    alone = started_simulation(physics={"backend": engine})
    settings = visited(presence, count=6) | {"physics": {"backend": engine}}
    simulation = started_simulation(**settings)
    for _ in range(30):
        act(alone, [0.4, 0.1])
        act(simulation, rover=[0.4, 0.1])
        contacts = state_of_group(simulation, "rover").contacts
        assert not contacts.touching.any()
    # Guests may come to stand near the rover, but not in its way within half a second.
    ours, theirs = (motion_of_group(each, "rover").position_w for each in (simulation, alone))
    assert np.allclose(ours, theirs, atol=1e-3)
    simulation.close()
    alone.close()


def test_sensors_list_only_who_is_there() -> None:
    sensors = {
        "enabled": ["goal", "list", "nearest"],
        "list": {"sensor": "neighbours", "number": 2, "range_m": 1000.0, "groups": ["guest"]},
        "nearest": {"sensor": "nearest_agent", "groups": ["guest"]},
    }
    presence = {"arrive_s": [0.1, 0.1], "stay_s": [0.2, 0.2]}
    simulation = started_simulation(sensors=sensors, **visited(presence))
    listed = []
    for _ in range(8):
        reading = simulation.observe("rover")
        listed.append(int(reading["list"].reshape(2, 7)[:, 0].sum()))
        nothing = listed[-1] == 0
        assert (reading["nearest"][0, 0, 1:] == 0.0).all() == nothing
        act(simulation)
    assert listed == [0, 0, 2, 2, 2, 2, 2, 0]
    simulation.close()


def test_metrics_of_a_guest_begin_when_it_comes() -> None:
    presence = {"arrive_s": [0.2, 0.2], "stay_s": [0.3, 0.3]}
    simulation = started_simulation(**visited(presence, task={"rewards": {}}))
    for step in range(1, 13):
        act(simulation)
        values = metric(simulation, "steps", "guest")
        assert np.isnan(values).all() if step < 4 else (values == min(step - 4, 6)).all()
    simulation.close()


def test_a_guest_that_never_comes_has_no_metrics() -> None:
    presence = {"arrive_s": [0.0, 100.0]}
    simulation = started_simulation(**visited(presence, count=5, task={"rewards": {}}))
    act(simulation)
    values = simulation.metrics("guest")[0]
    assert np.isnan(values).all()
    simulation.close()


def test_an_episode_is_over_when_all_external_agents_have_left() -> None:
    agents = {
        "guest": visitors("person", 2, arrive_s=[0.0, 0.0], stay_s=[0.2, 0.4]),
        "rover": {"body": "rover_zero", "controller": "go_to_goal"},
    }
    simulation = started_simulation(agents=agents)
    over = []
    for _ in range(8):
        result = act(simulation)
        assert result.truncated[0] == result.groups["guest"].truncated.all()
        over.append(bool(result.done[0]))
        if over[-1]:
            break
    assert 4 <= len(over) <= 8
    assert over[-1]
    simulation.close()


@pytest.mark.slow(all_but=["orca-person", "path-person"])
@pytest.mark.parametrize(
    ("controller", "body"),
    [
        ("path", "person"),
        ("random_waypoint", "cow"),
        ("herd", "sheep"),
        ("orca", "person"),
        ("go_to_goal", "car"),
    ],
)
def test_scripted_visitors_move_only_while_they_are_there(controller: str, body: str) -> None:
    presence = {"arrive_s": [0.0, 1.0], "stay_s": [2.0, 3.0]}
    group = {"body": body, "count": 3, "controller": controller, "presence": presence}
    simulation = started_simulation(num_scenes=2, seed=5, actors={"guest": group})
    moved = np.zeros(6)
    for _ in range(90):
        state = state_of_group(simulation, "guest")
        act(simulation)
        after = state_of_group(simulation, "guest")
        speed = np.hypot(*after.motion.velocity_w[:, :2].T)
        assert not speed[after.absent].any()
        assert (speed < 6.0).all(), "no jump counts as motion"
        stays = ~after.absent & ~state.absent
        moved[stays] += 0.05 * speed[stays]
    assert state_of_group(simulation, "guest").absent.all()
    assert np.median(moved) > 0.2
    simulation.close()


def test_followers_of_a_leader_that_leaves_stand_still() -> None:
    actors = {
        "guide": {"body": "person", "controller": "path", "presence": {"stay_s": [1.0, 1.0]}},
        "group": {"body": "person", "count": 2, "controller": {"name": "follow", "target": "guide"}},
    }
    simulation = started_simulation(actors=actors)
    for _ in range(60):
        act(simulation)
    velocity = motion_of_group(simulation, "group").velocity_w
    assert np.abs(velocity).max() < 1e-6
    simulation.close()


def test_a_saved_state_is_restored_with_its_visitors() -> None:
    settings = visited({"arrive_s": [0.0, 1.0], "stay_s": [0.3, 1.0]}, count=5)
    one, other = (new_simulation(num_scenes=2, seed=3, **settings) for _ in range(2))
    one.reset()
    for _ in range(12):
        act(one, guest=[0.5, 0.2])
    other.restore(one.save_state())
    for _ in range(6):
        first, second = act(one, guest=[0.5, 0.2]), act(other, guest=[0.5, 0.2])
        assert difference(vars(first.groups["guest"]), vars(second.groups["guest"])) is None
    assert difference(one.observe("guest"), other.observe("guest")) is None
    assert set(rest(one)) == {"guest", "rover"}


# -- wrong settings ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"actors": {"dog": visitors("dog", 1, arrive_s=[3.0, 1.0])}}, "actors.dog.presence.*arrive_s"),
        ({"actors": {"dog": visitors("dog", 1, stay_s=[0.0, 1.0])}}, "actors.dog.presence.*stay_s"),
        (
            {"agents": {"rover": {"body": "rover_zero", "presence": {"stay_s": [1.0, 2.0]}}}},
            "agents.rover.*a rover_zero stays: leave it out",
        ),
        (
            {
                "agents": {
                    "guest": visitors("person", 1, arrive_s=[1.0, 2.0]),
                    "rover": {"body": "rover_zero", "controller": "go_to_goal"},
                }
            },
            r"agents.guest.presence.arrive_s: no external agent is there when an episode starts",
        ),
    ],
)
def test_wrong_presence_is_named(settings: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        dune_rl.make("flat", 1, **settings)
