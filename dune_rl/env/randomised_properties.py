"""The properties that may differ from episode to episode: each changes an `EpisodeVariation`."""

from dataclasses import dataclass, replace
from typing import Annotated, Any

from pydantic import Field

from dune_rl.env.latency import LONGEST_S
from dune_rl.env.traction import UNCHANGED_CONTACTS, ContactFactors
from dune_rl.physics.robot_body import AS_DESCRIBED, BodyVariation
from dune_rl.rendering.weather import WeatherConf

# Metrics are float32, which holds whole numbers below 2**24.
Seed = Annotated[int, Field(ge=0, le=2**24 - 1)]
Factor = Annotated[float, Field(ge=0.01, le=10.0)]
Shift = Annotated[float, Field(ge=-0.5, le=0.5)]


@dataclass(frozen=True)
class EpisodeVariation:
    """What randomisation may change in an episode: `dataclasses.replace` makes a changed one.

    `world` are the settings of the world and `weather` those of the weather; `contacts`, `body` and
    `latency_s`, the delay of motor commands [s], are those of every robot.
    """

    world: Any
    weather: WeatherConf
    contacts: ContactFactors = UNCHANGED_CONTACTS
    body: BodyVariation = AS_DESCRIBED
    latency_s: float | None = None


def world_seed(episode: EpisodeVariation, value: Seed) -> EpisodeVariation:
    """Seed of the world: another member of its family, terrain and props."""
    return replace(episode, world=episode.world.model_copy(update={"seed": int(value)}))


def layout_seed(episode: EpisodeVariation, value: Seed) -> EpisodeVariation:
    """Seed of the props alone, on the same terrain."""
    return replace(episode, world=episode.world.model_copy(update={"layout_seed": int(value)}))


def friction(episode: EpisodeVariation, value: Factor) -> EpisodeVariation:
    """Factor on the friction of the world under the wheels."""
    return replace(episode, contacts=replace(episode.contacts, friction=value))


def stiffness(
    episode: EpisodeVariation, value: Annotated[float, Field(ge=0.01, le=100.0)]
) -> EpisodeVariation:
    """Factor on the stiffness of the world's surfaces, if it has a map of them."""
    return replace(episode, contacts=replace(episode.contacts, stiffness=value))


def sun_bearing_deg(
    episode: EpisodeVariation, value: Annotated[float, Field(ge=-360.0, le=360.0)]
) -> EpisodeVariation:
    """Bearing of the sun from the world's x axis [deg], in place of that in `weather.light`."""
    return _change_light(episode, "sun_bearing_deg", value)


def sun_elevation_deg(
    episode: EpisodeVariation, value: Annotated[float, Field(ge=1.0, le=90.0)]
) -> EpisodeVariation:
    """Elevation of the sun over the horizon [deg], in place of that in `weather.light`."""
    return _change_light(episode, "sun_elevation_deg", value)


def brightness(episode: EpisodeVariation, value: Factor) -> EpisodeVariation:
    """Brightness of sun and sky, in place of that in `weather.light`."""
    return _change_light(episode, "brightness", value)


def mass(episode: EpisodeVariation, value: Annotated[float, Field(ge=0.1, le=10.0)]) -> EpisodeVariation:
    """Factor on the masses and inertias of all the robot's links."""
    contacts = replace(episode.contacts, load=value)
    return replace(episode, contacts=contacts, body=replace(episode.body, mass_factor=value))


def centre_x_m(episode: EpisodeVariation, value: Shift) -> EpisodeVariation:
    """Shift of the robot's centre of mass forward [m]."""
    return _shift_centre(episode, 0, value)


def centre_y_m(episode: EpisodeVariation, value: Shift) -> EpisodeVariation:
    """Shift of the robot's centre of mass to the left [m]."""
    return _shift_centre(episode, 1, value)


def centre_z_m(episode: EpisodeVariation, value: Shift) -> EpisodeVariation:
    """Shift of the robot's centre of mass upwards [m]."""
    return _shift_centre(episode, 2, value)


def motor_strength(
    episode: EpisodeVariation, value: Annotated[float, Field(ge=0.05, le=5.0)]
) -> EpisodeVariation:
    """Factor on the motors' voltage: on their stall torque and on their speed without load."""
    return replace(episode, body=replace(episode.body, motor_strength=value))


def wheel_friction(episode: EpisodeVariation, value: Factor) -> EpisodeVariation:
    """Factor on the friction of the robot's tyres or feet, which multiplies with `friction`."""
    return replace(episode, contacts=replace(episode.contacts, tyres=value))


def action_latency_s(
    episode: EpisodeVariation, value: Annotated[float, Field(ge=0.0, le=LONGEST_S)]
) -> EpisodeVariation:
    """Delay of motor commands [s], in the nearest whole number of control steps."""
    return replace(episode, latency_s=value)


def _change_light(episode: EpisodeVariation, name: str, value: float) -> EpisodeVariation:
    light = episode.weather.light.model_copy(update={name: value})
    return replace(episode, weather=episode.weather.model_copy(update={"light": light}))


def _shift_centre(episode: EpisodeVariation, axis: int, value: float) -> EpisodeVariation:
    x, y, z = (value if place == axis else part for place, part in enumerate(episode.body.centre_shift_b))
    return replace(episode, body=replace(episode.body, centre_shift_b=(x, y, z)))
