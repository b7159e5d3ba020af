"""The state of a step cannot be written by the parts that read it."""

from collections.abc import Iterator, Mapping
from dataclasses import FrozenInstanceError, replace
from typing import Any

import numpy as np
import pytest
from simulations import act, started_simulation
from user_packages import registries_restored

import dune_rl
from dune_rl.core.errors import RegistryError
from dune_rl.state import ContactState, GroupState, State


@pytest.fixture(autouse=True)
def _users_terms_go() -> Iterator[None]:
    with registries_restored():
        yield


def pulls_walkers(state: State, group: GroupState) -> np.ndarray:
    """A planted term that brings the walkers to the robot."""
    state.groups["walker"].motion.position_w[:, :2] = 0.0
    return np.zeros(len(group.done))


@pytest.mark.parametrize(
    ("kind", "path"),
    [
        ("reward", ("task", "rewards")),
        ("termination", ("task", "terminations")),
        ("metric", ("metrics", "terms")),
    ],
)
def test_a_term_that_writes_into_the_state_is_named(kind: str, path: tuple[str, str]) -> None:
    getattr(dune_rl, f"register_{kind}")(pulls_walkers)
    part, terms = path
    term = {part: {terms: {"near": {"term": "pulls_walkers"}}}}
    simulation = started_simulation(actors="walkers", **term)
    before = simulation.state.groups["walker"].motion.position_w.copy()
    with pytest.raises(RegistryError, match=f"the {kind} term 'near' writes into an array of the state"):
        act(simulation)
    after = simulation.group("walker").body.motion.position_w
    assert np.abs(after - before).max() < 0.5
    simulation.close()


def test_a_term_that_sets_a_field_of_the_state_is_named() -> None:
    @dune_rl.register_reward
    def forgets(state: State, group: GroupState) -> np.ndarray:
        group.motion = None  # type: ignore[misc, assignment]
        return np.zeros(len(group.done))

    simulation = started_simulation(task={"rewards": {"forgets": {}}})
    with pytest.raises(RegistryError, match="the reward term 'forgets' changes the state, which cannot be"):
        act(simulation)
    simulation.close()


def arrays_of(value: Any, seen: set[int]) -> Iterator[np.ndarray]:
    """All arrays that are reached from `value` through the parts of a state."""
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, Mapping) or type(value).__module__.startswith("dune_rl.state"):
        if id(value) in seen:
            return
        seen.add(id(value))
        for each in value.values() if isinstance(value, Mapping) else vars(value).values():
            yield from arrays_of(each, seen)


@pytest.mark.parametrize("settings", [{"actors": "walkers"}, {"scenario": "farm"}])
def test_no_array_of_a_state_can_be_written(settings: dict[str, str]) -> None:
    simulation = started_simulation(num_scenes=2, **settings)
    for _ in range(3):
        act(simulation)
        state = simulation.state
        for group in state.groups.values():
            for name in ("clearance", "neighbours"):
                getattr(group, name)
            for name in ("rotation", "velocity_b", "angular_b", "acceleration_b", "frames", "tilt", "yaw"):
                getattr(group.motion, name)
        assert state.surroundings.obstacles("rover")
        found = list(arrays_of(state, set()))
        assert len(found) > 30
        assert not any(array.flags.writeable for array in found)
    simulation.close()


def test_a_state_keeps_its_joints_when_a_scene_is_reset() -> None:
    simulation = started_simulation(num_scenes=2, sensors={"encoders": {}})
    for _ in range(5):
        act(simulation, 0.5)
    joints = simulation.state.groups["rover"].motion.joints
    assert joints is not None
    before = joints.angle.copy()
    simulation.reset(np.array([True, False]))
    np.testing.assert_array_equal(joints.angle, before)
    simulation.close()


def test_fields_of_a_motion_and_of_a_state_cannot_be_set() -> None:
    simulation = started_simulation()
    state = simulation.state
    motion = state.groups["rover"].motion
    with pytest.raises(FrozenInstanceError):
        motion.position_w = motion.position_w + 1.0
    with pytest.raises(TypeError):
        state.groups["rover"] = state.groups["rover"]  # type: ignore[index]
    with pytest.raises(TypeError):
        state.groups["rover"].contacts.new_by_kind["person"] = np.ones(1, np.int64)  # type: ignore[index]
    simulation.close()


def test_a_reset_of_one_scene_leaves_contacts_and_endings_of_the_others() -> None:
    simulation = started_simulation(num_scenes=2, task={"terminations": {"time_limit": {"max_steps": 1}}})
    act(simulation)
    state = simulation.state
    rover = state.groups["rover"]
    assert rover.endings["time_limit"].tolist() == [True, True]
    both = np.array([True, True])
    contacts = ContactState(both, both.astype(int), both.astype(int), {"static": both.astype(int)})
    simulation.state = replace(state, groups={**state.groups, "rover": replace(rover, contacts=contacts)})
    simulation.reset(np.array([True, False]))
    after = simulation.state.groups["rover"]
    assert after.contacts.touching.tolist() == [False, True]
    assert after.contacts.new.tolist() == after.contacts.new_by_kind["static"].tolist() == [0, 1]
    assert after.endings["time_limit"].tolist() == [False, True]
    simulation.close()
