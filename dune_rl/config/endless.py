"""Settings in which no episode ends."""

from typing import TypeVar

from dune_rl.config.schema import EnvConf
from dune_rl.tasks.task import TaskConf

Conf = TypeVar("Conf", bound=EnvConf)


def without_ends(conf: Conf) -> Conf:
    """`conf` with tasks in which no episode ends and nothing is rewarded; goals are renewed as before."""
    agents = {
        group.name: conf.agents[group.name].model_copy(update={"task": _without_ends(group.task)})
        for group in conf.groups
    }
    return conf.model_copy(update={"agents": agents})


def _without_ends(task: TaskConf | None) -> TaskConf | None:
    if task is None:
        return None
    renewing = {name: term for name, term in task.terminations.items() if term.renew}
    return task.model_copy(update={"rewards": {}, "terminations": renewing})
