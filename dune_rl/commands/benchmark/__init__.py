"""Cost of every part of a step: `python -m dune_rl.benchmark` prints a JSON line for each part.

All ratios come from one run on one core, in rounds that alternate between what is compared, so that a noisy
machine disturbs all of it alike.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from dune_rl.commands import command_line
from dune_rl.config.commands import BenchmarkConf
from dune_rl.config.compose import compose

# Parts that replace the agent groups of the settings, or have none.
_WITHOUT_GROUPS = ("terrain", "groups", "actors", "processes", "learning", "films")


def run(words: Sequence[str]) -> None:
    parsed = command_line.parse_arguments(words)
    conf = compose(BenchmarkConf, parsed.overrides, command_line.config_folders(parsed))
    # A wrong setting is refused before all that is measured is loaded, which takes seconds.
    from dune_rl.commands.benchmark import parts
    from dune_rl.commands.benchmark.films import measure_films
    from dune_rl.commands.benchmark.learning import measure_learning
    from dune_rl.commands.benchmark.sensors import measure_sensors
    from dune_rl.commands.benchmark.sizes import measure_sizes

    measures: Mapping[str, Callable[[BenchmarkConf], Mapping[str, Any]]] = {
        "environment": parts.measure_environment,
        "cameras": parts.measure_cameras,
        "sensors": measure_sensors,
        "terrain": parts.measure_terrain,
        "new_world": parts.measure_new_world,
        "world_memory": parts.measure_world_memory,
        "groups": parts.measure_groups,
        "actors": parts.measure_actors,
        "engines": parts.measure_engines,
        "sizes": measure_sizes,
        "films": measure_films,
    }
    for part, measure in measures.items():
        if part in conf.parts:
            _emit(part, conf, measure(conf))
    for processes in conf.processes if "processes" in conf.parts else ():
        _emit("processes", conf, parts.measure_processes(conf, processes))
    for algorithm in conf.algorithms if "learning" in conf.parts else ():
        _emit("learning", conf, measure_learning(conf, algorithm))


def _emit(part: str, conf: BenchmarkConf, found: Mapping[str, Any]) -> None:
    counts = {group.name: group.count for group in conf.groups}
    groups = {} if part in _WITHOUT_GROUPS else {"groups": counts}
    print(json.dumps({"benchmark": part, "world": conf.world.name, **groups, **found}), flush=True)
