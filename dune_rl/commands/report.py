"""Make a report of runs and evaluations: `python -m dune_rl.report runs/NAME evaluations/NAME`."""

from argparse import Namespace

from dune_rl.commands import command_line
from dune_rl.commands.help_page import HelpPage

PAGE = HelpPage(
    "Make a report of training runs, evaluations and sweeps: a page, figures and tables.",
    (
        ("python -m dune_rl.report runs/A evaluations/B", "of these folders"),
        ("python -m dune_rl.report evaluations", "of all folders in it"),
        ("python -m dune_rl.report runs/sweep_NAME", "of a sweep"),
        ("python -m dune_rl.report into=README.md", "the tables that a Markdown file asks for"),
    ),
    (
        ("out=FOLDER", "of the report; else reports/DATE_NAMES"),
        ("overwrite=true", "replaces the report that is there"),
        ("title=TEXT", "of the page"),
        ("failures=N", "episodes at most that are run again for pictures of how they failed; 0: none"),
        ("into=FILE.md", "the file whose tables are written anew, in place of a report"),
    ),
    "The page is one file that needs no network. What cannot be used is named there, and left out.",
    options=False,
)


def main() -> None:
    """Run the command line; ends the process."""
    command_line.run_command(PAGE, _main)


def _main(parsed: Namespace) -> None:
    # Only now: `--help` shall be there at once.
    from dune_rl.commands.report_job import run

    run(parsed)
