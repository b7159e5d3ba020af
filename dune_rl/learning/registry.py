"""Registry of learning algorithms."""

from pkgutil import resolve_name
from typing import Any

from dune_rl.core.errors import CheckpointError
from dune_rl.core.registry import Registry
from dune_rl.learning.settings import LearningConf

# Our algorithms' settings, which can be imported without PyTorch.
_OWN_SETTINGS = {
    "crossq": "dune_rl.learning.crossq.settings:CrossqConf",
    "discrete_sac": "dune_rl.learning.discrete_sac.settings:DiscreteSacConf",
    "imitation": "dune_rl.learning.imitation.settings:ImitationConf",
    "ppo": "dune_rl.learning.ppo.settings:PpoConf",
    "sac": "dune_rl.learning.sac.settings:SacConf",
}


class AlgorithmRegistry(Registry[Any]):
    """Registry whose built-in settings are parsed and validated without importing PyTorch."""

    def settings_class(self, name: str) -> Any | None:
        """The settings class of the algorithm `name`, None where there is none."""
        if name not in _OWN_SETTINGS:
            return super().settings_class(name)
        return resolve_name(_OWN_SETTINGS[name])


ALGORITHMS = AlgorithmRegistry(
    "algorithm",
    "dune_rl.learning.registry:ALGORITHMS",
    own={
        "crossq": "dune_rl.learning.crossq.learner:Crossq",
        "discrete_sac": "dune_rl.learning.discrete_sac.learner:DiscreteSac",
        "imitation": "dune_rl.learning.imitation.learner:Imitation",
        "ppo": "dune_rl.learning.ppo.learner:Ppo",
        "sac": "dune_rl.learning.sac.learner:Sac",
    },
    base=LearningConf,
    product=object,
    form="a class derived from dune_rl.learning.algorithm.Algorithm",
    function_leading=None,
    class_leading=("context",),
)


def algorithm_class(name: str, source: str) -> Any:
    """The class of the algorithm `name`, which `source` was made with; raises CheckpointError without it."""
    part = ALGORITHMS.find(name)
    if part is None:
        raise CheckpointError(f"{source} was made with another algorithm: {ALGORITHMS.unknown(name)}")
    return part.target
