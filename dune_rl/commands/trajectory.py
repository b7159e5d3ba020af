"""Plan the trajectory of an actor: `python -m dune_rl.trajectory world=NAME waypoints=... out=actor.sdf`."""

from argparse import Namespace

from dune_rl.commands import command_line
from dune_rl.commands.help_page import HelpPage

PAGE = HelpPage(
    "Plan the trajectory of an actor through way-points on a world's ground, and write it to a file.",
    (
        ('python -m dune_rl.trajectory world=NAME waypoints="[[0,0],[4,2]]" out=actor.sdf', "for Gazebo"),
        ('python -m dune_rl.trajectory world=FILE.dae waypoints="[[0,0],[4,2]]" out=actor.csv', "of a file"),
    ),
    (
        (
            "world=NAME",
            "an option, with its settings world.SETTING=VALUE; or a file (SDF, mesh, map of heights)",
        ),
        ("waypoints=[[X,Y],...]", "two or more [m]; a cubic spline leads through them"),
        ("out=FILE", "an SDF <actor> (.sdf), .csv or .json"),
        ("velocity=V", "along the ground [m/s]; else 1"),
        ("mode=MODE", "back_and_forth (default), loop (a closed way) or once"),
        ("pauses_s=S", "at every way-point, or [S,S,...] at each [s]"),
        ("delay_s=S", "before the start of each round [s]"),
        ("spacing_m=M", "between the poses [m]; else 0.05"),
        ("radius_m=M", "the least distance from obstacles [m]; else 0.25"),
        ("max_slope_deg=A", "the steepest ground [degrees]; else 35"),
        ("max_water_m=M", "the deepest water [m]; else 0"),
        ("name=NAME", "of the actor; else walker"),
        ("skin=FILE", "of an SDF: the mesh that Gazebo draws; else its walking actor"),
        ("animation=FILE", "likewise the motion; else the skin's"),
        ("origin_height_m=M", "likewise of the mesh's origin above its feet [m]"),
        ("picture=FILE.png", "of the way on the map; else beside out"),
        ("overwrite=true", "replaces the files that are there"),
    ),
    "Way-points and stretches between them that cannot be walked are named, and nothing is written.",
    options=False,
)


def main() -> None:
    """Run the command line; ends the process."""
    command_line.run_command(PAGE, _main)


def _main(parsed: Namespace) -> None:
    # Only now: `--help` shall be there at once.
    from dune_rl.commands.trajectory_job import run

    run(parsed)
