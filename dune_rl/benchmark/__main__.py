"""`python -m dune_rl.benchmark`."""

from dune_rl.benchmark.command_line import main

main()
