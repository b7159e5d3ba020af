"""Controllers of agent groups as they are configured."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from dune_rl.behaviours.registry import BEHAVIOURS, BehaviourSettings
from dune_rl.core.settings import Settings
from dune_rl.core.suggestions import closest, one_of

EXTERNAL, PATH, TRAJECTORY = "external", "path", "trajectory"


def _as_list(value: Any) -> Any:
    return [value] if isinstance(value, str) else value


class FrozenPolicyConf(Settings):
    """A controller that is a trained policy: a run's folder, or a file of weights.

    `group` is the one whose policy is played, of those that were trained; without it, that of the same name.
    """

    checkpoint: str = Field(min_length=1)
    group: str | None = None


class TrajectoryFilesConf(Settings):
    """A controller that is a trajectory for each agent, from files (.sdf, .csv, .json) in their order."""

    trajectory: Annotated[tuple[str, ...], BeforeValidator(_as_list)] = Field(min_length=1)


Controller = (
    Literal["external", "path", "trajectory"] | FrozenPolicyConf | TrajectoryFilesConf | BehaviourSettings
)


def plain_controller(value: Any) -> Any:
    """A controller as it is written; `{name: path}` and others without settings of their own as text."""
    if isinstance(value, Mapping) and value.keys() == {"name"} and isinstance(value["name"], str):
        return value["name"] if value["name"] in (EXTERNAL, PATH, TRAJECTORY) else value
    return value


def parse_controller(value: Any) -> Any:
    value = plain_controller(value)
    if isinstance(value, Settings) or (isinstance(value, str) and value in (EXTERNAL, PATH, TRAJECTORY)):
        return value
    if isinstance(value, Mapping) and "checkpoint" in value:
        return FrozenPolicyConf.model_validate(value)
    if isinstance(value, Mapping) and TRAJECTORY in value:
        return TrajectoryFilesConf.model_validate(value)
    name = value.get("name") if isinstance(value, Mapping) else value
    if name in (EXTERNAL, PATH, TRAJECTORY):
        given = next(key for key in value if key != "name")
        near = closest(str(given), ["checkpoint", TRAJECTORY])
        remedy = f"did you mean {near}?" if near else f"write controller: {name}"
        raise ValueError(f"the controller {name} has no settings, and {given} is none; {remedy}")
    if name is None:
        raise ValueError(
            "a controller's mapping has a name, {name: BEHAVIOUR, ...}, a checkpoint, {checkpoint: PATH}, or "
            "a trajectory, {trajectory: FILE}"
        )
    known = [EXTERNAL, PATH, TRAJECTORY, *BEHAVIOURS.names()]
    if not isinstance(name, str) or name not in known:
        near = closest(str(name), known)
        remedy = f"did you mean {near}?" if near else f"choose {one_of(known)}, or {{checkpoint: PATH}}"
        raise ValueError(f"there is no controller {name!r}; {remedy}")
    if isinstance(value, str) and BEHAVIOURS.is_loaded(name):
        settings = BEHAVIOURS.settings_class(name)
        assert settings is not None, name
        fields = settings.model_fields.items()
        needed = [key for key, field in fields if field.is_required() and key != BEHAVIOURS.tag]
        if needed:
            raise ValueError(
                f"{name} needs {' and '.join(needed)}; write controller: {{name: {name}, {needed[0]}: ...}}"
            )
    return BEHAVIOURS.parse_settings({"name": value} if isinstance(value, str) else value)


def follows_trajectories(controller: Controller) -> bool:
    """Whether a controller moves its agents on trajectories, of the world's file or of others."""
    return controller == TRAJECTORY or isinstance(controller, TrajectoryFilesConf)


def reads_sensors(controller: Controller) -> bool:
    """Whether a controller needs its group's observation."""
    if isinstance(controller, FrozenPolicyConf):
        return True
    part = BEHAVIOURS.find(controller.name) if isinstance(controller, BehaviourSettings) else None
    return part is not None and getattr(part.target, "reads_sensors", False)
