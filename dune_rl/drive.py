"""`python -m dune_rl.drive`: a policy drives a robot over live topics, or a bag is played into it."""

from dune_rl.commands.command_line import command

main = command("drive")

if __name__ == "__main__":
    main()
