"""The algorithms there are: ours, those of installed packages, and those that a program registers."""

from typing import TYPE_CHECKING, Any

from dune_rl.errors import CheckpointError
from dune_rl.learning.settings import LearningConf
from dune_rl.registry import Registry

if TYPE_CHECKING:
    from dune_rl.learning.algorithm import Algorithm

ALGORITHMS: Registry[Any] = Registry(
    "algorithm",
    "dune_rl.learning.registry:ALGORITHMS",
    own={"sac": "dune_rl.learning.sac.learner:Sac"},
    base=LearningConf,
    product=object,
    form="a class derived from dune_rl.learning.algorithm.Algorithm",
    function_leading=None,
    class_leading=("context",),
)


def algorithm_class(name: str, source: str) -> "type[Algorithm]":
    """The class of the algorithm `name`, which `source` was made with; raises CheckpointError without it."""
    part = ALGORITHMS.find(name)
    if part is None:
        raise CheckpointError(f"{source} was made with another algorithm: {ALGORITHMS.unknown(name)}")
    found: type[Algorithm] = part.target  # type: ignore[assignment]
    return found
