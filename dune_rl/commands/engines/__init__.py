"""Comparison of the physics engines on equal robots: `python -m dune_rl.engines` prints tables.

`agreement` gives both the same commands and compares the results; `stability` drives at random for minutes
and counts faults.
"""

from collections.abc import Sequence
from typing import Annotated, Any, Literal, cast

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from pydantic import Field

from dune_rl.commands import command_line
from dune_rl.commands.engines.agreement import agreement_tables
from dune_rl.commands.engines.stability import count_faults
from dune_rl.config.checks import validate
from dune_rl.core.errors import ConfigError
from dune_rl.core.settings import Settings
from dune_rl.physics.interface import OWN_ENGINES, Engine

Name = Annotated[str, Field(min_length=1)]


class EnginesConf(Settings):
    parts: tuple[Literal["agreement", "stability"], ...] = ("agreement", "stability")
    engines: tuple[Engine, ...] = OWN_ENGINES
    robots: tuple[Name, ...] = ("rover_zero",)
    places: tuple[Name, ...] = ("flat", "slope", "inspection")
    worlds: tuple[Name, ...] = ("flat", "inspection", "construction", "rubicon", "island")
    minutes: float = Field(10.0, gt=0.0)
    scenes: int = Field(8, ge=1)
    seed: int = Field(0, ge=0)


def run(words: Sequence[str]) -> None:
    parsed = command_line.parse_arguments(words)
    conf = parse_settings(parsed.overrides)
    if "agreement" in conf.parts:
        for robot in conf.robots:
            print(f"\n### {robot}\n\n{agreement_tables(robot, conf.places, conf.scenes, conf.seed)}")
    if "stability" in conf.parts:
        heads = "minutes | episodes | not finite | fallen | jumps | diverged | fast | fastest"
        print(f"\n| robot | world | engine | {heads} |")
        print("|---|---|---|---|---|---|---|---|---|---|---|")
        for robot in conf.robots:
            for world in conf.worlds:
                for engine in conf.engines:
                    counts = count_faults(world, engine, robot, conf.minutes, conf.scenes, conf.seed)
                    print(
                        f"| {robot} | {world} | {engine} | {counts.minutes:g} | {counts.episodes} "
                        f"| {counts.nan} | {counts.fallen} | {counts.jumps} | {counts.diverged} "
                        f"| {counts.fast} | {counts.fastest_mps:.2f} m/s |"
                    )


def parse_settings(words: list[str]) -> EnginesConf:
    """Settings from the words of a command line; `ConfigError` where they are not valid."""
    try:
        data = OmegaConf.to_object(OmegaConf.from_dotlist(words))
    except (OmegaConfBaseException, ValueError) as error:
        raise ConfigError(f"{error}\nsee python -m dune_rl.engines --help") from error
    return validate(EnginesConf, cast("dict[str, Any]", data))
