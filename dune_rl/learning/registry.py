"""Registry of algorithms: built-in ones, those of installed packages, and those registered at run time."""

import importlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dune_rl.core.errors import CheckpointError, ConfigError
from dune_rl.core.registry import Registry
from dune_rl.learning.settings import LearningConf

if TYPE_CHECKING:
    import torch
    from torchrl.envs import EnvBase

    from dune_rl.learning.algorithm import Algorithm, LearnerContext

# Our algorithms' settings, which can be imported without PyTorch.
_OWN_SETTINGS = {"sac": "dune_rl.learning.sac.settings:SacConf"}


class AlgorithmRegistry(Registry[Any]):
    """Registry whose built-in settings are parsed and validated without importing PyTorch."""

    def settings_class(self, name: str) -> Any | None:
        """The settings class of the algorithm `name`, None where there is none."""
        if name not in _OWN_SETTINGS:
            return super().settings_class(name)
        module, _, attribute = _OWN_SETTINGS[name].partition(":")
        return getattr(importlib.import_module(module), attribute)


ALGORITHMS = AlgorithmRegistry(
    "algorithm",
    "dune_rl.learning.registry:ALGORITHMS",
    own={"sac": "dune_rl.learning.sac.learner:Sac"},
    base=LearningConf,
    product=object,
    form="a class derived from dune_rl.learning.algorithm.Algorithm",
    function_leading=None,
    class_leading=("context",),
)


def build_learner(conf: LearningConf, context: "LearnerContext") -> "Algorithm":
    """The learner of one group by the algorithm that `conf` is of; raises ConfigError for what is none."""
    # Only now: the command lines read settings without PyTorch.
    from dune_rl.learning.algorithm import Algorithm

    learner = ALGORITHMS.build(conf, context)
    if not isinstance(learner, Algorithm):
        raise ConfigError(
            f"the algorithm {conf.name!r} must be a class derived from Algorithm, and is {learner!r:.80}"
        )
    return learner


def build_learners(
    conf: LearningConf, env: "EnvBase", total_frames: int, folder: Path, device: "torch.device"
) -> "dict[str, Algorithm]":
    """The learner of each group of agents of `env`, which writes to `folder`; or its frozen policy."""
    from dune_rl.learning.algorithm import LearnerContext
    from dune_rl.learning.frozen import FrozenPolicy
    from dune_rl.learning.policy_spec import PolicySpec

    learners: dict[str, Algorithm] = {}
    for group, agents in env.group_map.items():
        context = LearnerContext(
            group=group,
            num_agents=len(agents),
            spec=PolicySpec.of(env, group),
            total_frames=total_frames,
            folder=folder,
            device=device,
            algorithm=conf.name,
        )
        frozen = conf.frozen(group)
        if frozen is None:
            learners[group] = build_learner(conf.of_group(group), context)
        else:
            learners[group] = FrozenPolicy(context, Path(frozen))
    return learners


def algorithm_class(name: str, source: str) -> "type[Algorithm]":
    """The class of the algorithm `name`, which `source` was made with; raises CheckpointError without it."""
    part = ALGORITHMS.find(name)
    if part is None:
        raise CheckpointError(f"{source} was made with another algorithm: {ALGORITHMS.unknown(name)}")
    found: type[Algorithm] = part.target  # type: ignore[assignment]
    return found
