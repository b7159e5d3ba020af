"""The command line."""

import sys
from argparse import Namespace
from typing import Annotated, Any, Literal, cast

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from pydantic import Field

from dune_rl import command
from dune_rl.command import Page
from dune_rl.config.checks import validated
from dune_rl.engine_comparison.agreement import table
from dune_rl.engine_comparison.stability import count
from dune_rl.errors import ConfigError
from dune_rl.physics.interface import ENGINES, Engine
from dune_rl.settings import Settings

Name = Annotated[str, Field(min_length=1)]


class EnginesConf(Settings):
    """What is compared, and for how long."""

    parts: tuple[Literal["agreement", "stability"], ...] = ("agreement", "stability")
    engines: tuple[Engine, ...] = ENGINES
    robots: tuple[Name, ...] = ("rover_zero",)
    places: tuple[Name, ...] = ("flat", "slope", "inspection")
    worlds: tuple[Name, ...] = ("flat", "inspection", "construction", "rubicon", "island")
    minutes: float = Field(10.0, gt=0.0)
    scenes: int = Field(8, ge=1)
    seed: int = Field(0, ge=0)


PAGE = Page(
    "Set the physics engines side by side; tables in Markdown.",
    (
        ("python -m dune_rl.engines", "the same commands in both, then minutes of random driving"),
        ("python -m dune_rl.engines parts=[stability] minutes=1", "a shorter part of it"),
    ),
    (
        ("parts=[agreement]", "agreement, stability"),
        ("engines=[bullet,dart]", "whose stability is counted"),
        ("robots=[rover_zero]", "any of the options of robot"),
        (
            "places=[flat,slope,inspection]",
            "where they are compared: worlds, and slope, a plane of 15 degrees",
        ),
        ("worlds=[flat]", "where stability is counted"),
        ("minutes=N", "of simulated time in each world, over all scenes"),
        ("scenes=N", "driven side by side"),
        ("seed=N", "of starts and random commands"),
    ),
    "The same settings give the same tables.",
)


def main() -> None:
    """Run the command line; ends the process."""
    command.run(PAGE, _main)


def _main(parsed: Namespace) -> None:
    conf = settings(parsed.overrides)
    if "agreement" in conf.parts:
        for robot in conf.robots:
            _say(f"\n### {robot}\n\n{table(robot, conf.places, conf.scenes, conf.seed)}")
    if "stability" in conf.parts:
        heads = "minutes | episodes | not finite | fallen | jumps | diverged | fast | fastest"
        _say(f"\n| robot | world | engine | {heads} |")
        _say("|---|---|---|---|---|---|---|---|---|---|---|")
        for robot in conf.robots:
            for world in conf.worlds:
                for engine in conf.engines:
                    found = count(world, engine, robot, conf.minutes, conf.scenes, conf.seed)
                    _say(
                        f"| {robot} | {world} | {engine} | {found.minutes:g} | {found.episodes} "
                        f"| {found.nan} | {found.fallen} | {found.jumps} | {found.diverged} "
                        f"| {found.fast} | {found.fastest_mps:.2f} m/s |"
                    )


def settings(words: list[str]) -> EnginesConf:
    """The settings that the words of a command line say; `ConfigError` where they say something else."""
    try:
        data = OmegaConf.to_object(OmegaConf.from_dotlist(words))
    except (OmegaConfBaseException, ValueError) as error:
        raise ConfigError(f"{error}\nsee python -m dune_rl.engines --help") from error
    return validated(EnginesConf, cast("dict[str, Any]", data))


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()
