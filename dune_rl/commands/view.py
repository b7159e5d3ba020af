"""The command line of `python -m dune_rl.view`."""

from argparse import Namespace

from dune_rl.commands import command_line
from dune_rl.commands.help_page import HelpPage

USAGE = (
    ("python -m dune_rl.view +world=inspection", "a contact sheet and a video"),
    ("python -m dune_rl.view +world=inspection view=orbit", "the world from above"),
    ("python -m dune_rl.view +world=inspection view=map", "its map"),
    ("python -m dune_rl.view checkpoint=runs/NAME view=video", "a video of a trained policy"),
    ("python -m dune_rl.view checkpoint=runs/NAME view=map", "its tracks on the map"),
)
CLOSING = "No display and no GPU are needed: the processor renders the pictures."
SETTINGS = (
    ("view=NAME", "sheet, video, both, orbit or map"),
    ("checkpoint=PATH", "folder of a run, or file of weights, of the policy"),
    ("policy=NAME", "go_to_goal, planner, mppi or random, instead of a checkpoint"),
    ("agent=NAME", "agent to follow, such as rover_1; default: the first"),
    ("seed=N", "seed of the episode"),
    ("longest_s=S", "largest length of the video"),
    ("width=N height=N", "size of the video"),
    ("episodes=N", "number of episodes on the map"),
    ("out=FOLDER", "folder of the files"),
)


def main() -> None:
    """Run the command line; ends the process."""
    command_line.run_command(
        HelpPage("Render a world, its agents and their sensors.", USAGE, SETTINGS, CLOSING), _main
    )


def _main(parsed: Namespace) -> None:
    # Only now: `--help` shall be there at once.
    from dune_rl.commands.view_job import run

    run(parsed)
