"""What everything costs: `python -m dune_rl.benchmark` prints JSON lines.

All ratios come from one run on one core, in rounds that alternate between the
things compared, so that a noisy machine disturbs them alike.
"""

from dune_rl.benchmark.command_line import main

__all__ = ["main"]
