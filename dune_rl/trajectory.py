"""`python -m dune_rl.trajectory`: an actor's way through way-points."""

from dune_rl.commands.command_line import command

main = command("trajectory")

if __name__ == "__main__":
    main()
