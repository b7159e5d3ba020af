"""A mixture of world families: the seed chooses the family and the site."""

from typing import Annotated, ClassVar, Literal

from pydantic import BeforeValidator, Field, SerializeAsAny

from dune_rl.worlds.registry import WORLDS
from dune_rl.worlds.settings import SeededConf, WorldSettings
from dune_rl.worlds.world import Rectangle, World


def _parse(value: object) -> WorldSettings:
    return WORLDS.parse_settings({"name": value} if isinstance(value, str) else value)


Member = Annotated[SerializeAsAny[WorldSettings], BeforeValidator(_parse)]


class MixedConf(SeededConf):
    """Settings of `build_mixed`: seed s has the site s of the family number s modulo their count.

    Readings that are bounded by the world's size have the bounds of a square of `size_m`.
    """

    # Its members are cached, each by itself.
    disk_cached: ClassVar[Literal["world", "appearance", "nothing"]] = "nothing"
    name: Literal["mixed"] = "mixed"
    families: tuple[Member, ...] = Field(
        default=("flat", "inspection", "construction", "rubicon", "island", "obstacle_course"),
        min_length=1,
        max_length=100,
        validate_default=True,
        description="worlds by name or with settings; one that is named twice is drawn twice as often",
    )
    size_m: float = Field(default=100.0, gt=0.0, le=10_000.0, description="of a square that holds them all")

    @property
    def common_extent(self) -> Rectangle:
        """The square of `size_m` round the origin."""
        half = self.size_m / 2
        return -half, half, -half, half

    def drawn(self) -> WorldSettings:
        """The settings of the family that the seed chooses, with that seed."""
        family = self.families[self.seed % len(self.families)].drawn()
        changes = {"seed": self.seed, "layout_seed": self.layout_seed}
        own = {name: value for name, value in changes.items() if name in type(family).model_fields}
        return family.model_copy(update=own)


def build_mixed(conf: MixedConf) -> World:
    """The world of the family that the seed chooses."""
    return WORLDS.build(conf.drawn())
