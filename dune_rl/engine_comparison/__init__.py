"""What the two physics engines make of the same robot: `python -m dune_rl.engines` prints tables.

`agreement` plays the same commands in both and sets what comes of them side by
side; `stability` drives at random for minutes and counts what must not be.
"""

from dune_rl.engine_comparison.command_line import main

__all__ = ["main"]
