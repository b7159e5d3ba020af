"""`python -m dune_rl.episode_sets`: list, make and check episode sets."""

from dune_rl.commands.command_line import command

main = command("episode_sets")

if __name__ == "__main__":
    main()
