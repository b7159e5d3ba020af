"""Domain-randomisation settings: a distribution for each property that varies, and the registry of these."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Self

from pydantic import ConfigDict, Field, create_model, model_validator

from dune_rl.core.errors import DuneError
from dune_rl.core.registry import RegisteredPart, Registry
from dune_rl.core.settings import Settings
from dune_rl.env.distributions import Distribution, Integers, WholeNumbers
from dune_rl.env.randomised_properties import EpisodeVariation
from dune_rl.rendering.weather import WeatherConf

_OWN = (
    "world_seed",
    "layout_seed",
    "friction",
    "stiffness",
    "sun_bearing_deg",
    "sun_elevation_deg",
    "brightness",
    "mass",
    "centre_x_m",
    "centre_y_m",
    "centre_z_m",
    "motor_strength",
    "wheel_friction",
    "action_latency_s",
)
# The one setting that is no property.
_KEPT = "episodes_per_world"


class RandomisedValue(Settings):
    """The settings of a property in an episode: its name, and the drawn `value`."""

    name: str


RANDOMISATIONS: Registry[EpisodeVariation] = Registry(
    "randomisation",
    "dune_rl.env.randomisation:RANDOMISATIONS",
    own={name: f"dune_rl.env.randomised_properties:{name}" for name in _OWN},
    base=RandomisedValue,
    product=EpisodeVariation,
    form="a function of (episode, value) that returns the changed EpisodeVariation",
    function_leading=("episode",),
)


def _field(part: RegisteredPart) -> tuple[Any, None]:
    """The field of `RandomisationConf` that a property has."""
    if set(part.settings.model_fields) != {"name", "value"}:
        raise ValueError(f"{part.origin}, whose parameters must be episode and value.")
    whole = part.settings.model_fields["value"].annotation is int
    return (WholeNumbers if whole else Distribution) | None, None


def _find(name: str) -> RegisteredPart:
    part = RANDOMISATIONS.find(name)
    assert part is not None
    return part


if TYPE_CHECKING:
    _OwnProperties = Settings
else:
    _OwnProperties = create_model(
        "_OwnProperties", __base__=Settings, **{name: _field(_find(name)) for name in _OWN}
    )


class RandomisationConf(_OwnProperties):
    """Distributions that are sampled for each episode; null properties keep the configured values.

    The properties are those of `dune_rl.env.randomised_properties`, and registered ones. A scene keeps its
    sampled world for `episodes_per_world` of its own episodes.
    """

    model_config = ConfigDict(extra="allow")

    episodes_per_world: int = Field(1, ge=1, description="own episodes for which a scene keeps its world")

    @model_validator(mode="before")
    @classmethod
    def _parse_registered(cls, data: Any) -> Any:
        if not isinstance(data, Mapping):
            return data
        others = {name: value for name, value in data.items() if name not in cls.model_fields}
        try:
            parts = {name: RANDOMISATIONS.find(name) for name in others}
        except DuneError as error:
            raise ValueError(str(error)) from None
        # Raises an error for each name that is not registered.
        fields: dict[str, Any] = {name: _field(part) for name, part in parts.items() if part is not None}
        return {**data, **dict(create_model("Registered", __base__=Settings, **fields)(**others))}

    @property
    def distributions(self) -> dict[str, Any]:
        """The distributions that are not null, by property name."""
        drawn = (each for each in self if each[0] != _KEPT)
        return {name: distribution for name, distribution in drawn if distribution is not None}

    def with_new_worlds(self, seeds: tuple[int, int] | None = None) -> Self:
        """These settings with a world for each episode, so that no result depends on the number of scenes.

        Its seed is drawn between `seeds`, both included; None: as these settings draw it, if they do.
        """
        changes: dict[str, Any] = {_KEPT: 1}
        if seeds is not None:
            changes["world_seed"] = Integers(name="integers", low=seeds[0], high=seeds[1])
        return self.model_copy(update=changes)

    @model_validator(mode="after")
    def _within_limits(self) -> Self:
        for name, distribution in self.distributions.items():
            bounds = {
                key: getattr(bound, key)
                for bound in _find(name).settings.model_fields["value"].metadata
                for key in ("ge", "le")
                if hasattr(bound, key)
            }
            low, high = bounds.get("ge", -float("inf")), bounds.get("le", float("inf"))
            least, most = distribution.limits
            if least < low or most > high:
                raise ValueError(
                    f"{name} must lie between {low:.10g} and {high:.10g} (got {least:.10g} to {most:.10g})"
                )
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        # Worker processes get the functions along.
        parts = {name: _find(name) for name, _ in self if name != _KEPT}
        targets = {name: part.target for name, part in parts.items() if not part.is_own}
        return _restore, (targets, dict(self))

    def check(self, world: Settings, weather: WeatherConf) -> None:
        """Raise ValueError if a property is drawn that `world` or `weather` does not have."""
        known = type(world).model_fields
        for name, needed in (("world_seed", "seed"), ("layout_seed", "layout_seed")):
            if name in self.distributions and needed not in known:
                raise ValueError(
                    f"randomisation.{name}: the world {getattr(world, 'name', '')!r} has no {needed}; "
                    "leave it null, or choose a world that is made from a seed"
                )
        if "stiffness" in self.distributions and not _has_surfaces(world):
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


def _restore(targets: Mapping[str, Callable[..., Any]], values: Mapping[str, Any]) -> RandomisationConf:
    for name, target in targets.items():
        if RANDOMISATIONS.find(name) is None:
            RANDOMISATIONS.register(target, name)
    return RandomisationConf(**values)


def _has_surfaces(world: Settings) -> bool:
    chosen = getattr(world, "surfaces", "uniform") != "uniform"
    return chosen or getattr(world, "surface_map", None) is not None
