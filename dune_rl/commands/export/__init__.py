"""`python -m dune_rl.export`: a policy as an ONNX file, or a world, its actors and robots for Gazebo."""

from collections.abc import Sequence
from typing import Literal

from dune_rl.commands import command_line
from dune_rl.core.errors import ConfigError
from dune_rl.core.suggestions import closest
from dune_rl.core.untrusted_files import printable

Subject = Literal["policy", "world", "robot"]
# What words name a subject of an export.
_NAMED_BY: dict[str, Subject] = {
    "checkpoint": "policy",
    "world": "world",
    "scenario": "world",
    "robot": "robot",
    "robots": "robot",
    "agents": "robot",
}


def run(words: Sequence[str]) -> None:
    """Write what the command line asks for; raises ConfigError where it cannot be."""
    parsed = command_line.parse_arguments(words)
    subjects = subjects_of(parsed.overrides)
    # Only now: each loads seconds' worth of what the other does without.
    if "policy" in subjects:
        from dune_rl.commands.export import policy

        conf = policy.parse_words(parsed.overrides)
        if parsed.cfg:
            command_line.print_settings(conf)
        else:
            policy.export_policy(conf)
    else:
        from dune_rl.commands.export import gazebo

        scene = gazebo.compose_words(parsed)
        if parsed.cfg:
            command_line.print_settings(scene)
        else:
            gazebo.export_scene(scene, with_world="world" in subjects, with_robots="robot" in subjects)


def subjects_of(overrides: Sequence[str]) -> set[Subject]:
    """What is exported: a policy, or a world, robots or both; raises ConfigError for anything else."""
    keys = [word.partition("=")[0].lstrip("+").partition(".")[0] for word in overrides]
    subjects = {_NAMED_BY[key] for key in keys if key in _NAMED_BY}
    if not subjects:
        for key in keys:
            if meant := closest(key, _NAMED_BY):
                raise ConfigError(f"{printable(key)} is not a setting; did you mean {meant}?")
        raise ConfigError(
            "choose what to export: checkpoint=PATH out=FILE.onnx, world=NAME out=FOLDER, or robot=NAME "
            "out=FOLDER"
        )
    if "policy" in subjects and len(subjects) > 1:
        raise ConfigError("a policy is exported apart: leave out checkpoint=PATH, or the world and the robot")
    return subjects
