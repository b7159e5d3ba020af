"""A mixture of world families: the seed chooses the family and the site."""

from typing import Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from dune_rl.core.suggestions import advise
from dune_rl.worlds.registry import WORLDS
from dune_rl.worlds.settings import SeededConf, WorldSettings
from dune_rl.worlds.world import Rectangle, World


class MixedConf(SeededConf):
    """Settings of `build_mixed`: of n families, the site of seed s is that of family number s modulo n.

    Readings that are bounded by the world's size have the bounds of a square of `size_m`.
    """

    # Its members are cached, each by itself.
    disk_cached: ClassVar[Literal["world", "appearance", "nothing"]] = "nothing"
    name: Literal["mixed"] = "mixed"
    families: tuple[str, ...] = Field(
        # The hard ones, construction and rubicon, twice.
        default=(
            *("flat", "inspection", "construction", "rubicon"),
            *("island", "obstacle_course", "construction", "rubicon"),
        ),
        min_length=1,
        max_length=100,
        description="names of worlds; one that is named twice is drawn twice as often",
    )
    settings: dict[str, dict[str, Any]] = Field(
        default_factory=dict, description="of families, by name, in place of their defaults"
    )
    size_m: float = Field(default=100.0, gt=0.0, le=10_000.0, description="of a square that holds them all")

    @model_validator(mode="after")
    def _sound(self) -> Self:
        for name in self.settings:
            if name not in self.families:
                raise ValueError(f"settings.{name} are of no family; {advise(name, self.families)}")
        for name in self.families:
            self._family(name)
        return self

    @property
    def common_extent(self) -> Rectangle:
        """The square of `size_m` round the origin."""
        half = self.size_m / 2
        return -half, half, -half, half

    def drawn(self) -> WorldSettings:
        """The settings of the family that the seed chooses, with that seed."""
        family = self._family(self.families[self.seed % len(self.families)])
        changes = {"seed": self.seed, "layout_seed": self.layout_seed}
        own = {name: value for name, value in changes.items() if name in type(family).model_fields}
        return family.model_copy(update=own)

    def _family(self, name: str) -> WorldSettings:
        if name == self.name:
            raise ValueError("a mixture cannot be one of its own families")
        return WORLDS.parse_settings({**self.settings.get(name, {}), "name": name})

    def __hash__(self) -> int:
        return hash((self.name, self.families, self.seed, self.layout_seed))


def build_mixed(conf: MixedConf) -> World:
    """The world of the family that the seed chooses."""
    return WORLDS.build(conf.drawn())
