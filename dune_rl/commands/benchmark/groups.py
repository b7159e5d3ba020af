"""Cost of a group of four equal robots in a scene, compared with one robot."""

from typing import Any

import numpy as np
import torch

from dune_rl.commands.benchmark.steppers import core_stepper
from dune_rl.commands.benchmark.timing import median_ratio, time_calls, time_in_turns
from dune_rl.config.build import make_simulation
from dune_rl.config.commands import BenchmarkConf
from dune_rl.config.schema import EnvConf

_ROBOTS = 4
_WARM_UP = 50


def measure_groups(conf: BenchmarkConf) -> dict[str, Any]:
    """Overhead of four equal robots per scene, as a ratio to that of one robot in the same world.

    Overhead is the time of a control step beyond that of its bare physics:
    sensors, control, rewards, resets and bookkeeping. The robot is the one of
    the first external group; the scenes have no other agents.
    """
    torch.set_num_threads(1)
    simulations = {
        count: make_simulation(_with_robots(conf, count), conf.scenes, conf.seed) for count in (1, _ROBOTS)
    }
    steps = {}
    for count, simulation in simulations.items():
        simulation.reset()
        steps[f"core {count}"] = core_stepper(simulation), conf.steps
        steps[f"raw {count}"] = simulation.step_passive, conf.steps
    for step, _ in steps.values():
        time_calls(step, _WARM_UP)
    times = {name: np.array(values) for name, values in time_in_turns(steps, conf.rounds).items()}
    for simulation in simulations.values():
        simulation.close()
    overhead = {count: times[f"core {count}"] - times[f"raw {count}"] for count in simulations}
    per_agent = {count: np.median(times[f"core {count}"]) / (conf.scenes * count) for count in simulations}
    return {
        "scenes": conf.scenes,
        "four_robots_overhead_ratio": float(np.median(overhead[_ROBOTS]) / np.median(overhead[1])),
        "one_robot_overhead_us": float(np.median(overhead[1])) / conf.scenes * 1e6,
        "four_robots_overhead_us": float(np.median(overhead[_ROBOTS])) / conf.scenes * 1e6,
        "one_robot_core_ratio": median_ratio(times["core 1"].tolist(), times["raw 1"].tolist()),
        "four_robots_core_ratio": median_ratio(
            times[f"core {_ROBOTS}"].tolist(), times[f"raw {_ROBOTS}"].tolist()
        ),
        "one_robot_agent_steps_per_s": float(1.0 / per_agent[1]),
        "four_robots_agent_steps_per_s": float(1.0 / per_agent[_ROBOTS]),
    }


def _with_robots(conf: BenchmarkConf, count: int) -> EnvConf:
    """The environment of `conf` with `count` of its robot and no other agents."""
    values = conf.model_dump(include=set(EnvConf.model_fields))
    body = next(group.body for group in conf.external_groups)
    values["agents"] = {"robots": {"body": body, "count": count}}
    return EnvConf.model_validate(values)
