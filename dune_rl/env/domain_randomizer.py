"""Domain randomisation: the world, weather, contacts and body of each episode, by (seed, episode) alone."""

from collections.abc import Callable, Sequence
from typing import Any

from dune_rl.env.randomisation import PROPERTIES, RandomisationConf
from dune_rl.env.traction import Traction
from dune_rl.physics.varied_body import AS_DESCRIBED, BodyVariation
from dune_rl.rendering.weather import WeatherConf
from dune_rl.seeding import stream
from dune_rl.worlds.world import World

Values = tuple[float, ...]


class DomainRandomizer:
    """Draws the properties that `randomisation` names, and says what they make of an episode.

    `make_world` builds a world of settings like `world_conf`; equal settings
    should give the same object while that is in use. `prepare` is told the
    settings that will be asked for next, and may build them meanwhile.
    `names` are the properties drawn, in the order of `Values`.
    """

    def __init__(
        self,
        world_conf: Any,
        weather: WeatherConf,
        randomisation: RandomisationConf,
        make_world: Callable[[Any], World],
        prepare: Callable[[Sequence[Any]], None] | None = None,
    ) -> None:
        self._world_conf, self._weather = world_conf, weather
        self._distributions = randomisation.drawn
        self._make_world, self._prepare = make_world, prepare
        self.names = tuple(self._distributions)

    @classmethod
    def none(cls, world: World, weather: WeatherConf) -> "DomainRandomizer":
        """Every episode in the same world and weather."""
        return cls(None, weather, RandomisationConf(), lambda _: world)

    @property
    def randomizes_worlds(self) -> bool:
        """Whether worlds differ."""
        return any(PROPERTIES[name].world is not None for name in self.names)

    def draw(self, seed: int, episode: int, attempt: int = 0) -> Values:
        """The values of an episode; a further `attempt` draws another world and leaves the rest alone."""
        values = []
        for name, distribution in self._distributions.items():
            again = (attempt,) if attempt and PROPERTIES[name].world is not None else ()
            rng = stream(seed, f"randomisation {name}", episode, *again)
            values.append(distribution.draw(rng))
        return tuple(values)

    def world_conf(self, values: Values) -> Any:
        """The settings of the world of drawn `values`."""
        conf = self._world_conf
        for name, value in zip(self.names, values, strict=True):
            change = PROPERTIES[name].world
            conf = conf if change is None else change(conf, value)
        return conf

    def world(self, conf: Any) -> World:
        """The world of such settings; raises WorldError where there is none."""
        return self._make_world(conf)

    def weather(self, values: Values) -> WeatherConf:
        """The weather of drawn `values`."""
        weather = self._weather
        for name, value in zip(self.names, values, strict=True):
            change = PROPERTIES[name].weather
            weather = weather if change is None else change(weather, value)
        return weather

    def apply_to_contacts(self, traction: Traction, row: int, values: Sequence[float]) -> None:
        """Set the contact factors of a robot's wheels, before it is put down."""
        for name, value in zip(self.names, values, strict=True):
            change = PROPERTIES[name].traction
            if change is not None:
                change(traction, row, float(value))

    @property
    def randomizes_bodies(self) -> bool:
        """Whether bodies differ in more than their wheels' contacts."""
        return any(PROPERTIES[name].body is not None for name in self.names)

    @property
    def randomizes_latency(self) -> bool:
        """Whether commands come late."""
        return any(PROPERTIES[name].latency for name in self.names)

    def body(self, values: Sequence[float]) -> BodyVariation:
        """The robot of drawn `values`."""
        body = AS_DESCRIBED
        for name, value in zip(self.names, values, strict=True):
            change = PROPERTIES[name].body
            body = body if change is None else change(body, float(value))
        return body

    def latency_s(self, values: Sequence[float]) -> float:
        """How late commands reach the motors [s]."""
        drawn = zip(self.names, values, strict=True)
        return float(sum(value for name, value in drawn if PROPERTIES[name].latency))

    def prepare(self, seed: int, episodes: Sequence[int]) -> None:
        """Say that these episodes are to come."""
        if self.randomizes_worlds and self._prepare is not None:
            self._prepare([self.world_conf(self.draw(seed, episode)) for episode in episodes])
