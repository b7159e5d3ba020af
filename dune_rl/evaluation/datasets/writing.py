"""Writes the episodes of an evaluation as a Minari dataset, whole or not at all."""

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import gymnasium
from torchrl.envs import EnvBase

from dune_rl.core.errors import ConfigError
from dune_rl.core.replaced_folder import check_replaceable, replace_folder
from dune_rl.core.suggestions import typed_word
from dune_rl.core.version import VERSION
from dune_rl.env.observation_layout import ObservationLayout, box
from dune_rl.evaluation.datasets.datasheet import write_datasheet
from dune_rl.evaluation.datasets.environment import environment_settings, environment_spec
from dune_rl.evaluation.datasets.transitions import (
    ACTIONS,
    INFOS,
    OBSERVATIONS,
    REWARDS,
    TERMINATIONS,
    TRUNCATIONS,
    Values,
    read_transitions,
)
from dune_rl.evaluation.folder import TRANSITIONS, ResultsFolder
from dune_rl.evaluation.policies import PolicySource
from dune_rl.evaluation.running import EvaluationPlan
from dune_rl.learning.checkpoint import interpreting, read_policy_file
from dune_rl.learning.saved_policies import saved_entry

DATASHEET = "DATASHEET.md"
_DATA = "data"


def plan_with_dataset(plan: EvaluationPlan, out: Path) -> EvaluationPlan:
    """The plan, which records transitions in the results folder `out` where its settings name a dataset.

    Raises ConfigError without Minari, and where the dataset is there and must not be overwritten.
    """
    name = plan.conf.dataset
    if name is None:
        return plan
    path = _dataset_path(name)
    if path.exists() and not plan.conf.overwrite:
        raise ConfigError(
            f"dataset={name} is there already, in {path}; choose another version, or replace it with "
            "overwrite=true"
        )
    parent = next(each for each in path.parents if each.exists())
    if not parent.is_dir() or not os.access(parent, os.W_OK):
        raise ConfigError(f"dataset={name} cannot be written to {parent}; set MINARI_DATASETS_PATH")
    _check_folder(name, path)
    return replace(plan, transitions=(out / TRANSITIONS).absolute())


def _check_folder(name: str, path: Path) -> None:
    """Raise ConfigError if a dataset's folder holds anything else, such as datasets of its namespace."""

    def find_others(folder: Path) -> list[Path]:
        return [each for each in folder.iterdir() if each.name not in (_DATA, DATASHEET)]

    named = f"dataset={name}: {path}"
    check_replaceable(path, "a dataset", find_others, overwrite=True, named=named)


def _dataset_path(name: str) -> Path:
    """Where Minari has the dataset of this name; raises ConfigError without Minari."""
    try:
        import h5py  # noqa: F401
        from minari.storage.datasets_root_dir import get_dataset_path
    except ImportError:
        raise ConfigError(f"dataset={name} needs Minari: pip install 'dune_rl[datasets]'") from None
    try:
        return Path(get_dataset_path(name)).absolute()
    except OSError as error:
        raise ConfigError(f"dataset={name}: {error}; set MINARI_DATASETS_PATH to a folder") from None


@dataclass(frozen=True)
class DatasetSpaces:
    """The observation space and the action space of the one agent of an environment."""

    observation: gymnasium.spaces.Dict
    action: gymnasium.spaces.Box


def dataset_spaces(env: EnvBase) -> DatasetSpaces:
    """The spaces that the Gymnasium environment of the same settings has."""
    (group,) = env.base_env.simulation.external
    observation = ObservationLayout(group, flatten=False).space
    assert isinstance(observation, gymnasium.spaces.Dict)
    return DatasetSpaces(observation, box(group.action_bounds))


def write_dataset(plan: EvaluationPlan, folder: ResultsFolder, spaces: DatasetSpaces) -> Path:
    """The folder of the dataset, which has the episodes of an evaluation in the order of their numbers.

    Raises ConfigError if transitions are missing, or the dataset cannot be written.
    """
    assert plan.conf.dataset is not None and plan.transitions is not None
    name = plan.conf.dataset
    path = _dataset_path(name)
    go_on = f"go on with {typed_word('resume', folder.path)}"

    def check() -> None:
        _check_folder(name, path)
        if path.exists() and not plan.conf.overwrite:
            raise ConfigError(f"dataset={name} is there now, in {path}; move it away, and {go_on}")

    try:
        # Minari passes over folders whose names begin with a dot, as that one's does.
        with replace_folder(path, check, last=_DATA) as new:
            _write(plan, folder, spaces, new)
    except OSError as error:
        raise ConfigError(f"dataset={name} cannot be written ({error}); {go_on}") from error
    return path


def _write(plan: EvaluationPlan, folder: ResultsFolder, spaces: DatasetSpaces, path: Path) -> None:
    import minari
    from minari.dataset.minari_dataset import parse_dataset_id
    from minari.dataset.minari_storage import MinariStorage
    from minari.namespace import create_namespace, list_local_namespaces

    conf, transitions = plan.conf, plan.transitions
    assert conf.dataset is not None and transitions is not None
    namespace = parse_dataset_id(conf.dataset)[0]
    if namespace is not None and namespace not in list_local_namespaces():
        create_namespace(namespace)
    storage = MinariStorage.new(
        path / _DATA,
        spaces.observation,
        spaces.action,
        environment_spec(conf, plan.episode_set),
        data_format="hdf5",
        # Pictures as the policy saw them, too.
        jpeg_encoding=False,
    )
    storage.update_metadata({"dataset_id": conf.dataset, "minari_version": minari.__version__})
    storage.update_episodes(_episode_buffers(transitions, plan.episodes, conf.seed))
    rows = [_episode_row(folder, episode) for episode in range(plan.episodes)]
    storage.update_episode_metadata(rows)
    origin = describe_origin(plan, folder.provenance)
    text = write_datasheet(conf, origin, rows, spaces.observation, spaces.action, storage.total_steps)
    storage.update_metadata(
        {"algorithm_name": origin["algorithm"], "description": text, "dune_rl": origin},
    )
    (path / DATASHEET).write_text(text, encoding="utf-8")


def _episode_buffers(transitions: Path, episodes: int, seed: int) -> Iterator[Any]:
    """Minari's `EpisodeBuffer` of each episode; its `seed` and `options` are those of the reset."""
    from minari.data_collector import EpisodeBuffer

    for episode, values in enumerate(read_transitions(transitions, episodes)):
        yield EpisodeBuffer(
            id=episode,
            seed=seed,
            options={"episode": episode},
            observations=_entries(values, OBSERVATIONS),
            actions=values[ACTIONS],
            rewards=values[REWARDS],
            terminations=values[TERMINATIONS],
            truncations=values[TRUNCATIONS],
            infos=_entries(values, INFOS),
        )


def _entries(values: Values, section: str) -> Values:
    return {
        key.removeprefix(f"{section}/"): value
        for key, value in values.items()
        if key.startswith(f"{section}/")
    }


def _episode_row(folder: ResultsFolder, episode: int) -> dict[str, Any]:
    """The row of an episode in the results, without unknown values and names with a "/"."""
    (rows,) = folder.finished[0, episode].rows.values()
    return {key: value for key, value in rows[0].items() if value is not None and "/" not in key}


def describe_origin(plan: EvaluationPlan, provenance: Mapping[str, Any]) -> dict[str, Any]:
    """Plain data on what made the episodes: policy and weights, version, commit, set and settings."""
    (policy,), (source,) = provenance["policies"], plan.sources
    return {
        "algorithm": _algorithm(source, plan.conf.external_groups[0].name),
        "policy": {key: policy[key] for key in ("name", "kind", "sha256", "trained")},
        "version": VERSION,
        "git": provenance["git"],
        "episode_set": provenance["set"],
        "episodes": plan.episodes,
        "seed": plan.conf.seed,
        "world": plan.conf.world.name,
        "engine": plan.conf.physics.backend,
        "settings": environment_settings(plan.conf),
    }


def _algorithm(source: PolicySource, group: str) -> str:
    """The policy's name, behind the algorithm by which it was trained for `group`."""
    if source.kind != "checkpoint" or source.file is None:
        return source.name
    file, content = read_policy_file(source.file)
    with interpreting(file):
        return f"{saved_entry(content['groups'], file, group)['algorithm']}: {source.name}"
