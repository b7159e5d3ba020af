"""Measure a policy on numbered episodes: `python -m dune_rl.evaluate checkpoint=runs/NAME episodes=100`."""

from argparse import Namespace

from dune_rl.commands import command_line
from dune_rl.commands.help_page import HelpPage

USAGE = (
    ("python -m dune_rl.evaluate checkpoint=runs/NAME set=inspection-v1", "on an episode set"),
    ("python -m dune_rl.evaluate checkpoint=runs/NAME", "on the world of its run"),
    ("python -m dune_rl.evaluate policy=random +world=flat", "a built-in policy"),
    ("python -m dune_rl.evaluate checkpoint=[A,B] against=go_to_goal", "several, in pairs"),
    ("python -m dune_rl.evaluate resume=FOLDER", "go on where one was cut off"),
    ("python -m dune_rl.evaluate verify=FOLDER", "repeat a sample of its rows"),
)
CLOSING = (
    "A checkpoint brings the settings of its run; what you write changes them. Equal\n"
    "seeds and settings give every policy the same episodes, so that results pair."
)
SETTINGS = (
    ("checkpoint=PATH", "a run's folder, or a file of weights; [A,B] are several"),
    ("policy=NAME", "go_to_goal, planner, mppi, random, FILE.onnx or MODULE:FUNCTION"),
    ("against=NAME", "likewise, to compare with in pairs"),
    ("set=NAME", "an episode set: python -m dune_rl.episode_sets list"),
    ("episodes=N", "how many to run"),
    ("protocol=NAME", "paper or dune_code: runs of 10 minutes, as the paper's"),
    ("runs=N", "with a protocol: how many; run_steps=N, of how many steps each"),
    ("cross_play=true", "each policy among each of populations=[NAME,RUN] of actors"),
    ("seed=N", "of the episodes"),
    ("scenes=N", "episodes side by side in each process"),
    ("processes=N", "processes that share them; no result depends on it"),
    ("steps=true", "a row for each step too; steps=N for each N-th"),
    ("actor_steps=true", "with steps: rows of walkers too"),
    ("out=FOLDER", "of the results; overwrite=true replaces what is there"),
    ("sample=N", "with verify: how many episodes to repeat"),
)


def main() -> None:
    """Run the command line; ends the process."""
    command_line.run_command(
        HelpPage("Measure a policy on numbered episodes.", USAGE, SETTINGS, CLOSING), _main
    )


def _main(parsed: Namespace) -> None:
    # Only now: `--help` shall be there at once.
    from dune_rl.commands.evaluate_job import run

    run(parsed)
