"""The policies of an evaluation: checkpoints, built-in policies, ONNX files and user functions."""

import importlib
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torchrl.envs import EnvBase

from dune_rl.config.commands import EvaluateConf
from dune_rl.core.errors import ConfigError, DuneError
from dune_rl.core.files import sha256_of
from dune_rl.core.suggestions import closest
from dune_rl.env.torchrl.episode_metrics import simulation_in
from dune_rl.learning.checkpoint import POLICY_SOURCES, find_checkpoint_file, interpreting, read_policy_file
from dune_rl.learning.group_policy import Policy, read_begins
from dune_rl.learning.onnx_policy import OnnxPolicy
from dune_rl.learning.policies import built_in_policy
from dune_rl.learning.policy_spec import PolicySpec
from dune_rl.learning.saved_policies import describe_selection, load_policy
from dune_rl.sensors.draws import draw, uniform

Act = Callable[[dict[str, NDArray[Any]]], NDArray[np.floating]]
Kind = Literal["checkpoint", "built-in", "onnx", "callable"]


@dataclass(frozen=True)
class PolicySource:
    """A policy's name in tables, its kind, and where it comes from: a path, or MODULE:FUNCTION."""

    name: str
    kind: Kind
    location: str

    @property
    def file(self) -> Path | None:
        """The file of its weights; None where there is none."""
        if self.kind == "checkpoint":
            return find_checkpoint_file(Path(self.location), *POLICY_SOURCES)
        return Path(self.location) if self.kind == "onnx" else None

    def plain(self) -> dict[str, Any]:
        """Plain data, with the SHA-256 of the file, which policy of its run it has, and where that began.

        Raises ConfigError if that cannot be read.
        """
        try:
            sha256 = None if self.file is None else sha256_of(self.file)
        except OSError as error:
            raise ConfigError(f"{self.location} cannot be read: {error.strerror or error}") from None
        trained, started_from = None, {}
        if self.kind == "checkpoint" and self.file is not None:
            file, content = read_policy_file(self.file)
            with interpreting(file):
                trained, started_from = describe_selection(content), content.get("started_from", {})
        return {**asdict(self), "sha256": sha256, "trained": trained, "started_from": started_from}

    def load(self, env: EnvBase) -> Policy:
        """The policy for all groups of `env`; raises DuneError where it does not fit."""
        match self.kind:
            case "checkpoint":
                return load_policy(Path(self.location), env)[0]
            case "built-in" if self.location == "random":
                return RandomByEpisode(env)
            case "built-in":
                return built_in_policy(self.location, env)
            case "onnx":
                return OnnxUserPolicy(self.name, Path(self.location), env)
            case "callable":
                return UserPolicy(self.name, _import_function(self.location), env)


def policy_sources(conf: EvaluateConf) -> tuple[PolicySource, ...]:
    """The policies of an evaluation, with different names; raises ConfigError for one that is no policy."""
    found = [
        PolicySource(checkpoint_name(Path(location)), "checkpoint", location) for location in conf.checkpoint
    ]
    for location in (*conf.policy, *conf.against):
        if Path(location).suffix == ".onnx":
            found.append(PolicySource(Path(location).stem, "onnx", location))
        elif ":" in location:
            found.append(PolicySource(location.partition(":")[2], "callable", location))
        else:
            found.append(PolicySource(location, "built-in", location))
    found = list(dict.fromkeys(found))
    names = [source.name for source in found]
    for index, source in enumerate(found):
        if names.count(source.name) > 1:
            longer = source.location if source.kind != "built-in" else f"{source.location} (built in)"
            found[index] = replace(source, name=longer)
    return tuple(found)


def checkpoint_name(path: Path) -> str:
    """What the policies of a run's folder, or of a file, are called."""
    # "." and ".." are folders without a name of their own.
    return path.resolve().name if path.is_dir() else path.parent.name or path.stem


class RandomByEpisode:
    """Uniformly random actions that depend on (seed, episode, step) alone, not on scenes side by side."""

    def __init__(self, env: EnvBase) -> None:
        self._simulation = simulation_in(env)
        self._specs = {group: PolicySpec.of(env, group) for group in env.group_map}

    def __call__(self, observation: TensorDictBase) -> TensorDictBase:
        for name, spec in self._specs.items():
            group = self._simulation.state.groups[name]
            # Of the episodes that the observation is of: those of done scenes have been reset already.
            draws = draw(uniform, group.episode, f"policy random {name}", spec.action_size)
            low, high = np.asarray(spec.low, np.float32), np.asarray(spec.high, np.float32)
            actions = (low + draws * (high - low)).reshape(-1, group.count, spec.action_size)
            observation.set((name, "action"), torch.from_numpy(actions))
        return observation


class UserPolicy:
    """A function from observations by sensor name, arrays (N, ...), to actions (N, A) in physical units.

    It is called for each group of agents; N are the agents of all scenes. Actions are clipped to their
    bounds. Raises ConfigError for an error in it, and for actions of another shape or that are not finite.
    """

    def __init__(self, name: str, act: Act, env: EnvBase) -> None:
        self._name, self._act = name, act
        self._specs = {group: PolicySpec.of(env, group) for group in env.group_map}

    def __call__(self, observation: TensorDictBase) -> TensorDictBase:
        for group, spec in self._specs.items():
            parts = observation.get((group, "observation"))
            shape = parts.batch_size
            rows = {key: value.flatten(0, 1).numpy().copy() for key, value in parts.items()}
            with _users_code(f"policy {self._name} failed"):
                actions = np.asarray(self._act_for(group, rows))
            expected = (shape.numel(), spec.action_size)
            fault = ""
            if actions.dtype.kind not in "fiu":
                fault = f"got {actions.dtype}"
            elif actions.shape != expected:
                fault = f"got {actions.shape}"
            elif not np.isfinite(actions).all():
                fault = "some are not finite"
            if fault:
                raise ConfigError(
                    f"policy {self._name}: actions must be finite numbers of shape {expected} ({fault})"
                )
            low, high = np.asarray(spec.low, np.float32), np.asarray(spec.high, np.float32)
            clipped = np.clip(actions.astype(np.float32), low, high).reshape(*shape, spec.action_size)
            observation.set((group, "action"), torch.from_numpy(clipped))
        return observation

    def _act_for(self, group: str, rows: dict[str, NDArray[Any]]) -> NDArray[np.floating]:
        return self._act(rows)


class OnnxUserPolicy(UserPolicy):
    """The policy of an ONNX file; of a recurrent one each agent has a memory, empty where episodes begin."""

    def __init__(self, name: str, path: Path, env: EnvBase) -> None:
        self._policies = {group: OnnxPolicy(path) for group in env.group_map}
        self._env = env
        super().__init__(name, next(iter(self._policies.values())).act, env)
        for group, spec in self._specs.items():
            if (bounds := self._policies[group].action_bounds) is not None:
                replace(spec, low=bounds[0], high=bounds[1]).require(spec, f"policy={path}")

    def _act_for(self, group: str, rows: dict[str, NDArray[Any]]) -> NDArray[np.floating]:
        policy = self._policies[group]
        begins = read_begins(self._env, group).flatten().numpy() if policy.is_recurrent else None
        return policy.act(rows, begins)


def _import_function(location: str) -> Act:
    module, _, name = location.partition(":")
    if not module or not name or module.endswith(".py") or "/" in module:
        raise ConfigError(
            f"policy={location}: write MODULE:FUNCTION, such as my_drivers:straight for the function "
            "straight of my_drivers.py in this folder"
        )
    with _users_code(f"policy={location}: importing {module} failed"):
        try:
            imported = importlib.import_module(module)
        except ModuleNotFoundError as error:
            raise ConfigError(
                f"policy={location}: the module {module} cannot be imported ({error}); run the command in "
                "its folder, or set PYTHONPATH"
            ) from None
    found = getattr(imported, name, None)
    if found is None:
        near = closest(name, vars(imported))
        meant = f"; did you mean {module}:{near}?" if near else ""
        raise ConfigError(f"policy={location}: the module {module} has no {name}{meant}")
    with _users_code(f"policy={location} cannot be made"):
        # A class is made once for each process.
        act: Act = found() if isinstance(found, type) else found
    if not callable(act):
        raise ConfigError(f"policy={location} is no function, but {type(act).__name__}")
    return act


@contextmanager
def _users_code(fault: str) -> Iterator[None]:
    """Raise ConfigError, opened by `fault`, with the kind, text and place of an error in a user's code."""
    try:
        yield
    except DuneError:
        raise
    except Exception as error:
        lines = str(error).splitlines()
        text = f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__
        frames = traceback.extract_tb(error.__traceback__)
        last = [each for each in frames if "importlib" not in each.filename][-1]
        place = "" if last.filename == __file__ else f" (line {last.lineno} of {last.filename})"
        raise ConfigError(f"{fault}: {text}{place}") from error
