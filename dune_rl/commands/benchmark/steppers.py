"""Control steps under random actions, through the core and through each environment interface."""

from collections.abc import Callable

import numpy as np
import torch
from torchrl.envs import EnvBase, TransformedEnv

from dune_rl.config.build import make_parallel_env, make_simulation, make_torchrl_env
from dune_rl.config.commands import BenchmarkConf
from dune_rl.env.agent_group import AgentGroup
from dune_rl.env.articulated import ArticulatedBody
from dune_rl.env.gymnasium_vector import GymnasiumVectorEnv
from dune_rl.env.simulation import VectorSimulation
from dune_rl.env.torchrl import EpisodeMetrics
from dune_rl.geometry.arrays import Array, Floats
from dune_rl.metrics.episode import MetricsConf

Actions = dict[str, Floats]

_NUM_DRAWS = 64
_SPEED_AND_HEADING = 2
# Share of a joint's range on either side of its rest angle.
_SWAY = 0.05


class RandomActions:
    """Random actions of all external groups, drawn before the clock starts and equal for equal groups.

    Speeds and headings are uniform within their bounds; joint angles are near
    those of standing.
    """

    def __init__(self, simulation: VectorSimulation, seed: int = 0) -> None:
        draws = np.random.default_rng(seed)
        self._draws: Actions = {}
        for group in simulation.external:
            low, high = _action_range(group)
            shape = (_NUM_DRAWS, simulation.num_scenes, group.count, len(low))
            self._draws[group.name] = draws.uniform(low, high, shape).astype(np.float32)
        self._turn = 0

    def draw(self) -> Actions:
        """The next actions (M, G, A) of each group, by name."""
        self._turn = (self._turn + 1) % _NUM_DRAWS
        return {name: draws[self._turn] for name, draws in self._draws.items()}


def _action_range(group: AgentGroup) -> tuple[Array, Array]:
    body = group.body
    if not isinstance(body, ArticulatedBody):
        return body.action_bounds()
    low, high = body.robot.action_bounds()
    if len(low) != _SPEED_AND_HEADING:
        # With larger angles a robot falls at once, and resets would be measured instead of steps.
        rest, sway = body.robot.rest_action(), _SWAY * (high - low)
        low, high = np.maximum(low, rest - sway), np.minimum(high, rest + sway)
    return low, high


def core_stepper(simulation: VectorSimulation) -> Callable[[], None]:
    """A control step of all scenes under random actions, with observations and resets."""
    actions = RandomActions(simulation)

    def step() -> None:
        done = simulation.step(actions.draw()).done
        for group in simulation.external:
            group.observe()
        if done.any():
            simulation.reset(done)

    return step


def torchrl_stepper(conf: BenchmarkConf, *, metrics: bool = False) -> Callable[[], None]:
    """A step of the TorchRL environment of all scenes; with `metrics`, and an `EpisodeMetrics` of its terms.

    These are measured a second time, as those of the settings are measured in any environment.
    """
    base = make_torchrl_env(conf, conf.scenes, conf.seed)
    actions = RandomActions(base.simulation)
    env: EnvBase = base
    if metrics:
        env = TransformedEnv(base, EpisodeMetrics(MetricsConf(terms=conf.metrics.terms)))
    now = env.reset()

    def step() -> None:
        nonlocal now
        for name, values in actions.draw().items():
            now.set((name, "action"), torch.from_numpy(values))
        _, now = env.step_and_maybe_reset(now)

    return step


def gymnasium_vector_stepper(conf: BenchmarkConf) -> Callable[[], None]:
    """A step of Gymnasium's vector environment of all scenes, which have one external agent each."""
    env = GymnasiumVectorEnv(make_simulation(conf, conf.scenes, conf.seed))
    actions = RandomActions(env.simulation)
    (group,) = env.simulation.external
    env.reset()

    def step() -> None:
        env.step(actions.draw()[group.name][:, 0])

    return step


def pettingzoo_stepper(conf: BenchmarkConf) -> Callable[[], None]:
    """A step of the PettingZoo environment, which has one scene."""
    env = make_parallel_env(conf, conf.seed)
    actions = RandomActions(env.simulation)
    groups = env.simulation.external
    env.reset()

    def step() -> None:
        if not env.agents:
            env.reset()
        drawn = actions.draw()
        env.step(
            {name: drawn[group.name][0, agent] for group in groups for agent, name in enumerate(group.names)}
        )

    return step
