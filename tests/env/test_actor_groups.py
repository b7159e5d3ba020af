"""Groups of vehicles, animals and drones in a simulation: where they start and go, and what is counted."""

import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from simulations import environment_conf, new_simulation, started_simulation
from user_packages import registries_restored

import dune_rl
from dune_rl.config.compose import compose_environment
from dune_rl.core.errors import ConfigError, WorldError
from dune_rl.env.simulation import VectorSimulation

ANYWHERE = {"task": {"spawn": {"region": "anywhere"}}}


def rest(core: VectorSimulation) -> dict[str, np.ndarray]:
    return {
        group.name: np.zeros((core.num_scenes, group.count, group.action_size), np.float32)
        for group in core.external
    }


def driving(body: Any, count: int = 1, **more: Any) -> dict[str, Any]:
    return {"body": body, "count": count, "controller": {"name": "go_to_goal", "speed_mps": 3.0}, **more}


@pytest.mark.slow
def test_actors_start_apart_from_robots_and_from_each_other() -> None:
    actors = {
        "herd": driving("cow", 4),
        "cars": driving("car", 2, **ANYWHERE),
        "walker": {"body": "person", "count": 2},
    }
    core = new_simulation("flat", 3, actors=actors, robots=["rover_zero", "leo_rover"], sensors=["goal"])
    core.reset()
    for scene in range(3):
        places, reaches = [], []
        for group in core.groups:
            rows = slice(scene * group.count, (scene + 1) * group.count)
            places.append(core.state.groups[group.name].motion.position_w[rows, :2])
            reach = 0.25 if group.name == "walker" else group.starts.footprint_radius_m
            reaches += [reach] * group.count
        xy = np.concatenate(places)
        apart = np.linalg.norm(xy[:, None] - xy, axis=-1) + 100.0 * np.eye(len(xy))
        needed = np.add.outer(reaches, reaches)
        roaming = np.array([name not in ("walker",) for name in _owners(core)])
        assert (apart >= needed)[np.ix_(roaming, roaming)].all()
        assert apart.min() > 0.4
    core.close()


def _owners(core: VectorSimulation) -> list[str]:
    return [group.name for group in core.groups for _ in range(group.count)]


@pytest.mark.slow
def test_actors_do_not_move_the_robots_starts() -> None:
    starts = []
    for actors in ({}, {"herd": driving("sheep", 3)}):
        core = started_simulation("flat", 2, seed=5, actors=actors, sensors=["goal"])
        rover = core.state.groups["rover"]
        starts.append(np.column_stack([rover.motion.position_w[:, :2], rover.goal.position_w]))
        core.close()
    np.testing.assert_array_equal(starts[0], starts[1])


@pytest.mark.slow
def test_the_seed_decides() -> None:
    runs = []
    for seed in (2, 2, 3):
        core = started_simulation("flat", 2, seed=seed, actors={"dogs": driving("dog", 2)}, sensors=["goal"])
        for _ in range(100):
            core.step(rest(core))
        dogs = core.state.groups["dogs"]
        runs.append(np.column_stack([dogs.motion.position_w, dogs.goal.position_w, dogs.motion.frames]))
        core.close()
    np.testing.assert_array_equal(runs[0], runs[1])
    assert (runs[0] != runs[2]).any()


@pytest.mark.slow(all_but=["drone"])
@pytest.mark.parametrize("body", ["car", "dog", "drone"])
def test_goal_follows_goal(body: str) -> None:
    core = started_simulation("flat", 1, seed=1, actors={"group": driving(body)}, sensors=["goal"])
    goals = [core.state.groups["group"].goal.position_w[0]]
    for _ in range(500):
        if core.step(rest(core)).done.any():
            core.reset()
            goals.append(core.state.groups["group"].goal.position_w[0])
        goal = core.state.groups["group"].goal.position_w[0]
        if (goal != goals[-1]).any():
            goals.append(goal)
    assert len(goals) >= 3
    core.close()


def test_more_actors_than_fit_is_said_before_anything_is_built() -> None:
    with pytest.raises(WorldError) as error:
        new_simulation("flat", 1, actors={"fleet": driving("truck", 30)}, sensors=["goal"])
    first, last = str(error.value).splitlines()
    assert re.fullmatch(
        r"fleet \(count 30\): agents\.fleet\.task\.spawn\.region \(-4, 4, -4, 4\) of the world 'flat' has "
        r"no room for another truck beside \d+ other agents: \d+ of its 64 m² suit it \(3\.\d\d m of "
        r"clearance, slopes up to 25 degrees, for its wheels or feet up to 18, water up to 0\.5 m\)\.",
        first,
    )
    assert last == (
        "Lower agents.fleet.count, widen agents.fleet.task.spawn.region, lower "
        "agents.fleet.task.spawn.robots_apart_m, or choose a smaller body."
    )


@pytest.mark.slow
def test_a_full_world_cannot_be_widened() -> None:
    everywhere = {"task": {"spawn": {"region": "anywhere", "robots_apart_m": 80.0}}}
    with pytest.raises(WorldError, match=r"Lower agents\.fleet\.count, take a larger world, lower"):
        new_simulation("flat", 1, actors={"fleet": driving("car", 9, **everywhere)}, sensors=["goal"])


@pytest.mark.slow
def test_who_leaves_no_room_is_placed_anew() -> None:
    # Where the first of the three stands in the middle there is no room for the others: half of all episodes.
    close = {"task": {"spawn": {"region": [-7.0, 7.0, -7.0, 7.0], "robots_apart_m": 3.5}}}
    core = started_simulation("flat", 8, actors={"fleet": driving("car", 3, **close)}, sensors=["goal"])
    for _ in range(4):
        core.reset()
        places = core.state.groups["fleet"].motion.position_w[:, :2].reshape(8, 3, 2)
        apart = np.linalg.norm(places[:, :, None] - places[:, None], axis=-1)[:, *np.triu_indices(3, 1)]
        assert apart.min() >= 3.5
    core.close()


def test_a_region_without_room_is_said() -> None:
    small = {"task": {"spawn": {"region": [-1.0, 1.0, -1.0, 1.0], "min_goal_distance_m": 3.0}}}
    with pytest.raises(WorldError, match=r"fleet \(truck\): agents\.fleet\.task\.spawn\.min_goal"):
        new_simulation("flat", 1, actors={"fleet": driving("truck", **small)}, sensors=["goal"])


@pytest.mark.parametrize(
    ("group", "said"),
    [
        ({"body": "car", "controller": "path"}, "a car cannot turn round on the spot at its ends"),
        ({"body": "drone", "controller": "path"}, "a drone cannot walk it; write controller: go_to_goal"),
        ({"body": "caw"}, "there is no body 'caw'; did you mean cow?"),
        ({"body": {"name": "cow", "speed_mps": -1.0}}, "body.speed_mps must be above 0"),
        ({"body": {"name": "cow", "wheelbase_m": 1.0}}, "body.wheelbase_m is not a setting"),
        ({"body": {"name": "drone", "altitude_m": 20.0}}, "altitude_m .20. must be from min_altitude_m"),
        ({"body": "rover_zero", "controller": "path"}, "paths are walked by persons"),
    ],
)
def test_what_a_body_cannot_do_is_said(group: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        compose_environment("flat", (), {"actors": {"group": group}})


@pytest.fixture
def _users_parts_go() -> Iterator[None]:
    with registries_restored():
        yield


@pytest.mark.usefixtures("_users_parts_go")
def test_a_behaviour_may_say_which_bodies_it_drives() -> None:
    @dune_rl.register_behaviour("test_swoop")
    class Swoop:
        """It dives."""

        motion_models = ("flying",)

        def __init__(self, num_rows: int) -> None:
            self.rows = num_rows

        def reset(self, mask: np.ndarray, group: Any) -> None:
            """Nothing."""

        def act(self, state: Any, group: Any) -> np.ndarray:
            """Down."""
            return np.tile([0.0, 0.0, -1.0], (self.rows, 1))

    with pytest.raises(
        ConfigError, match=r"agents.herd: .*test_swoop is for bodies that move as flying.*drone"
    ):
        environment_conf("flat", agents={"rover": {"body": "rover_zero"}, "herd": swooping("cow")})
    core = started_simulation("flat", 1, actors={"kite": swooping("drone")}, sensors=["goal"])
    for _ in range(60):
        core.step(rest(core))
    assert core.state.groups["kite"].motion.position_w[0, 2] == pytest.approx(0.5)
    core.close()


def swooping(body: str) -> dict[str, str]:
    return {"body": body, "controller": "test_swoop"}


@pytest.mark.slow
def test_collisions_are_counted_by_class() -> None:
    actors = {"herd": driving("cow"), "people": {"body": "person"}}
    core = new_simulation("flat", 1, actors=actors, sensors=["goal"], metrics="navigation")
    core.reset()
    kinds = ("static", "robot", "person", "vehicle", "animal", "drone")
    names = list(core.metric_names("rover"))
    columns = [names.index(f"collisions_{kind}") for kind in kinds]
    rover = core.group("rover")
    for kind, body in (("animal", "herd"), ("person", "people")):
        before = core.metrics("rover")[0, 0, columns]
        for _ in range(40):
            # Where the robot is.
            poses = core.group(body).body.poses.copy()
            core.group(body).body.place(0, np.column_stack([rover.body.motion.position_w, [0.0]])[:, :4])
            core.step(rest(core))
            if core.state.groups["rover"].contacts.new_by_kind:
                break
        assert list(core.state.groups["rover"].contacts.new_by_kind) == [kind]
        counted = core.metrics("rover")[0, 0, columns] - before
        np.testing.assert_array_equal(counted, [float(each == kind) for each in kinds])
        core.group(body).body.place(0, poses[:, :4])
    core.close()
