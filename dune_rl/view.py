"""`python -m dune_rl.view`: pictures, films and maps."""

from dune_rl.commands.command_line import command

main = command("view")

if __name__ == "__main__":
    main()
