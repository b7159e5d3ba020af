"""`python -m dune_rl.ros`: a scene on live topics of ROS 2, without ROS."""

import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from dune_rl.commands import command_line
from dune_rl.config.commands import RosConf
from dune_rl.config.compose import compose, override_value
from dune_rl.config.endless import without_ends
from dune_rl.learning.checkpoint import read_policy_file
from dune_rl.ros.dds_types import require_live_topics


def run(words: Sequence[str]) -> None:
    """Run the scene that the command line asks for, until it is interrupted."""
    parsed = command_line.parse_arguments(words)
    checkpoint = override_value(parsed.overrides, "checkpoint")
    saved = None if checkpoint is None else read_policy_file(Path(str(checkpoint)))[1]["config"]
    conf = compose(RosConf, parsed.overrides, command_line.config_folders(parsed), saved)
    if parsed.cfg:
        command_line.print_settings(conf)
        return
    require_live_topics()
    # Only now, since loading the physics engine takes seconds.
    from dune_rl.config.build import make_simulation
    from dune_rl.learning.process import stop_on_signals
    from dune_rl.ros.dds import Participant
    from dune_rl.ros.live_scene import LiveScene

    console = command_line.make_console()
    report = partial(command_line.print_line, console)
    participant = Participant(conf)
    simulation = None
    try:
        simulation = make_simulation(without_ends(conf), 1, conf.seed)
        simulation.reseed(conf.seed, conf.episode)
        tasks = {group.name: group.task for group in conf.external_groups}
        command_line.print_world_notes(console, conf)
        scene = LiveScene(simulation, tasks, participant, conf, report)
        report(f"Topics in {conf.where}; Ctrl-C ends")
        # Exceptions of signals would be lost in the code in C that calls Python for each message.
        with stop_on_signals() as stop:
            report(str(scene.run(stop)))
        if stop.signal is not None:
            sys.exit(128 + stop.signal)
    finally:
        if simulation is not None:
            simulation.close()
        participant.close()
