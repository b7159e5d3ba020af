"""Settings that all worlds made from a seed have."""

from pydantic import Field

from dune_rl.worlds.settings import WorldSettings


class SeededConf(WorldSettings):
    """The seed of a world; with a `layout_seed`, what stands on its ground is drawn from that."""

    seed: int = Field(default=0, ge=0, lt=2**32)
    layout_seed: int | None = Field(
        default=None, ge=0, lt=2**32, description="of what stands there alone; null: the seed"
    )

    @property
    def layout(self) -> int:
        """The seed of what stands there."""
        return self.seed if self.layout_seed is None else self.layout_seed
