"""Cost of every part: `python -m dune_rl.benchmark` prints JSON lines.

All ratios come from one run on one core, in rounds that alternate between what
is compared, so that a noisy machine disturbs all of it alike.
"""

from dune_rl.commands.benchmark.job import main, run

__all__ = ["main", "run"]
