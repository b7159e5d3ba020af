"""Curricula: the difficulty of the next episodes, driven by the outcomes of earlier ones."""

from collections.abc import Callable, Mapping
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field, SerializeAsAny

from dune_rl.core.errors import ConfigError
from dune_rl.core.registry import Registry
from dune_rl.core.settings import Settings
from dune_rl.geometry.arrays import Array, Flags

# Outcomes that a curriculum sees at most.
_MOST_OUTCOMES = 1000


class CurriculumConf(Settings):
    """Base of the settings of every curriculum; `name` is its name in the registry.

    A level in [0, 1] is the difficulty of the episodes that begin. At 1 they are those without a curriculum.
    At 0 goals are as near as `task.spawn.min_goal_distance_m` allows; in between, the largest distance rises
    linearly.
    """

    name: str
    start_level: float = Field(0.0, ge=0.0, le=1.0, description="level of the first episodes")
    measure: str = Field("success", min_length=1, description="metric that is an episode's outcome")
    group: str | None = Field(
        None, min_length=1, description="agent group whose outcomes count; null: the first that learns"
    )
    easiest: dict[str, float] = Field(
        default_factory=dict, description="values of randomised properties at level 0"
    )


CURRICULA: Registry[Any] = Registry(
    "curriculum",
    "dune_rl.env.curriculum:CURRICULA",
    own={"by_outcome": "dune_rl.env.curriculum:by_outcome"},
    base=CurriculumConf,
    product=float,
    form="a function of (level, outcomes) that returns the next level",
    function_leading=("level", "outcomes"),
)


def _parse(value: Any) -> Any:
    if isinstance(value, str):
        value = {"name": value}
    elif isinstance(value, Mapping):
        # A setting that is given by its path.
        value = {"name": "by_outcome", **value}
    return CURRICULA.parse_settings(value)


CurriculumSettings = Annotated[SerializeAsAny[CurriculumConf], BeforeValidator(_parse)]


def by_outcome(
    level: float,
    outcomes: Array,
    *,
    episodes: Annotated[int, Field(ge=1, le=_MOST_OUTCOMES)] = 30,
    raise_above: float = 0.8,
    lower_below: float = 0.4,
    step: Annotated[float, Field(gt=0.0, le=1.0)] = 0.1,
) -> float:
    """Raise or lower the level by `step` where the mean outcome of `episodes` is out of two limits."""
    if lower_below >= raise_above:
        raise ConfigError(
            f"learning.curriculum.lower_below={lower_below:g} must be below raise_above={raise_above:g}"
        )
    if len(outcomes) < episodes:
        return level
    mean = outcomes[-episodes:].mean()
    return level + step if mean > raise_above else level - step if mean < lower_below else level


class Curriculum:
    """Sets the difficulty of each episode of M scenes; without settings it is 1.

    `level` is the difficulty of the episodes that begin, and `difficulty` (M,) that of the present ones. The
    outcomes of episodes that began at another level than the present one do not count.
    """

    def __init__(self, conf: CurriculumConf | None, num_scenes: int) -> None:
        self.conf = conf
        self.level = 1.0 if conf is None else conf.start_level
        self.difficulty = np.full(num_scenes, self.level)
        self._outcomes: list[float] = []

    def begin(self, mask: Flags) -> None:
        """Set the difficulty of the episodes that begin in the scenes in `mask` (M,)."""
        if self.conf is not None:
            self.difficulty = np.where(mask, self.level, self.difficulty)

    def end(self, mask: Flags, measure: Callable[[str], Array]) -> None:
        """Record the episodes that end in `mask` (M,); `measure` returns the values (M,) of a metric.

        Episodes without a value, which are NaN, do not count.
        """
        if self.conf is None or not mask.any():
            return
        outcomes = measure(self.conf.measure)
        counted = mask & (self.difficulty == self.level) & ~np.isnan(outcomes)
        for outcome in outcomes[counted].tolist():
            self._outcomes = [*self._outcomes[1 - _MOST_OUTCOMES :], outcome]
            level = float(CURRICULA.build(self.conf, self.level, np.array(self._outcomes)))
            level = min(max(level, 0.0), 1.0)
            if level != self.level:
                self.level, self._outcomes = level, []
                return

    def state(self) -> dict[str, Any] | None:
        """Plain data from which `restore` continues; None without settings."""
        if self.conf is None:
            return None
        return {"level": self.level, "outcomes": self._outcomes, "difficulty": self.difficulty.tolist()}

    def restore(self, state: Mapping[str, Any] | None) -> None:
        """Continue from what `state` returned; without settings, here or then, nothing changes."""
        if self.conf is None or state is None:
            return
        self.level, self._outcomes = float(state["level"]), list(state["outcomes"])
        self.difficulty = np.array(state["difficulty"])
