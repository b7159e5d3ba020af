"""Comparison of the physics engines on equal robots: `python -m dune_rl.engines` prints tables.

`agreement` gives both the same commands and compares the results; `stability`
drives at random for minutes and counts faults.
"""

from dune_rl.commands.engines.job import main, run

__all__ = ["main", "run"]
