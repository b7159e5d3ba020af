"""What `python -m dune_rl.benchmark` does: measure each of the parts, and print a JSON line for it."""

import json
import sys
from collections.abc import Sequence
from typing import Any

from dune_rl.commands import command_line
from dune_rl.commands.benchmark.comparisons import (
    measure_actors,
    measure_engines,
    measure_groups,
    measure_terrain,
)
from dune_rl.commands.benchmark.environment import measure_environment, measure_overhead, measure_processes
from dune_rl.commands.benchmark.new_worlds import measure_new_world, measure_world_memory
from dune_rl.commands.benchmark.sensors import measure_sensors
from dune_rl.config.compose import compose_benchmark


def run(words: Sequence[str]) -> None:
    """Measure what the command line says."""
    parsed = command_line.parse_arguments(words)
    conf = compose_benchmark(parsed.overrides, command_line.config_folders(parsed))
    groups = {group.name: group.count for group in conf.groups}
    setting = {"world": conf.world.name, "groups": groups}
    if "environment" in conf.parts:
        _emit(benchmark="environment", **setting, **measure_environment(conf))
    if "cameras" in conf.parts:
        colour, depth = (measure_overhead(conf, (output,)) for output in ("rgb", "depth"))
        _emit(
            benchmark="cameras",
            **setting,
            overhead_ratio_camera=colour["overhead_ratio"],
            overhead_ratio_depth=depth["overhead_ratio"],
            camera_steps_per_s=colour["core_steps_per_s"],
            depth_steps_per_s=depth["core_steps_per_s"],
        )
    if "sensors" in conf.parts:
        _emit(benchmark="sensors", **setting, **measure_sensors(conf))
    if "terrain" in conf.parts:
        _emit(benchmark="terrain", world=conf.world.name, **measure_terrain(conf))
    if "new_world" in conf.parts:
        _emit(benchmark="new_world", **setting, **measure_new_world(conf))
    if "world_memory" in conf.parts:
        engine = conf.physics.backend
        _emit(benchmark="world_memory", **setting, engine=engine, **measure_world_memory(conf))
    if "groups" in conf.parts:
        _emit(benchmark="groups", world=conf.world.name, **measure_groups(conf))
    if "actors" in conf.parts:
        _emit(benchmark="actors", world=conf.world.name, **measure_actors(conf))
    if "engines" in conf.parts:
        _emit(benchmark="engines", **setting, **measure_engines(conf))
    if "processes" in conf.parts:
        for processes in conf.processes:
            _emit(benchmark="processes", world=conf.world.name, **measure_processes(conf, processes))


def _emit(**values: Any) -> None:
    sys.stdout.write(json.dumps(values) + "\n")
    sys.stdout.flush()


main = command_line.command("benchmark")
