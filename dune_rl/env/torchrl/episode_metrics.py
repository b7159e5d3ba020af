"""A transform that adds metrics of the episodes to the data of TorchRL's environments."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from pydantic import ValidationError
from tensordict import TensorDictBase
from torchrl.data import Composite, TensorSpec, Unbounded
from torchrl.envs import EnvBase
from torchrl.envs.batched_envs import BatchedEnvBase
from torchrl.envs.transforms import Transform, TransformedEnv

from dune_rl.core.errors import ConfigError
from dune_rl.env.agent_group import AgentGroup
from dune_rl.env.simulation import VectorSimulation
from dune_rl.metrics.episode import MetricsConf, MetricSet

_ALL = "metrics"
# Where wrappers of environments keep the one inside.
_INSIDE = ("_env", "unwrapped", "env")


class EpisodeMetrics(Transform):
    """Transform that adds metrics of the present episodes so far; final for agents that are done.

    `metrics` are settings as in `metrics.terms`, such as `{"jerk": {"reduce": "mean"}}`, or a `MetricsConf`;
    `groups` are the names of the groups that are measured, by default all external ones with a task. Each
    metric has a key of its own beside the group's reward, of the reward's shape: (`group`, "episode_jerk"),
    (M, G, 1), or another name from `out_keys`, one for each metric. After a `SingleAgent` the keys are flat.

    Without `metrics` it adds those of the environment's settings as one array: (`group`, "metrics") of shape
    (M, G, n), for each group with metrics; `metric_names[group]` names the n columns.

    A value is float32, and NaN where it is not defined yet. The simulation resets the metrics with its
    episodes, of some scenes or of all, so no key has to be carried from step to step. The transform belongs
    in the process of the simulation: inside `SerialEnv` and `ParallelEnv`, not around them. Raises
    ConfigError for unknown metrics, groups or settings, and TypeError for an environment that is not of ours.
    """

    def __init__(
        self,
        metrics: Mapping[str, Any] | MetricsConf | None = None,
        *,
        groups: Sequence[str] | None = None,
        out_keys: Sequence[str] | None = None,
    ) -> None:
        super().__init__()
        self._conf = None if metrics is None else _settings(metrics)
        self._chosen = None if groups is None else tuple(groups)
        self._names = _ALL if self._conf is None else _key_names(tuple(self._conf.all_terms), out_keys)
        self._measured: list[tuple[AgentGroup, MetricSet | None]] | None = None

    # -- the simulation -------------------------------------------------------------------------------

    def set_container(self, container: Any) -> None:
        """Measure the environment from here on; it calls this when the transform is added to it."""
        super().set_container(container)
        self._measured = None
        # A Compose may have no environment yet; it sets its transforms' container again when it gets one.
        inside_one = isinstance(container, EnvBase) or container.__dict__.get("_container") is not None
        if inside_one and self.container is not None:
            self._find()

    def reset_parent(self) -> None:
        """Leave the environment; it goes on measuring, as another transform may want the same."""
        super().reset_parent()
        self._measured = None

    def clone(self) -> "EpisodeMetrics":
        """A transform like this one, for another environment."""
        copied: EpisodeMetrics = super().clone()
        copied._measured = None
        return copied

    def __getstate__(self) -> dict[str, Any]:
        return {**super().__getstate__(), "_measured": None}

    @property
    def _simulation(self) -> VectorSimulation:
        env = self.container
        if env is None:
            raise RuntimeError("EpisodeMetrics needs an environment: TransformedEnv(env, EpisodeMetrics())")
        return simulation_in(env)

    def _find(self) -> list[tuple[AgentGroup, MetricSet | None]]:
        """The groups with what is measured of them; None stands for the metrics of the settings."""
        if self._measured is None:
            simulation = self._simulation
            groups = [group for group in simulation.external if _has_metrics(group, self._conf)]
            if self._chosen is not None:
                groups = _choose(simulation, self._chosen)
            self._measured = [
                (group, None if self._conf is None else simulation.add_metrics(group.name, self._conf))
                for group in groups
            ]
        return self._measured

    @property
    def metric_names(self) -> dict[str, tuple[str, ...]]:
        """Names of the metrics by group: the columns of its array, or the metrics with keys of their own."""
        if self._conf is not None:
            return {group.name: tuple(self._conf.all_terms) for group, _ in self._find()}
        simulation = self._simulation
        return {group.name: simulation.metric_names(group.name) for group, _ in self._find()}

    # -- the transform --------------------------------------------------------------------------------

    def _add(self, tensordict: TensorDictBase) -> TensorDictBase:
        for group, found in self._find():
            # Behind a SingleAgent there is no group.
            inside = tensordict.get(group.name, None)
            target = tensordict if inside is None else inside
            shape = target.batch_size
            if found is None:
                values = torch.from_numpy(self._simulation.metrics(group.name))
                target.set(_ALL, values.view(*shape, -1))
                continue
            columns = torch.from_numpy(found.term_values.astype(np.float32)).view(-1, *shape, 1).unbind()
            for key, values in zip(self._names, columns, strict=True):
                # Of the right shape and type by construction; checking that takes longer than all the rest.
                target._set_str(key, values, inplace=False, validated=True)
        return tensordict

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._add(next_tensordict)

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return self._add(tensordict_reset)

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add the specs of the metrics."""
        for group, _ in self._find():
            inside = group.name in observation_spec.keys()  # noqa: SIM118
            target: Composite = observation_spec[group.name] if inside else observation_spec
            width = len(self._simulation.metric_names(group.name)) if self._conf is None else 1
            for key in [_ALL] if self._conf is None else self._names:
                target[key] = Unbounded((*target.shape, width), dtype=torch.float32)
        return observation_spec


def _settings(metrics: Mapping[str, Any] | MetricsConf) -> MetricsConf:
    if isinstance(metrics, MetricsConf):
        return metrics
    try:
        return MetricsConf(terms=dict(metrics))
    except ValidationError as error:
        faults = [f"{'.'.join(map(str, each['loc']))}: {each['msg']}" for each in error.errors()]
        raise ConfigError("\n".join(f"EpisodeMetrics: {fault}" for fault in faults)) from None


def _key_names(metrics: Sequence[str], out_keys: Sequence[str] | None) -> tuple[str, ...]:
    names = tuple(f"episode_{name}" for name in metrics) if out_keys is None else tuple(out_keys)
    if len(names) != len(metrics) or len(set(names)) != len(names):
        raise ConfigError(
            f"EpisodeMetrics: out_keys must be {len(metrics)} different names, one for each of "
            f"{', '.join(metrics)} (got {', '.join(names)})"
        )
    return names


def _has_metrics(group: AgentGroup, conf: MetricsConf | None) -> bool:
    return bool(group.metric_names) if conf is None else group.task is not None


def _choose(simulation: VectorSimulation, names: Sequence[str]) -> list[AgentGroup]:
    external = {group.name: group for group in simulation.external}
    unknown = [name for name in names if name not in external]
    if unknown:
        raise ConfigError(f"EpisodeMetrics: there is no external group {unknown[0]!r}, but {[*external]}")
    return [external[name] for name in names]


def simulation_in(env: EnvBase) -> VectorSimulation:
    """The simulation inside an environment, however wrapped; raises TypeError if there is none."""
    found: Any = env
    while found is not None:
        if isinstance(found, TransformedEnv):
            found = found.base_env
            continue
        if isinstance(found, BatchedEnvBase):
            # Its simulations are in processes of their own.
            break
        simulation = getattr(found, "simulation", None)
        if isinstance(simulation, VectorSimulation):
            return simulation
        insides = (getattr(found, name, None) for name in _INSIDE)
        found = next((each for each in insides if each is not None and each is not found), None)
    raise TypeError(
        f"EpisodeMetrics finds no simulation of dune_rl in {type(env).__name__}. It goes into each process, "
        "not around them: ParallelEnv(2, lambda: TransformedEnv(dune_rl.make(...), EpisodeMetrics(...)))"
    )
