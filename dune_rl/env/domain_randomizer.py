"""Domain randomisation: world, weather, contacts and body of each episode, from (seed, episode) alone."""

from collections.abc import Callable, Sequence
from typing import Any

from dune_rl.core.seeding import stream
from dune_rl.env.episodes.plan import EpisodePlan
from dune_rl.env.randomisation import PROPERTIES, RandomisationConf
from dune_rl.env.traction import Traction
from dune_rl.physics.varied_body import AS_DESCRIBED, BodyVariation
from dune_rl.rendering.weather import WeatherConf
from dune_rl.worlds.world import World

Values = tuple[float, ...]

_WORLD_SEED = "world_seed"


class DomainRandomizer:
    """Samples the properties of `randomisation` for an episode, and applies them.

    `make_world` builds a world from settings such as `world_conf`; equal settings
    should give the same object while it is in use. `prepare` gets the settings
    of the next worlds, and may build these in the background. `names` are the
    sampled properties, in the order of `Values`. The world seeds of a `plan`
    replace sampled ones.
    """

    def __init__(
        self,
        world_conf: Any,
        weather: WeatherConf,
        randomisation: RandomisationConf,
        make_world: Callable[[Any], World],
        prepare: Callable[[Sequence[Any]], None] | None = None,
        plan: EpisodePlan | None = None,
    ) -> None:
        self._world_conf, self._weather = world_conf, weather
        self._distributions = randomisation.distributions
        self._make_world, self._prepare = make_world, prepare
        self._plan = plan if plan is not None and plan.sets_worlds else None
        planned = () if self._plan is None else (_WORLD_SEED,)
        self.names = tuple(dict.fromkeys((*planned, *self._distributions)))

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
        values: list[float] = []
        for name in self.names:
            if self._plan is not None and name == _WORLD_SEED:
                seed_of_world = self._plan.of(episode).world_seed
                assert seed_of_world is not None
                values.append(seed_of_world)
                continue
            drawn = PROPERTIES[name]
            again = (attempt,) if attempt and drawn.world is not None else ()
            rng = stream(seed, f"randomisation {drawn.stream or name}", episode, *again)
            values.append(self._distributions[name].draw(rng))
        return tuple(values)

    def world_conf(self, values: Values) -> Any:
        """World settings with sampled `values`."""
        conf = self._world_conf
        for name, value in zip(self.names, values, strict=True):
            change = PROPERTIES[name].world
            conf = conf if change is None else change(conf, value)
        return conf

    def world(self, conf: Any) -> World:
        """The world of `conf`; raises WorldError if it cannot be built."""
        return self._make_world(conf)

    def weather(self, values: Values) -> WeatherConf:
        """Weather with sampled `values`."""
        weather = self._weather
        for name, value in zip(self.names, values, strict=True):
            change = PROPERTIES[name].weather
            weather = weather if change is None else change(weather, value)
        return weather

    def apply_to_contacts(self, traction: Traction, row: int, values: Sequence[float]) -> None:
        """Set the contact factors of a robot's wheels, before its start."""
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
        """Whether commands are delayed."""
        return any(PROPERTIES[name].latency for name in self.names)

    def body(self, values: Sequence[float]) -> BodyVariation:
        """Masses and motor strength of the robot with sampled `values`."""
        body = AS_DESCRIBED
        for name, value in zip(self.names, values, strict=True):
            change = PROPERTIES[name].body
            body = body if change is None else change(body, float(value))
        return body

    def latency_s(self, values: Sequence[float]) -> float:
        """Delay of motor commands [s]."""
        sampled = zip(self.names, values, strict=True)
        return float(sum(value for name, value in sampled if PROPERTIES[name].latency))

    def prepare(self, seed: int, episodes: Sequence[int]) -> None:
        """Announce the next episodes, so that their worlds can be built in the background."""
        if self.randomizes_worlds and self._prepare is not None:
            self._prepare([self.world_conf(self.draw(seed, episode)) for episode in episodes])
