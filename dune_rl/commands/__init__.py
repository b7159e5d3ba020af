"""The command lines, `python -m dune_rl.NAME`: one module each, and what they share."""
