"""`python -m dune_rl.view`."""

from dune_rl.view.command_line import main

main()
