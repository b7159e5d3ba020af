"""`python -m dune_rl.train`: train a robot."""

from dune_rl.commands.command_line import command

main = command("train")

if __name__ == "__main__":
    main()
