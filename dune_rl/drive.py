"""`python -m dune_rl.drive`: play a bag into a policy."""

from dune_rl.commands.command_line import command

main = command("drive")

if __name__ == "__main__":
    main()
