"""`python -m dune_rl.doctor`: does this machine have what is needed, and compute what others do?"""

from dune_rl.commands.command_line import command

main = command("doctor")

if __name__ == "__main__":
    main()
