"""The tasks of the paper and of its published code, and the start of one."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from dune_rl.state import GroupState
from dune_rl.tasks.task import Task, TaskConf


def with_terms(
    conf: TaskConf,
    rewards: Mapping[str, Mapping[str, Any]] | None = None,
    terminations: Mapping[str, Mapping[str, Any]] | None = None,
) -> TaskConf:
    """`conf` with changes of some settings of some terms, and further terms."""
    values = conf.model_dump()
    for section, changes in (("rewards", rewards), ("terminations", terminations)):
        for name, change in (changes or {}).items():
            values[section][name] = {**values[section].get(name, {}), **change}
    return TaskConf.model_validate(values)


PAPER = with_terms(TaskConf(), rewards={"contact": {"weight": 0.0}})
DUNE_CODE = with_terms(
    TaskConf(),
    rewards={
        "distance": {"min_progress_m": 0.001, "signed": True, "heading_limit_deg": 72.0, "misaligned": -0.03},
        "heading": {"bonus": 0.0},
        "velocity": {"turn_scale": 0.0015},
        "collision": {"term": "scan_collision", "distance_m": 0.3},
        "contact": {"weight": 0.0},
        "stuck": {"weight": -25.0},
        "flipped": {"weight": -20.0},
        "out_of_world": {"weight": -10.0},
        "long_collision": {"term": "ended_by", "termination": "long_collision", "weight": -20.0},
    },
    terminations={
        "goal_reached": {"distance_m": 0.5, "renew": True},
        "stuck": {"distance_m": 0.001, "steps": 600},
        "long_collision": {"distance_m": 0.3, "steps": 600},
        "time_limit": {"truncates": False},
    },
)


def begun(conf: TaskConf, group: GroupState) -> Task:
    task = Task(conf, len(group.done))
    task.reset(np.ones(len(group.done), bool), group)
    return task
