"""`python -m dune_rl.engines`."""

from dune_rl.engines.command_line import main

main()
