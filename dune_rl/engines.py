"""`python -m dune_rl.engines`."""

from dune_rl.engine_comparison.command_line import main

main()
