"""Files that agent groups read: trained policies and trajectories; and what to do where they are faulty."""

import warnings
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

from dune_rl.config.agents import ResolvedGroup
from dune_rl.config.checks import validate
from dune_rl.config.compose import compose_environment
from dune_rl.config.controllers import FrozenPolicyConf, TrajectoryFilesConf
from dune_rl.config.saved import upgrade_saved
from dune_rl.config.schema import Conf, EnvConf
from dune_rl.core.errors import CheckpointError, DuneError, WorldError
from dune_rl.core.paths import conf_folder
from dune_rl.core.suggestions import one_of
from dune_rl.sensors.conf import observed_names
from dune_rl.worlds.actor_trajectory import ActorTrajectory

# The fault of a file that has policies of some groups, given them and its location; empty without one.
_FindFault = Callable[[Sequence[str], str], str]


def read_group_files(conf: EnvConf) -> dict[str, tuple[ActorTrajectory, ...]]:
    """The trajectories of the groups whose controllers name files of them, by group.

    Raises CheckpointError or WorldError, which names every setting at fault, unless these files are there and
    all groups that play a trained policy have one to play. Whether it fits what the group observes and does
    is known once an environment is made.
    """
    trajectories, faults = _read_trajectories(conf)
    _raise_all(list(_controller_faults(conf)), faults)
    return trajectories


def check_group_files(conf: EnvConf) -> None:
    """Raise as `read_group_files`, and for what a new training begins with, but without warnings."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        _, faults = _read_trajectories(conf)
        _raise_all([*_controller_faults(conf), *_learning_faults(conf)], faults)


def _raise_all(policies: Sequence[str], trajectories: Sequence[str]) -> None:
    if trajectories:
        raise WorldError("\n".join([*policies, *trajectories]))
    if policies:
        raise CheckpointError("\n".join(policies))


def describe_owner(checkpoint: str, group: str, settings: str) -> str:
    """What `group` must have to act by the policy in a file: that of the group which was trained.

    Its settings are at `settings`. The text is empty where the file does not tell.
    """
    from dune_rl.learning.saved_policies import read_policy_groups

    try:
        trained, config = read_policy_groups(Path(checkpoint))
        saved = upgrade_saved(config)
        owners = validate(
            EnvConf, {name: saved[name] for name in EnvConf.model_fields if name in saved}
        ).groups
    except DuneError:
        return ""
    name = group if group in trained else trained[0]
    owner = next((each for each in owners if each.name == name), None)
    if owner is None or owner.sensors is None:
        return ""
    return (
        f"The policy is that of {name}: write {settings}.body={owner.body.name} and "
        f"{settings}.sensors={_sensors_in_words(owner)}, or take another checkpoint."
    )


def _sensors_in_words(group: ResolvedGroup) -> str:
    """The option of `sensors` that a group has, or one that enables the same; else what it has enabled."""
    assert group.sensors is not None
    options = [file.stem for file in sorted((conf_folder() / "sensors").glob("*.yaml"))]
    found = {name: compose_environment("flat", [f"sensors={name}"]).sensors for name in options}
    for name, sensors in found.items():
        if sensors == group.sensors:
            return name
    for name, sensors in found.items():
        if observed_names(sensors) == observed_names(group.sensors):
            return name
    return f"[{','.join(observed_names(group.sensors))}]"


def _read_trajectories(conf: EnvConf) -> tuple[dict[str, tuple[ActorTrajectory, ...]], list[str]]:
    found: dict[str, tuple[ActorTrajectory, ...]] = {}
    faults: list[str] = []
    for group in conf.groups:
        if not isinstance(group.controller, TrajectoryFilesConf):
            continue
        # Only now: reading SDF needs libraries that most environments do without.
        from dune_rl.worlds.importing.actor_files import read_actor_file

        actors: list[ActorTrajectory] = []
        for file in group.controller.trajectory:
            try:
                actors += read_actor_file(file)
            except WorldError as error:
                faults.append(f"{conf.path_of(group.name)}.controller.trajectory: {error}")
        found[group.name] = tuple(actors)
    return found, faults


def _controller_faults(conf: EnvConf) -> Iterator[str]:
    """A line or two for each scripted group that is to play a trained policy, and has none to play."""
    for group in conf.groups:
        policy = group.controller
        if isinstance(policy, FrozenPolicyConf):
            settings = f"{conf.path_of(group.name)}.controller"
            remedy, by_name = f"Set {settings}.group to", policy.group is not None
            find = partial(_why_not_played, group=policy.group or group.name, remedy=remedy, by_name=by_name)
            yield from _policy_fault(f"{settings}.checkpoint", policy.checkpoint, find)


def _learning_faults(conf: EnvConf) -> Iterator[str]:
    """A line or two for each group of a training that is frozen on, or starts from, what is not there."""
    if not isinstance(conf, Conf):
        return
    from dune_rl.learning.learners import describe_missing_start

    groups = [group.name for group in conf.external_groups]
    for name in groups:
        frozen = conf.learning.frozen(name)
        setting, location = conf.learning.start_of(name)
        find: _FindFault = partial(describe_missing_start, group=name, conf=conf.learning, groups=groups)
        if frozen is not None:
            setting, location = f"learning.groups.{name}.frozen", frozen
            find = partial(_why_not_played, group=name, remedy="Call the group", by_name=False)
        if location is not None:
            yield from _policy_fault(setting, location, find)


def _policy_fault(setting: str, location: str, find: _FindFault) -> Iterator[str]:
    """What is wrong with the policies at `location`: `find` gets their groups, and the location."""
    from dune_rl.learning.saved_policies import read_policy_groups

    try:
        fault = find(read_policy_groups(Path(location))[0], location)
    except CheckpointError as error:
        fault = str(error)
    if fault:
        yield f"{setting}: {fault}"


def _why_not_played(trained: Sequence[str], location: str, group: str, remedy: str, by_name: bool) -> str:
    """Why none of the policies `trained` is that of `group`; without `by_name`, a policy alone is."""
    if group in trained or (len(trained) == 1 and not by_name):
        return ""
    return (
        f"{location} has no policy for the group {group}, but for {', '.join(trained)}.\n"
        f"{remedy} {one_of(trained)}, after the one whose policy it is to play, or take another checkpoint."
    )
