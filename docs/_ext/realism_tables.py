"""Reference of the `realism` of sensors: the faults of each sensor, each class of them once."""

from settings_tables import as_code, first_paragraph, read_section, render_section

from dune_rl.core.settings import Settings
from dune_rl.sensors.realism.camera import CameraRealismConf
from dune_rl.sensors.realism.lidar import LidarRealismConf
from dune_rl.sensors.realism.noise import NoiseConf
from dune_rl.sensors.realism.pipeline import ReadingRealismConf, RealismConf
from dune_rl.sensors.realism.presets import PRESETS
from dune_rl.sensors.registry import SENSORS

_COMMON = frozenset(RealismConf.model_fields)
_OWN = frozenset(RealismConf.__subclasses__())


def _settings_of(sensor: str) -> type[RealismConf]:
    annotation = SENSORS.settings_class(sensor).model_fields["realism"].annotation
    model = next((each for each in getattr(annotation, "__args__", ()) if each in _OWN), ReadingRealismConf)
    assert issubclass(model, RealismConf)
    return model


def sensors_table() -> str:
    """What can be set for each sensor, and the names of its channels of noise."""
    rows = []
    for sensor in SENSORS.own:
        if sensor == "lidar_past":
            continue
        model = _settings_of(sensor)
        channels = ", ".join(f"`{name}`" for name in _channels(model))
        about = as_code(first_paragraph(model.__doc__ or ""))
        about = f"{about} Channels: {channels}." if channels else f"{about} Settings of its own, below."
        devices = [f"`{name}`" for name, part in PRESETS.items() if part.kind == model.kind]
        values = devices or [f"`{{{name}: {{noise: 0.02}}}}`" for name in _channels(model)[:1]]
        rows.append(f"| `{sensor}` | {about} | {', '.join(values)} |")
    return "\n".join(["| sensor | faults | values |", "|---|---|---|", *rows])


def _channels(model: type[RealismConf]) -> list[str]:
    kinds = {name: field.annotation for name, field in model.model_fields.items()}
    return [name for name, kind in kinds.items() if isinstance(kind, type) and issubclass(kind, NoiseConf)]


def faults_table(name: str) -> str:
    """The settings of "every" sensor, of a "channel", of a "lidar" or of a "camera", or the "imu"'s own."""
    models: dict[str, tuple[type[Settings], frozenset[str]]] = {
        "every": (RealismConf, frozenset()),
        "channel": (NoiseConf, frozenset()),
        "lidar": (LidarRealismConf, _COMMON),
        "camera": (CameraRealismConf, _COMMON),
        "imu": (_settings_of("imu"), _COMMON | {"accelerometer", "gyroscope", "tilt", "heading"}),
    }
    model, without = models[name]
    return render_section(read_section(model, "", {}, without=without), 3)


def devices_table() -> str:
    """The known devices."""
    rows = [f"| `{name}` | {part.kind} | {as_code(part.name)} |" for name, part in PRESETS.items()]
    return "\n".join(["| name | sensor | device |", "|---|---|---|", *rows])
