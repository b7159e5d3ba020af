"""Renders a world, its agents and their sensors: `python -m dune_rl.view +world=inspection`."""

from dune_rl.view.command_line import main

__all__ = ["main"]
