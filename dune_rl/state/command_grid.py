"""The grid of commands, of speed and relative heading, among which a driver chooses."""

import numpy as np
from pydantic import Field, field_validator

from dune_rl.core.settings import Settings
from dune_rl.geometry.arrays import Array


class CommandGridConf(Settings):
    """Grid of commands: every speed with every relative heading, which are closer together near 0."""

    speeds: int = Field(8, ge=1, le=64, description="forward speeds beside 0, evenly spaced")
    reverse_speeds: int = Field(4, ge=0, le=64, description="evenly spaced, where the body can reverse")
    headings: int = Field(15, ge=3, le=65, description="an odd number, as 0 is one of them")
    max_heading_rad: float = Field(1.0, gt=0.0, le=3.15, description="largest relative heading [rad]")

    @field_validator("headings")
    @classmethod
    def _odd(cls, value: int) -> int:
        if value % 2 == 0:
            raise ValueError(f"must be odd, as the heading 0 is one of them (got {value})")
        return value


def command_grid(conf: CommandGridConf, slowest_mps: float, fastest_mps: float) -> Array:
    """The commands (C, 2), speed [m/s] and relative heading [rad], of a body with these limits of its speed.

    Speeds rise from the slowest, which is negative where the body can reverse, and headings with them.
    """
    forward = np.linspace(0.0, fastest_mps, conf.speeds + 1)
    backward = np.linspace(slowest_mps, 0.0, conf.reverse_speeds + 1)[:-1]
    speeds = np.concatenate([backward[backward < 0.0], forward])
    # 0 exactly in the middle: straight on.
    share = (np.arange(conf.headings) - conf.headings // 2) / (conf.headings // 2)
    headings = conf.max_heading_rad * share * np.abs(share)
    return np.stack(np.meshgrid(speeds, headings, indexing="ij"), axis=-1).reshape(-1, 2)
