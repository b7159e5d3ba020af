"""Simulations in true physics, one control step of them, and what tests read of them."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from walker_groups import walker_groups

from dune_rl.config.build import make_simulation
from dune_rl.config.compose import compose_environment
from dune_rl.config.schema import EnvConf
from dune_rl.env.agent_group import GroupStep
from dune_rl.env.simulation import SimulationStep, VectorSimulation
from dune_rl.geometry.frames import wrap_angle
from dune_rl.physics.interface import OWN_ENGINES
from dune_rl.state import GroupState, Motion
from dune_rl.worlds.world import World

Array = NDArray[np.float64]

every_engine = pytest.mark.parametrize("engine", OWN_ENGINES)

_composed: dict[str, EnvConf] = {}


def environment_conf(world: Any = "flat", **settings: Any) -> EnvConf:
    """Settings of an environment; `settings` are as for `dune_rl.make`, but without actors by default.

    `actors` may be a list of walkers, as `walker_groups` has it.
    """
    asked = settings if "agents" in settings else {"actors": "none"} | settings
    if isinstance(asked.get("actors"), list) and not all(isinstance(each, str) for each in asked["actors"]):
        asked = asked | {"actors": walker_groups(asked["actors"])}
    key = repr((world, asked))
    if key not in _composed:
        # Hydra takes as long as all else that a short test does.
        _composed[key] = compose_environment(world, (), asked)
    return _composed[key]


def new_simulation(
    world: Any = "flat", num_scenes: int = 1, seed: int = 0, **settings: Any
) -> VectorSimulation:
    """A simulation of `environment_conf`, which is not reset."""
    return make_simulation(environment_conf(world, **settings), num_scenes, seed)


def started_simulation(
    world: Any = "flat", num_scenes: int = 1, seed: int = 0, **settings: Any
) -> VectorSimulation:
    """As `new_simulation`, at the start of its first episodes."""
    simulation = new_simulation(world, num_scenes, seed, **settings)
    simulation.reset()
    return simulation


def simulation_on(world: World, num_scenes: int = 1, seed: int = 0, **settings: Any) -> VectorSimulation:
    """As `new_simulation`, in a world that a test has built."""
    return make_simulation(environment_conf(**settings), num_scenes, seed, make_world=lambda _: world)


def act(
    simulation: VectorSimulation, first: ArrayLike | None = None, /, **actions: ArrayLike
) -> SimulationStep:
    """One control step: `first` are the actions of the first external group, others' are given by name.

    They are (M, G, A), rows (M * G, A), or one action (A,) for all; who has none gets zeros.
    """
    if first is not None:
        actions = {simulation.group().name: first, **actions}
    unknown = set(actions) - {group.name for group in simulation.external}
    assert not unknown, f"no external group is called {unknown}"
    full = {}
    for group in simulation.external:
        shape = (simulation.num_scenes, group.count, group.action_size)
        given = np.asarray(actions.get(group.name, 0.0), np.float32)
        full[group.name] = (
            given.reshape(shape) if given.size == np.prod(shape) else np.broadcast_to(given, shape).copy()
        )
    return simulation.step(full)


def outcome(step: SimulationStep) -> GroupStep:
    """What a step gives the agents of the first external group."""
    return next(iter(step.groups.values()))


def state_of_group(simulation: VectorSimulation, group: str | None = None) -> GroupState:
    """The present state of a group, the first external one without a name."""
    return simulation.state.groups[simulation.group(group).name]


def motion_of_group(simulation: VectorSimulation, group: str | None = None) -> Motion:
    """The present motion of a group, the first external one without a name."""
    return state_of_group(simulation, group).motion


def observation(simulation: VectorSimulation, group: str | None = None) -> dict[str, NDArray[Any]]:
    """The observation of a group, each part in rows (N, ...)."""
    return simulation.group(group).observe()


def metric(simulation: VectorSimulation, name: str, group: str | None = None) -> NDArray[np.float32]:
    """The present values (N,) of a metric of a group."""
    column = simulation.metric_names(group).index(name)
    return simulation.metrics(group)[..., column].reshape(-1)


def metrics(simulation: VectorSimulation, group: str | None = None) -> NDArray[np.float32]:
    """The present values (N, n) of all metrics of a group."""
    values = simulation.metrics(group)
    return values.reshape(values.shape[0] * values.shape[1], values.shape[2])


def goals_w(simulation: VectorSimulation, group: str | None = None) -> Array:
    """The goals (N, 2) of a group."""
    return simulation.group(group).starts.goals_w


def set_goal(simulation: VectorSimulation, row: int, goal: ArrayLike, group: str | None = None) -> None:
    """Send an agent of a group to `goal` (2,) [m]."""
    simulation.group(group).starts.set_goals(np.array([row]), np.asarray(goal, float))


def bearing(motion: Motion, points_w: ArrayLike) -> Array:
    """Bearing [rad], (N,), of points (N, 2) from the heading of each body."""
    offset = np.asarray(points_w) - motion.position_w[:, :2]
    return wrap_angle(np.arctan2(offset[:, 1], offset[:, 0]) - motion.yaw)


def put_walkers(simulation: VectorSimulation, poses: ArrayLike, group: str = "walker") -> None:
    """Have the kinematic agents of a group stand at `poses` (N, 4), as if they had always been there."""
    found = simulation.group(group)
    every = np.ones(len(found.done), bool)
    for scene, of_scene in enumerate(np.reshape(np.asarray(poses, float), (-1, found.count, 4))):
        found.body.place(scene, of_scene)
    found.body.read_start(every)
    found.goals.begin(every, found.body.motion)


def rest(simulation: VectorSimulation) -> dict[str, NDArray[np.float32]]:
    """Actions of zeros for all agents."""
    return {
        group.name: np.zeros((simulation.num_scenes, group.count, group.action_size), np.float32)
        for group in simulation.external
    }
