"""`python -m dune_rl.forecast`: learn where the agents will be that a robot tracks."""

from dune_rl.commands.command_line import command

main = command("forecast")

if __name__ == "__main__":
    main()
