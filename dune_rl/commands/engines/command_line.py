"""The command line of `python -m dune_rl.engines`."""

from argparse import Namespace

from dune_rl.commands import command_line
from dune_rl.commands.help_page import HelpPage

PAGE = HelpPage(
    "Compare the physics engines; Markdown tables.",
    (
        ("python -m dune_rl.engines", "equal commands in both, then minutes of random driving"),
        ("python -m dune_rl.engines parts=[stability] minutes=1", "one part, shorter"),
    ),
    (
        ("parts=[agreement]", "agreement, stability"),
        ("engines=[bullet,dart]", "engines of the part stability"),
        ("robots=[rover_zero]", "options of robot"),
        (
            "places=[flat,slope,inspection]",
            "worlds of the part agreement; slope is a plane of 15 degrees",
        ),
        ("worlds=[flat]", "worlds of the part stability"),
        ("minutes=N", "simulated time in each world, over all scenes"),
        ("scenes=N", "scenes stepped together"),
        ("seed=N", "seed of starts and random commands"),
    ),
    "Equal settings give equal tables.",
)


def main() -> None:
    """Run the command line; ends the process."""
    command_line.run_command(PAGE, _main)


def _main(parsed: Namespace) -> None:
    # Only now: `--help` shall be there at once.
    from dune_rl.commands.engines.job import run

    run(parsed)
