"""The command line of `python -m dune_rl.benchmark`."""

from argparse import Namespace

from dune_rl.commands import command_line
from dune_rl.commands.help_page import HelpPage

USAGE = (
    ("python -m dune_rl.benchmark", "inspection, two walkers"),
    ("python -m dune_rl.benchmark world=flat actors=none", "another environment"),
    ("python -m dune_rl.benchmark parts=[groups]", "four robots against one"),
)
SETTINGS = (
    ("scenes=N", "scenes stepped as one batch"),
    ("rounds=N", "rounds in which everything compared takes its turn"),
    ("steps=N", "control steps of every scene in a turn"),
    (
        "parts=[environment]",
        "environment, cameras, sensors, terrain, new_world, world_memory, groups, processes, engines",
    ),
    ("worlds=N", "new worlds that the part world_memory enters"),
    ("processes=[1,2]", "numbers of processes at once, one after the other"),
)
CLOSING = "Ratios compare times of one run, so they hold on a busy machine, too."


def main() -> None:
    """Run the command line; ends the process."""
    command_line.run_command(
        HelpPage("Measure the cost of a step; JSON lines.", USAGE, SETTINGS, CLOSING), _main
    )


def _main(parsed: Namespace) -> None:
    # Only now: `--help` shall be there at once.
    from dune_rl.commands.benchmark.job import run

    run(parsed)
