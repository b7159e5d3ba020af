"""The sensors of an agent group: settings by name, in the order of the observation."""

import inspect
import re
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, SerializeAsAny, TypeAdapter

from dune_rl.sensors.registry import SENSORS
from dune_rl.sensors.settings import SensorSettings

# What robots observe unless they are told otherwise; see conf/sensors/default.yaml.
_DEFAULT = ("lidar", "lidar_past", "imu", "goal", "velocity")
_ENABLED = "enabled"
_PAST = "_past"


def read_entries(value: Any) -> Any:
    """Plain settings of sensors by name, from a list of names, or from a mapping with or without such a list.

    The list is the mapping's entry `enabled`: these sensors are observed, in this order, and the others are
    not. Without a list all are. An entry without `sensor` is of the kind of its name, one that is null is
    left out, and `NAME_past` in a list is the past scan of the LiDAR called NAME.
    """
    if isinstance(value, Sequence) and not isinstance(value, str):
        value = {_ENABLED: value}
    if not isinstance(value, Mapping):
        return value
    others = {key: each for key, each in value.items() if key != _ENABLED}
    entries: dict[str, Any] = SENSORS.tag_entries(others)
    if _ENABLED not in value:
        return entries
    names = value[_ENABLED]
    if not isinstance(names, list | tuple) or not all(isinstance(each, str) for each in names):
        raise ValueError(f"{_ENABLED} must be a list of the names of sensors (got {names!r})")
    listed = {name: entries.pop(name) if name in entries else _entry(name, entries) for name in names}
    return {
        **{name: _with_observed(entry, True) for name, entry in listed.items()},
        **{name: _with_observed(entry, False) for name, entry in entries.items()},
    }


def complete_entries(value: Any) -> Any:
    """As `read_entries`, where the entries are all sensors that a group has, and no changes of others."""
    return {
        name: {"realism": None, "privileged": False, "observed": True, **entry}
        if isinstance(entry, Mapping)
        else entry
        for name, entry in read_entries(value).items()
    }


def _entry(name: str, entries: Mapping[str, Any]) -> dict[str, Any]:
    lidar = name.removesuffix(_PAST)
    if name.endswith(_PAST) and name not in SENSORS.names():
        return {"sensor": "lidar_past", "lidar": lidar}
    return {"sensor": name}


def _with_observed(entry: Any, observed: bool) -> Any:
    if isinstance(entry, SensorSettings):
        return entry.model_copy(update={"observed": observed})
    return {**entry, "observed": observed} if isinstance(entry, Mapping) else entry


def _without_idle(sensors: dict[str, SensorSettings]) -> dict[str, SensorSettings]:
    """The sensors without those that are neither observed nor have settings that differ from the defaults."""
    return {
        name: conf
        for name, conf in sensors.items()
        if conf.observed or conf.model_dump(exclude={"observed"}, exclude_defaults=True)
    }


NamedSensor = Annotated[SerializeAsAny[SensorSettings], BeforeValidator(SENSORS.parse_settings)]
Sensors = Annotated[dict[str, NamedSensor], BeforeValidator(read_entries), AfterValidator(_without_idle)]
_ADAPTER: TypeAdapter[dict[str, SensorSettings]] = TypeAdapter(Sensors)


def parse_sensors(value: Any) -> dict[str, SensorSettings]:
    """The settings of sensors from plain data; see `read_entries`. Raises pydantic's ValidationError."""
    return _ADAPTER.validate_python(value)


def default_sensors() -> dict[str, SensorSettings]:
    """What robots observe unless they are told otherwise."""
    return parse_sensors(_DEFAULT)


def observed_names(sensors: Mapping[str, SensorSettings]) -> list[str]:
    """Names of the sensors that are observed, in the order of the observation."""
    return [name for name, conf in sensors.items() if conf.observed]


def check_timing(sensors: Mapping[str, SensorSettings], step_s: float, path: str) -> None:
    """Raise ValueError, opened by a setting below `path`, where a rate or latency does not fit `step_s`."""
    for name, conf in sensors.items():
        if conf.realism is not None:
            try:
                conf.realism.steps(step_s)
            except ValueError as error:
                raise ValueError(f"{path}.{name}.realism: {error}") from None


def describe_reading(sensors: Mapping[str, SensorSettings], key: str) -> str:
    """What the reading `key` is, with its units: the first line of its sensor's documentation.

    A sensor with several readings, as `camera_rgb` and `camera_depth`, is described as a whole.
    """
    name = next((each for each in (key, key.rpartition("_")[0]) if each in sensors), None)
    if name is None:
        return ""
    text = inspect.getdoc(SENSORS.part_of(sensors[name]).target) or ""
    line = text.partition("\n")[0].rstrip(".")
    # The package's own begin with "The reading `name`, (N, n_segments) [m]: ".
    own = re.match(r"The readings? .*?\(N[^)]*\)( \[[^]]+\])?[^:]*: (.+)", line)
    return line if own is None else f"{own[2]}{own[1] or ''}"
