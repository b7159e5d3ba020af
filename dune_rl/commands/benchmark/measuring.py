"""Times taken in turn, memory, and control steps under random actions through each interface."""

import resource
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import torch
from torchrl.envs import EnvBase, TransformedEnv

from dune_rl.config.build import make_parallel_env, make_simulation, make_torchrl_env
from dune_rl.config.commands import BenchmarkConf
from dune_rl.env.agent_group import AgentGroup
from dune_rl.env.gymnasium_vector import GymnasiumVectorEnv
from dune_rl.env.simulation import VectorSimulation
from dune_rl.env.torchrl import EpisodeMetrics
from dune_rl.geometry.arrays import Array, Floats
from dune_rl.metrics.episode import MetricsConf

Step = Callable[[], object]
Actions = dict[str, Floats]

_NUM_DRAWS = 64
_SPEED_AND_HEADING = 2
# Share of a joint's range on either side of its rest angle.
_SWAY = 0.05


def time_calls(action: Step, count: int = 1) -> float:
    start = time.perf_counter()
    for _ in range(count):
        action()
    return time.perf_counter() - start


def time_in_turns(
    actions: Mapping[str, Step], rounds: int, counts: int | Mapping[str, int] = 1, warm_up: int = 0
) -> dict[str, Array]:
    """Times [s] per call of each action by name, (rounds,) each.

    Each round calls every action in turn, as often as `counts` says, so that a noisy machine disturbs all of
    them alike. Every action is called `warm_up` times before.
    """
    calls = dict.fromkeys(actions, counts) if isinstance(counts, int) else dict(counts)
    for action in actions.values():
        time_calls(action, warm_up)
    times = [
        [time_calls(each, calls[name]) / calls[name] for name, each in actions.items()] for _ in range(rounds)
    ]
    return dict(zip(actions, np.array(times).T, strict=True))


def median_ratio(numerators: Array, denominators: Array) -> float:
    """Median of the ratios of times taken in turn."""
    return float(np.median(numerators / denominators))


def memory_mib(*, peak: bool = False) -> float:
    """Resident memory of this process now, or its `peak`, which alone some systems tell [MiB]."""
    # On Linux, getrusage gives a spawned process its parent's peak; its status file has its own.
    status = Path("/proc/self/status")
    if status.exists():
        lines = dict(line.split(":", 1) for line in status.read_text().splitlines() if ":" in line)
        return int(lines["VmHWM" if peak else "VmRSS"].split()[0]) / 1024
    scale = 1024 if sys.platform != "darwin" else 1024**2
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / scale


class RandomActions:
    """Random actions of all external groups, drawn before the clock starts and equal for equal groups.

    Speeds and headings are uniform within their bounds; joint angles are near those of standing.
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
    low, high = group.body.action_bounds()
    if group.description.is_robot and len(low) != _SPEED_AND_HEADING:
        # With larger angles a robot falls at once, and resets would be measured instead of steps.
        rest, sway = group.rest_action, _SWAY * (high - low)
        low, high = np.maximum(low, rest - sway), np.minimum(high, rest + sway)
    return low, high


def start_simulation(conf: BenchmarkConf, num_scenes: int | None = None) -> VectorSimulation:
    simulation = make_simulation(conf, num_scenes or conf.scenes, conf.seed)
    simulation.reset()
    return simulation


def observe(simulation: VectorSimulation) -> None:
    """Compute the observations of all external groups."""
    for group in simulation.external:
        group.observe()


def core_stepper(simulation: VectorSimulation) -> Step:
    """A control step of all scenes under random actions, with observations and resets."""
    actions = RandomActions(simulation)

    def step() -> None:
        done = simulation.step(actions.draw()).done
        observe(simulation)
        if done.any():
            simulation.reset(done)

    return step


def torchrl_stepper(conf: BenchmarkConf, *, metrics: bool = False) -> Step:
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


def gymnasium_vector_stepper(conf: BenchmarkConf) -> Step:
    """A step of Gymnasium's vector environment of all scenes, which have one external agent each."""
    env = GymnasiumVectorEnv(make_simulation(conf, conf.scenes, conf.seed))
    actions = RandomActions(env.simulation)
    (group,) = env.simulation.external
    env.reset()
    return lambda: env.step(actions.draw()[group.name][:, 0])


def pettingzoo_stepper(conf: BenchmarkConf) -> Step:
    """A step of the PettingZoo environment, which has one scene."""
    env = make_parallel_env(conf, conf.seed)
    actions = RandomActions(env.simulation)
    env.reset()

    def step() -> None:
        if not env.agents:
            env.reset()
        drawn = actions.draw()
        groups = env.simulation.external
        env.step(
            {
                name: row
                for group in groups
                for name, row in zip(group.names, drawn[group.name][0], strict=True)
            }
        )

    return step
