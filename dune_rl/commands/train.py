"""Train a rover: `python -m dune_rl.train +world=inspection`."""

from argparse import Namespace

from dune_rl.commands import command_line
from dune_rl.commands.help_page import HelpPage

USAGE = (
    ("python -m dune_rl.train +world=inspection", "train; settings follow"),
    ("python -m dune_rl.train +experiment=quick", "a taste: some minutes"),
    ("python -m dune_rl.train resume=runs/NAME", "go on with a run"),
    ("python -m dune_rl.train -m +world=flat seed=1,2", "a sweep: a folder a job"),
)
CLOSING = (
    "conf/ holds every setting with its meaning and unit. To see what a command would\n"
    "use, add --cfg job. Own options go in a folder of the same shape as conf/:\n"
    "--config-dir FOLDER. docs/ has the rest."
)
SETTINGS = (
    ("+experiment=NAME", "a study's settings in one word"),
    ("seed=N", "of everything drawn at random"),
    ("total_frames=N", "control steps in all"),
    ("device=cpu|cuda", "of the learner"),
    ("run_dir=FOLDER", "folder of the run"),
    ("task.terminations.time_limit.max_steps=N", "length of an episode"),
    ("learning.collector.workers=N", "processes that step environments"),
    ("learning.collector.scenes=N", "scenes in each process"),
    ("learning.batch_size=N", "transitions in an update"),
)


def main() -> None:
    """Run the command line; ends the process."""
    command_line.run_command(
        HelpPage("Train a rover to drive to goals off the road.", USAGE, SETTINGS, CLOSING),
        _main,
        sweeps=True,
    )


def _main(parsed: Namespace) -> None:
    # Only now: `--help` shall be there at once, and collectors' processes, which import this module too, need
    # neither Hydra nor the settings.
    from dune_rl.commands.train_job import run

    run(parsed)
