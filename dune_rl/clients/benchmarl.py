"""Tasks for BenchMARL: `Experiment(task=DuneTask.INSPECTION.get_task({...}), ...)`.

BenchMARL 1.5.2 asks for torchrl below 0.12, av below 14 and torchvision. dune_rl needs a newer torchrl, with
which BenchMARL works as well, and the other two are not used here; so pip has to install it without its
requirements: `pip install --no-deps benchmarl==1.5.2 tqdm`. Import this module before `benchmarl` itself: see
`_collector_name`.
"""

import importlib.util
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torchrl.collectors
import yaml
from tensordict import TensorDictBase
from torchrl.data import Composite
from torchrl.envs import EnvBase, Transform

import dune_rl
from dune_rl.config.compose import compose_environment
from dune_rl.config.controllers import EXTERNAL
from dune_rl.core.errors import ConfigError
from dune_rl.env.torchrl import EpisodeMetrics
from dune_rl.learning.collector import environment_seed


@contextmanager
def _collector_name() -> Iterator[None]:
    """TorchRL's `Collector` by its former name too, `SyncDataCollector`, while BenchMARL is imported.

    BenchMARL 1.5.2 imports the former name, which torchrl 0.14 no longer has; the class is the same, and
    takes the arguments that BenchMARL gives it. Where torchrl has the name, nothing is done.
    """
    if hasattr(torchrl.collectors, "SyncDataCollector"):
        yield
        return
    torchrl.collectors.SyncDataCollector = torchrl.collectors.Collector
    try:
        yield
    finally:
        del torchrl.collectors.SyncDataCollector


with _collector_name():
    try:
        from benchmarl.environments import Task, TaskClass
        from benchmarl.experiment import Callback
    except ModuleNotFoundError as error:
        if error.name != "benchmarl":
            raise
        raise ImportError(
            "BenchMARL is not installed: pip install --no-deps benchmarl==1.5.2 tqdm (its requirements would "
            "replace torchrl and av by versions that dune_rl cannot use)"
        ) from error


class DuneTaskClass(TaskClass):  # type: ignore[misc]
    """A world as a task of BenchMARL; its agent groups are those that `dune_rl.make` has as external.

    `config` has the settings of `dune_rl.make`, and `world` in place of the task's own. Observations are one
    vector for each agent, as BenchMARL's MLPs need them, unless `flatten` is False. All scenes of an
    environment are one batch. BenchMARL gives the environments of training and of evaluation one seed; theirs
    is derived from it, so that evaluations can have episodes of their own (`EpisodeLog`).
    """

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Callable[[], EnvBase]:
        """A function that makes the environment of `num_envs` scenes; its device is the CPU."""
        if torch.device(device).type != "cpu":
            raise ConfigError(f"dune_rl simulates on the CPU: set sampling_device to cpu (got {device})")
        derived = environment_seed(0 if seed is None else seed, 0, 0)
        return partial(dune_rl.make, **self._settings(), num_scenes=num_envs, seed=derived)

    def _settings(self) -> dict[str, Any]:
        return {"world": self.name.lower(), "flatten": True, **self.config}

    def supports_continuous_actions(self) -> bool:
        return True

    def supports_discrete_actions(self) -> bool:
        return False

    def max_steps(self, env: EnvBase) -> int:
        """The longest time limit of the agents' tasks; raises ConfigError if there is none."""
        external = [group for group in self._groups() if group.controller == EXTERNAL]
        limits = [limit for limit in map(_time_limit, external) if limit is not None]
        if not limits:
            raise ConfigError("BenchMARL's evaluations need a time limit: set task.terminations.time_limit")
        return max(limits)

    def _groups(self) -> Any:
        settings = self._settings()
        world, overrides = settings.pop("world"), settings.pop("overrides", ())
        folders = settings.pop("config_dirs", ())
        settings.pop("flatten")
        return compose_environment(world, overrides, settings, config_dirs=folders).groups

    def has_render(self, env: EnvBase) -> bool:
        """Whether TorchRL can write films here, of the first scene's first agent: that needs torchcodec."""
        return importlib.util.find_spec("torchcodec") is not None

    @staticmethod
    def render_callback(experiment: Any, env: EnvBase, data: TensorDictBase) -> torch.Tensor:
        return torch.from_numpy(env.base_env.render())

    def group_map(self, env: EnvBase) -> dict[str, list[str]]:
        return {group: list(agents) for group, agents in env.group_map.items()}

    def observation_spec(self, env: EnvBase) -> Composite:
        """The group's observations, without its metrics."""
        spec: Composite = env.full_observation_spec_unbatched.clone()
        for group in env.group_map:
            if "metrics" in spec[group]:
                del spec[group, "metrics"]
        return spec

    def action_spec(self, env: EnvBase) -> Composite:
        return env.full_action_spec_unbatched

    def info_spec(self, env: EnvBase) -> None:
        """None: BenchMARL would average running metrics over steps; `EpisodeLog` logs those of episodes."""

    def state_spec(self, env: EnvBase) -> None:
        """None: central critics get all agents' observations."""

    def action_mask_spec(self, env: EnvBase) -> None:
        """None."""

    def get_env_transforms(self, env: EnvBase) -> list[Transform]:
        """The metrics of episodes, for `EpisodeLog`."""
        return [EpisodeMetrics()]

    @staticmethod
    def env_name() -> str:
        return "dune_rl"


def _time_limit(group: Any) -> int | None:
    limit = group.task.terminations.get("time_limit") if group.task is not None else None
    return None if limit is None else int(limit.max_steps)


class DuneTask(Task):  # type: ignore[misc]
    """The worlds as tasks. `get_task(settings)`; without settings two walkers learn beside the rover.

    A world of one's own: `DuneTaskClass("quarry", {"config_dirs": ["my"], ...})`.
    """

    FLAT = None
    INSPECTION = None
    CONSTRUCTION = None
    RUBICON = None
    ISLAND = None

    @staticmethod
    def associated_class() -> type[DuneTaskClass]:
        return DuneTaskClass

    def get_from_yaml(self, path: str | None = None) -> DuneTaskClass:
        """The task with the settings of a YAML file, or with `{"actors": "external_walkers"}`."""
        if path is None:
            return DuneTaskClass(self.name, {"actors": "external_walkers"})
        return DuneTaskClass(self.name, yaml.safe_load(Path(path).read_text()))


class EpisodeLog(Callback):  # type: ignore[misc]
    """BenchMARL callback: evaluations on episodes that training never draws, and metrics of ended episodes.

    It logs the mean of each metric, such as success, as `collection/GROUP/metrics/NAME` and
    `eval/GROUP/metrics/NAME`. With `evaluation_static` all evaluations have the same episodes.
    """

    def on_setup(self) -> None:
        """Give the evaluation's environment the experiment's own seed, which training's is derived from."""
        self.experiment.test_env.set_seed(self.experiment.seed)

    def on_batch_collected(self, batch: TensorDictBase) -> None:
        """Log the episodes that ended in a batch (M, steps)."""
        self._log("collection", [batch.reshape(-1)])

    def on_evaluation_end(self, rollouts: list[TensorDictBase]) -> None:
        self._log("eval", rollouts)

    def _log(self, prefix: str, rollouts: list[TensorDictBase]) -> None:
        values: dict[str, float] = {}
        columns: Mapping[str, tuple[str, ...]] = self.experiment.test_env.base_env.metric_names
        for group, names in columns.items():
            ended = torch.cat(
                [rollout["next", group, "metrics"][rollout["next", "done"][:, 0]] for rollout in rollouts]
            )
            rows = ended.reshape(-1, len(names)).numpy()
            defined = np.isfinite(rows)
            for column in np.flatnonzero(defined.any(axis=0)).tolist():
                mean = rows[defined[:, column], column].mean()
                values[f"{prefix}/{group}/metrics/{names[column]}"] = float(mean)
        self.experiment.logger.log(values, step=self.experiment.n_iters_performed)
