"""`python -m dune_rl.engines`: compare the two physics engines."""

from dune_rl.commands.command_line import command

main = command("engines")

if __name__ == "__main__":
    main()
