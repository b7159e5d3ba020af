"""Settings common to all worlds that are generated from a seed."""

from pydantic import Field

from dune_rl.worlds.settings import WorldSettings


class SeededConf(WorldSettings):
    """Seed of a world's terrain and props; `layout_seed` replaces it for the props."""

    seed: int = Field(default=0, ge=0, lt=2**32)
    layout_seed: int | None = Field(
        default=None, ge=0, lt=2**32, description="seed of the props' layout alone; null: the seed"
    )

    @property
    def layout(self) -> int:
        """The seed of the props' layout."""
        return self.seed if self.layout_seed is None else self.layout_seed
