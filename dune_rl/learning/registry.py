"""The algorithms there are: ours, those of installed packages, and those that a program registers."""

from typing import Any

from dune_rl.registry import Registry
from dune_rl.settings import Settings


class AlgorithmSettings(Settings):
    """Settings of a learning algorithm; `name` says of which, so that saved settings find their class."""

    name: str


ALGORITHMS: Registry[Any] = Registry(
    "algorithm",
    "dune_rl.learning.registry:ALGORITHMS",
    own={},
    base=AlgorithmSettings,
    product=object,
    form="a class of algorithms",
    function_leading=None,
    class_leading=("spec", "total_frames", "device"),
)
