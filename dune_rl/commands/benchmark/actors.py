"""Cost of twenty scripted actors in a scene, compared with none."""

from typing import Any

import numpy as np
import torch

from dune_rl.commands.benchmark.steppers import core_stepper
from dune_rl.commands.benchmark.timing import median_ratio, time_calls, time_in_turns
from dune_rl.config.build import make_simulation
from dune_rl.config.commands import BenchmarkConf
from dune_rl.config.schema import EnvConf
from dune_rl.config.shorthands import replace_actors

_ACTORS = 20
# The field of the result, and the controller of the actors.
_CONTROLLERS = {
    "actors_cost": "path",
    "actors_cost_social_force": "social_force",
    "actors_cost_orca": "orca",
}
_WARM_UP = 50


def measure_actors(conf: BenchmarkConf) -> dict[str, Any]:
    """What twenty persons beside the agents of `conf` add to a control step, as a share of it.

    Scripted ones walk on paths. They stand in the way of robots, so that physics has more contacts, and
    sensors see them: that is part of the cost.
    """
    torch.set_num_threads(1)
    controllers = {"none": None, **_CONTROLLERS}
    simulations = {
        name: make_simulation(_with_actors(conf, controller), conf.scenes, conf.seed)
        for name, controller in controllers.items()
    }
    steps = {}
    for name, simulation in simulations.items():
        simulation.reset()
        steps[name] = core_stepper(simulation), conf.steps
    for step, _ in steps.values():
        time_calls(step, _WARM_UP)
    times = time_in_turns(steps, conf.rounds)
    for simulation in simulations.values():
        simulation.close()
    costs = {name: median_ratio(times[name], times["none"]) - 1.0 for name in _CONTROLLERS}
    return {
        "scenes": conf.scenes,
        "actors": _ACTORS,
        **costs,
        "step_without_actors_us": float(np.median(times["none"])) / conf.scenes * 1e6,
    }


def _with_actors(conf: BenchmarkConf, controller: str | None) -> EnvConf:
    """The environment of `conf` with its robots, and twenty persons of this controller, or nobody."""
    values = conf.model_dump(include=set(EnvConf.model_fields))
    crowd = {"body": {"name": "person"}, "count": _ACTORS, "controller": controller}
    values["agents"] = replace_actors(values["agents"], {} if controller is None else {"crowd": crowd})
    return EnvConf.model_validate(values)
