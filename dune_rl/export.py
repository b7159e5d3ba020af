"""`python -m dune_rl.export`: a trained policy as an ONNX file, or a scene for Gazebo."""

from dune_rl.commands.command_line import command

main = command("export")

if __name__ == "__main__":
    main()
