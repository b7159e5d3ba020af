"""Bases of the settings of worlds."""

from typing import ClassVar, Literal

from pydantic import Field

from dune_rl.core.settings import Settings
from dune_rl.worlds.surfaces import SurfaceChoice


class WorldSettings(Settings):
    """Settings of a world; `name` selects the settings class when a file is read.

    `disk_cached` says what the disk cache keeps: the world and its appearance (baked light and textures),
    the appearance alone, or nothing. Users' worlds are not kept, because a change of their code would not be
    noticed.
    """

    disk_cached: ClassVar[Literal["world", "appearance", "nothing"]] = "nothing"
    name: str

    @property
    def common_extent(self) -> tuple[float, float, float, float] | None:
        """Rectangle (xmin, xmax, ymin, ymax) [m] that holds the worlds of all seeds, if these differ in size.

        None: all are as large as any of them.
        """
        return None

    def drawn(self) -> "WorldSettings":
        """The settings of the world that these settings choose: these, unless they are of a mixture."""
        return self


class SeededConf(WorldSettings):
    """Seed of a world's terrain and props; `layout_seed` replaces it for the props."""

    disk_cached: ClassVar[Literal["world", "appearance", "nothing"]] = "world"
    seed: int = Field(default=0, ge=0, lt=2**32)
    layout_seed: int | None = Field(
        default=None, ge=0, lt=2**32, description="seed of the props' layout alone; null: the seed"
    )

    @property
    def layout(self) -> int:
        """The seed of the props' layout."""
        return self.seed if self.layout_seed is None else self.layout_seed


class SurfacedConf(WorldSettings):
    """The ground's friction, or its surfaces."""

    friction: float = Field(default=1.0, gt=0.0, le=5.0)
    surfaces: SurfaceChoice = "uniform"
    sinkage: bool = Field(default=False, description="wheels sink in soft surfaces")


class GrassyConf(SurfacedConf):
    """Tall grass on the ground, and its surfaces."""

    grass_cover: float = Field(default=0.0, ge=0.0, le=1.0, description="share of the land in tall grass")
    grass_height_m: float = Field(default=0.6, gt=0.0, le=3.0)
