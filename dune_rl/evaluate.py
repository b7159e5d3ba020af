"""Measure a policy on numbered episodes: `python -m dune_rl.evaluate checkpoint=runs/NAME episodes=100`."""

from argparse import Namespace

from dune_rl import command
from dune_rl.help_page import HelpPage

USAGE = (
    ("python -m dune_rl.evaluate checkpoint=runs/NAME", "a trained policy"),
    ("python -m dune_rl.evaluate policy=random +world=flat", "a built-in one"),
    ("python -m dune_rl.evaluate checkpoint=RUN against=random", "two, in pairs"),
)
CLOSING = (
    "A checkpoint brings the settings of its run; what you write changes them. Equal\n"
    "seeds and settings give every policy the same episodes, so that results pair."
)
SETTINGS = (
    ("checkpoint=PATH", "a run's folder, or a file of weights"),
    ("policy=NAME", "go_to_goal, planner, mppi or random, instead of a checkpoint"),
    ("against=NAME", "a built-in policy to compare with, in pairs"),
    ("episodes=N", "how many to run"),
    ("seed=N", "of the episodes"),
    ("scenes=N", "episodes side by side; no result depends on it"),
    ("out=FILE", "CSV with a row for each episode"),
)


def main() -> None:
    """Run the command line; ends the process."""
    command.run_command(HelpPage("Measure a policy on numbered episodes.", USAGE, SETTINGS, CLOSING), _main)


def _main(parsed: Namespace) -> None:
    # Only now: `--help` shall be there at once.
    from dune_rl.evaluate_job import run

    run(parsed)


if __name__ == "__main__":
    main()
