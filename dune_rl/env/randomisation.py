"""Domain-randomisation settings: which properties vary, their distributions, and how values are applied.

A property is a setting of `RandomisationConf` and an entry of `PROPERTIES` of the same name.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Self

from pydantic import model_validator

from dune_rl.core.settings import Settings
from dune_rl.env.distributions import Distribution, WholeNumbers
from dune_rl.env.latency import LONGEST_S
from dune_rl.env.traction import Traction
from dune_rl.physics.varied_body import BodyVariation
from dune_rl.rendering.weather import WeatherConf

# Metrics are float32, which holds whole numbers below this.
_LARGEST_SEED = 2**24 - 1


@dataclass(frozen=True)
class RandomizedProperty:
    """How a sampled value is applied to an episode, and the `limits` of its distribution.

    `world` and `weather` change settings, `traction` the wheel contacts of a
    robot before its start, and `body` its masses and motors. `latency` marks
    the delay of its motor commands [s]. `stream` names its random stream, by a
    former name of the property, so that a seed keeps its episodes; None: its own name.
    """

    limits: tuple[float, float]
    world: Callable[[Any, float], Any] | None = None
    weather: Callable[[WeatherConf, float], WeatherConf] | None = None
    traction: Callable[[Traction, int, float], None] | None = None
    body: Callable[[BodyVariation, float], BodyVariation] | None = None
    latency: bool = False
    stream: str | None = None


def _world_setting(name: str) -> Callable[[Any, float], Any]:
    return lambda world, value: world.model_copy(update={name: int(value)})


def _light_setting(name: str) -> Callable[[WeatherConf, float], WeatherConf]:
    def change(weather: WeatherConf, value: float) -> WeatherConf:
        return weather.model_copy(update={"light": weather.light.model_copy(update={name: value})})

    return change


def _scale_friction(traction: Traction, scene: int, factor: float) -> None:
    traction.friction_factor[scene] = factor


def _scale_stiffness(traction: Traction, scene: int, factor: float) -> None:
    traction.stiffness_factor[scene] = factor


def _scale_tyres(traction: Traction, scene: int, factor: float) -> None:
    traction.tyre_factor[scene] = factor


def _scale_load(traction: Traction, scene: int, factor: float) -> None:
    traction.load_factor[scene] = factor


def _weigh(body: BodyVariation, factor: float) -> BodyVariation:
    return replace(body, mass_factor=factor)


def _strengthen(body: BodyVariation, factor: float) -> BodyVariation:
    return replace(body, motor_strength=factor)


def _centre(axis: int) -> Callable[[BodyVariation, float], BodyVariation]:
    def change(body: BodyVariation, value: float) -> BodyVariation:
        x, y, z = (value if place == axis else part for place, part in enumerate(body.centre_shift_b))
        return replace(body, centre_shift_b=(x, y, z))

    return change


PROPERTIES: dict[str, RandomizedProperty] = {
    "world_seed": RandomizedProperty((0, _LARGEST_SEED), world=_world_setting("seed")),
    "layout_seed": RandomizedProperty((0, _LARGEST_SEED), world=_world_setting("layout_seed")),
    "friction": RandomizedProperty((0.01, 10.0), traction=_scale_friction),
    "stiffness": RandomizedProperty((0.01, 100.0), traction=_scale_stiffness),
    "sun_bearing_deg": RandomizedProperty(
        (-360.0, 360.0), weather=_light_setting("sun_bearing_deg"), stream="sun_bearing_rad"
    ),
    "sun_elevation_deg": RandomizedProperty(
        (1.0, 90.0), weather=_light_setting("sun_elevation_deg"), stream="sun_elevation_rad"
    ),
    "brightness": RandomizedProperty((0.01, 10.0), weather=_light_setting("brightness")),
    "mass": RandomizedProperty((0.1, 10.0), traction=_scale_load, body=_weigh),
    "centre_x_m": RandomizedProperty((-0.5, 0.5), body=_centre(0)),
    "centre_y_m": RandomizedProperty((-0.5, 0.5), body=_centre(1)),
    "centre_z_m": RandomizedProperty((-0.5, 0.5), body=_centre(2)),
    "motor_strength": RandomizedProperty((0.05, 5.0), body=_strengthen),
    "wheel_friction": RandomizedProperty((0.01, 10.0), traction=_scale_tyres),
    "action_latency_s": RandomizedProperty((0.0, LONGEST_S), latency=True),
}


class RandomisationConf(Settings):
    """Distributions that are sampled for each episode; null properties keep the configured values.

    `world_seed` replaces the world's `seed`, and so terrain and props;
    `layout_seed` only the props, on the same terrain. `friction` is a factor on
    that of the world under the wheels, and `stiffness` on that of its surfaces,
    which a world without a map of them has not. The sun's place and the `brightness` take the place of
    those in `weather.light`.

    `mass` is a factor on the masses and inertias of all the robot's links, and
    `centre_x_m`, `centre_y_m` and `centre_z_m` move its centre of mass forward,
    left and up. `motor_strength` is a factor on its motors' voltage: on their
    stall torque and on their speed without load. `wheel_friction` is a factor
    on that of its tyres or feet, which multiplies with `friction`. Commands
    reach the motors `action_latency_s` late, in the nearest whole number of
    control steps.
    """

    world_seed: WholeNumbers | None = None
    layout_seed: WholeNumbers | None = None
    friction: Distribution | None = None
    stiffness: Distribution | None = None
    sun_bearing_deg: Distribution | None = None
    sun_elevation_deg: Distribution | None = None
    brightness: Distribution | None = None
    mass: Distribution | None = None
    centre_x_m: Distribution | None = None
    centre_y_m: Distribution | None = None
    centre_z_m: Distribution | None = None
    motor_strength: Distribution | None = None
    wheel_friction: Distribution | None = None
    action_latency_s: Distribution | None = None

    @property
    def distributions(self) -> dict[str, Any]:
        """The distributions that are not null, by property name."""
        found = ((name, getattr(self, name)) for name in PROPERTIES)
        return {name: distribution for name, distribution in found if distribution is not None}

    @model_validator(mode="after")
    def _within_limits(self) -> Self:
        for name, distribution in self.distributions.items():
            low, high = PROPERTIES[name].limits
            least, most = distribution.limits
            if least < low or most > high:
                raise ValueError(
                    f"{name} must lie between {low:.10g} and {high:.10g} (got {least:.10g} to {most:.10g})"
                )
        return self

    def check(self, world: Settings, weather: WeatherConf) -> None:
        """Raise ValueError if a property is drawn that `world` or `weather` does not have."""
        known = type(world).model_fields
        for name, needed in (("world_seed", "seed"), ("layout_seed", "layout_seed")):
            if name in self.distributions and needed not in known:
                raise ValueError(
                    f"randomisation.{name}: the world {getattr(world, 'name', '')!r} has no {needed}; "
                    "leave it null, or choose a world that is made from a seed"
                )
        if self.stiffness is not None and not _has_surfaces(world):
            raise ValueError(
                "randomisation.stiffness: the world's ground is rigid; set its surfaces "
                "(world.surfaces=natural, or world.surface_map), or leave it null"
            )
        for name in ("sun_bearing_deg", "sun_elevation_deg"):
            if name in self.distributions and weather.time_of_day_h is not None:
                raise ValueError(
                    f"randomisation.{name}: weather.time_of_day_h={weather.time_of_day_h:g} determines the "
                    "position of the sun; set one of them to null"
                )


def _has_surfaces(world: Settings) -> bool:
    chosen = getattr(world, "surfaces", "uniform") != "uniform"
    return chosen or getattr(world, "surface_map", None) is not None
