"""Domain randomisation: world, weather, contacts and body of each episode, from (seed, episode) alone."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from functools import lru_cache
from typing import Any

from dune_rl.core.seeding import stream
from dune_rl.env.randomisation import RANDOMISATIONS, RandomisationConf
from dune_rl.env.randomised_properties import EpisodeVariation
from dune_rl.env.requests import EpisodePlan
from dune_rl.rendering.weather import WeatherConf
from dune_rl.worlds.world import World

Values = tuple[float, ...]

_WORLD_SEED = "world_seed"
# Random streams are named by former names of the properties, so that a seed keeps its episodes.
_STREAMS = {"sun_bearing_deg": "sun_bearing_rad", "sun_elevation_deg": "sun_elevation_rad"}


class DomainRandomizer:
    """Samples the properties of `randomisation` for an episode, and applies them.

    `make_world` builds a world from its settings; equal settings
    should give the same object while it is in use. `prepare` gets the settings
    of the next worlds, and may build these in the background. `names` are the
    sampled properties, in the order of `Values`. The world seeds of a `plan`, or
    the numbers of its worlds, replace sampled seeds. `easiest` are the values of
    properties at a difficulty of 0, from which they rise or fall linearly to the
    drawn ones. Of `num_scenes` scenes, each keeps its world for
    `randomisation.episodes_per_world` episodes.
    """

    def __init__(
        self,
        world_conf: Any,
        weather: WeatherConf,
        randomisation: RandomisationConf,
        make_world: Callable[[Any], World],
        prepare: Callable[[Sequence[Any]], None] | None = None,
        plan: EpisodePlan | None = None,
        easiest: Mapping[str, float] | None = None,
        num_scenes: int = 1,
    ) -> None:
        self._easiest = dict(easiest or {})
        own_extent = None if world_conf is None else world_conf.common_extent
        self.common_extent = own_extent if plan is None or plan.bounds is None else plan.bounds
        self._unvaried = EpisodeVariation(world_conf, weather)
        self._distributions = randomisation.distributions
        self._make_world, self._prepare = make_world, prepare
        self._num_scenes, self._episodes_per_world = num_scenes, randomisation.episodes_per_world
        self._plan = plan if plan is not None and plan.sets_worlds else None
        planned = () if self._plan is None else (_WORLD_SEED,)
        self.names = tuple(dict.fromkeys((*planned, *self._distributions)))
        self._changes = {name: self._changed_fields(name) for name in self.names}
        # An episode asks for the same variation several times, for its world and for each robot.
        self._vary_once = lru_cache(maxsize=16)(self._vary)
        changed = frozenset[str]().union(*self._changes.values())
        # Whether worlds differ, bodies differ in more than their wheels' contacts, and commands are delayed.
        self.randomizes_worlds = "world" in changed
        self.randomizes_bodies = "body" in changed
        self.randomizes_latency = "latency_s" in changed

    @classmethod
    def none(cls, world: World, weather: WeatherConf) -> "DomainRandomizer":
        """Every episode in the same world and weather."""
        return cls(None, weather, RandomisationConf(), lambda _: world)

    def _changed_fields(self, name: str) -> frozenset[str]:
        """Names of the fields of an `EpisodeVariation` that a property changes."""
        least = self._distributions[name].limits[0] if name in self._distributions else 0.0
        varied = self._apply(name, self._unvaried, least)
        names = (field.name for field in fields(EpisodeVariation))
        return frozenset(each for each in names if getattr(varied, each) is not getattr(self._unvaried, each))

    def _apply(self, name: str, variation: EpisodeVariation, value: float) -> EpisodeVariation:
        if name == _WORLD_SEED and self._plan is not None and self._plan.worlds:
            return replace(variation, world=self._plan.worlds[int(value)])
        part = RANDOMISATIONS.find(name)
        assert part is not None
        drawn: dict[str, Any] = {"name": name, "value": value}
        return RANDOMISATIONS.build(part.settings.model_construct(**drawn), variation)

    def _vary(self, values: Values) -> EpisodeVariation:
        variation = self._unvaried
        for name, value in zip(self.names, values, strict=True):
            variation = self._apply(name, variation, float(value))
        return variation

    def variation(self, values: Sequence[float]) -> EpisodeVariation:
        """World settings, weather, contacts, body and latency of an episode with sampled `values`."""
        return self._vary_once(tuple(values))

    def draw(self, seed: int, episode: int, attempt: int = 0, difficulty: float = 1.0) -> Values:
        """The values of an episode; a further `attempt` draws another world and leaves the rest alone."""
        values: list[float] = []
        first = self._first_with_world_of(episode)
        for name in self.names:
            if self._plan is not None and name == _WORLD_SEED:
                seed_of_world = self._plan.of(episode).world_seed
                assert seed_of_world is not None
                values.append(seed_of_world)
                continue
            is_of_world = "world" in self._changes[name]
            again = (attempt,) if attempt and is_of_world else ()
            stream_name = f"randomisation {_STREAMS.get(name, name)}"
            rng = stream(seed, stream_name, first if is_of_world else episode, *again)
            value = self._distributions[name].draw(rng)
            if name in self._easiest and difficulty < 1.0:
                value = self._easiest[name] + difficulty * (value - self._easiest[name])
            values.append(value)
        return tuple(values)

    def _first_with_world_of(self, episode: int) -> int:
        """The scene's first episode in the world of `episode`."""
        return episode - episode // self._num_scenes % self._episodes_per_world * self._num_scenes

    def world(self, conf: Any) -> World:
        """The world of `conf`; raises WorldError if it cannot be built."""
        return self._make_world(conf)

    def prepare(self, seed: int, episodes: Sequence[int], difficulty: float = 1.0) -> None:
        """Announce the worlds after those of `episodes`, so that they can be built in the background."""
        if self.randomizes_worlds and self._prepare is not None:
            step = self._episodes_per_world * self._num_scenes
            following = (self._first_with_world_of(episode) + step for episode in episodes)
            self._prepare(
                [
                    self.variation(self.draw(seed, episode, difficulty=difficulty)).world
                    for episode in following
                ]
            )
