"""M scenes with agent groups, stepped together: physics one after another, everything else as arrays."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.core.errors import ConfigError
from dune_rl.env.agent_group import AgentGroup, GroupSetup, GroupStep
from dune_rl.env.arguments import check_whole, group_actions
from dune_rl.env.assembly import add_sensors, build_groups
from dune_rl.env.body import SceneBodies
from dune_rl.env.curriculum import Curriculum, CurriculumConf
from dune_rl.env.domain_randomizer import DomainRandomizer
from dune_rl.env.replay import ActionLog, RestoreError, check_arrival, state_digest
from dune_rl.env.requests import EpisodePlan, EpisodeRequest, plain_request, request_from_plain
from dune_rl.env.scene_manager import MakeScene, SceneManager, scene_rows
from dune_rl.env.starts.episode_start import EpisodeStarter, kinematic_poses
from dune_rl.env.starts.placement import admit_arrivals
from dune_rl.env.starts.source import StartDraw
from dune_rl.env.state_builder import StateBuilder
from dune_rl.geometry.arrays import Array, Flags, Floats
from dune_rl.metrics.episode import MetricsConf, MetricSet
from dune_rl.physics.interface import PhysicsConf
from dune_rl.rendering.weather import WeatherConf
from dune_rl.sensors.sensor import Reading
from dune_rl.state.state import GroupState, State
from dune_rl.worlds.batched_worlds import BatchedWorlds
from dune_rl.worlds.world import World

_CLEAR = WeatherConf()
_CLOSED = "the environment is closed: make another"
_NOT_BEGUN = "call reset() before step()"


@dataclass(frozen=True)
class SimulationStep:
    """Result of a control step: rewards and ends of each external group, and flags (M,) of ended episodes."""

    groups: dict[str, GroupStep]
    terminated: Flags
    truncated: Flags

    @property
    def done(self) -> Flags:
        """Which scenes' episodes have ended, (M,); they must be reset before the next step."""
        return self.terminated | self.truncated

    def followed_by(self, later: "SimulationStep") -> "SimulationStep":
        """The result of both steps: sums of rewards, and the ends of scenes that had not ended before."""
        groups = {
            name: replace(step, reward=self.groups[name].reward + step.reward)
            for name, step in later.groups.items()
        }
        going_on = ~self.done
        return SimulationStep(
            groups,
            self.terminated | (later.terminated & going_on),
            self.truncated | (later.truncated & going_on),
        )


class VectorSimulation:
    """M scenes with the same agent groups, stepped together; every environment wraps one.

    Scene i runs the episodes `first_episode + i`, `+ i + M`, `+ i + 2M` and so on. All random
    draws of an episode depend on (seed, episode id) alone, so simulations of the same seed start an episode
    in the same state; worlds that are kept for several episodes also depend on M. A scene's episode ends when
    all agents of the groups with terminations are done, or when physics diverges; where agents come and go,
    also when no external agent is left. `world` is the world of all scenes, unless `randomizer` draws worlds.
    A `plan` has the starts and goals of episodes in place of sampled ones; its world seeds are the
    randomizer's. With a `curriculum` an episode also depends on the level at its start, and so on the
    outcomes of earlier episodes.
    """

    def __init__(
        self,
        *,
        world: World,
        groups: Sequence[GroupSetup],
        make_scene: MakeScene,
        physics: PhysicsConf,
        num_scenes: int,
        seed: int = 0,
        first_episode: int = 0,
        weather: WeatherConf = _CLEAR,
        randomizer: DomainRandomizer | None = None,
        plan: EpisodePlan | None = None,
        curriculum: CurriculumConf | None = None,
    ) -> None:
        self.physics, self.weather, self.num_scenes = physics, weather, num_scenes
        self.randomizer = DomainRandomizer.none(world, weather) if randomizer is None else randomizer
        measures_work = any(setup.metrics is not None and setup.metrics.energy for setup in groups)
        self.scenes = SceneManager(
            world, weather, self.randomizer, make_scene, physics, num_scenes, measures_work=measures_work
        )
        self.groups = build_groups(groups, self.scenes)
        self.external = tuple(group for group in self.groups if group.is_external)
        self._starter = EpisodeStarter(self.groups, self.scenes)
        self._builder = StateBuilder(self.groups, self.scenes.worlds, physics.control_step_s)
        add_sensors(self.groups, self._builder, self.scenes)
        self.scenes.build(sum((group.body.shapes(group.names) for group in self.groups), SceneBodies()))
        self._starter.check(seed, world, sets_starts=plan is not None)
        self._first_world = world
        self._ending = [group for group in self.groups if group.ends_episodes]
        self._kinematic = [group for group in self.groups if not group.description.is_robot]
        self._visiting = [group for group in self.groups if group.presence is not None]
        self._nobody = self.resting = np.zeros(num_scenes, bool)
        self.steps = np.zeros(num_scenes, np.int64)
        self._ends = np.cumsum([group.count * group.action_size for group in self.external]).tolist()
        self._log = ActionLog(num_scenes, self._ends[-1] if self._ends else 0)
        self.seed = seed
        self._requests: dict[int, EpisodeRequest] = {}
        self._plan = plan
        self.state: State
        self._refusal = _NOT_BEGUN
        # Called after every control step, also between those of a held action.
        self.watchers: list[Callable[[], None]] = []
        self.curriculum = Curriculum(curriculum, num_scenes)
        self._curriculum_group = "" if curriculum is None else self._measured_group(curriculum)
        self.reseed(seed, first_episode)

    def _measured_group(self, conf: CurriculumConf) -> str:
        """The name of the group whose outcomes a curriculum has; raises ConfigError if there is none."""
        for group in self.external:
            if conf.group in (None, group.name) and conf.measure in group.metric_names:
                return group.name
        whose = "an external group" if conf.group is None else f"the group {conf.group!r}"
        raise ConfigError(
            f"learning.curriculum: {whose} with the metric {conf.measure!r} is not here; external groups are "
            f"{', '.join(group.name for group in self.external) or 'none'}"
        )

    # -- contents ---------------------------------------------------------------------------------

    def group(self, name: str | None = None) -> AgentGroup:
        """The group of this name; None: the first external group, or the first group if none is external."""
        if name is None:
            return self.external[0] if self.external else self.groups[0]
        return next(group for group in self.groups if group.name == name)

    @property
    def worlds(self) -> BatchedWorlds:
        """The worlds of all scenes."""
        return self.scenes.worlds

    @property
    def agents(self) -> tuple[str, ...]:
        """Names of the agents of external groups, whose actions `step` takes."""
        return tuple(name for group in self.external for name in group.names)

    @property
    def randomized(self) -> dict[str, Array]:
        """Sampled values of the present episodes, (M,) each, by name of the randomised property."""
        return dict(zip(self.randomizer.names, self.scenes.values.T, strict=True))

    # -- episodes ---------------------------------------------------------------------------------

    def reseed(self, seed: int, first_episode: int = 0) -> None:
        """Let the next `reset`, which must be of all scenes, start at episode `first_episode` of `seed`."""
        check_whole("seed", seed, at_least=0)
        if seed != self.seed:
            self._starter.replan(seed, self._first_world)
        self.seed = seed
        self.episodes = first_episode + np.arange(self.num_scenes) - self.num_scenes

    def reset(self, mask: Flags | None = None, requests: Mapping[int, EpisodeRequest] | None = None) -> None:
        """Start the next episode in the scenes in `mask` (M,); None: in all.

        `requests` are starts and goals in place of sampled ones, by scene; ValueError says which is not free.
        After an error all scenes must be reset, and the episode's number is not used up.
        """
        if mask is None:
            mask = np.ones(self.num_scenes, bool)
        kept = {scene: request for scene, request in self._requests.items() if not mask[scene]}
        before = self._requests, self.episodes
        self._requests = {**kept, **(requests or {})}
        self.curriculum.begin(mask)
        self.episodes = np.where(mask, self.episodes + self.num_scenes, self.episodes)
        try:
            self._start(mask)
        except Exception:
            self._requests, self.episodes = before
            raise

    def _start(self, mask: Flags) -> None:
        """Start the present episodes of the scenes in `mask` (M,)."""
        if self._refusal == _CLOSED:
            raise RuntimeError(_CLOSED)
        if self._refusal and not mask.all():
            raise RuntimeError("the first reset must be of all scenes")
        self._refusal = _NOT_BEGUN
        self.resting = self.resting & ~mask
        for group in self.groups:
            group.reset(scene_rows(mask, group.count))
        self.steps = np.where(mask, 0, self.steps)
        for scene in np.flatnonzero(mask).tolist():
            episode, difficulty = int(self.episodes[scene]), float(self.curriculum.difficulty[scene])
            draw = StartDraw(scene, self.seed, episode, difficulty=difficulty)
            self._starter.start(draw, self._request(scene, episode))
        self.randomizer.prepare(self.seed, self.episodes[mask].tolist(), self.curriculum.level)
        for group in self.groups:
            group.read_start(scene_rows(mask, group.count), self.scenes.most_bodies)
        self._builder.begin_episodes(self.episodes)
        before = None if mask.all() else self.state
        self.state = state = self._builder.start(mask, self.seed, self.steps, before)
        for group in self.groups:
            group.begin(scene_rows(mask, group.count), state)
        self._refusal = ""

    def rest(self, mask: Flags) -> None:
        """Leave the scenes in `mask` (M,) out of the physics until they are reset: they are `resting` (M,).

        `step` reads from their robots what it read last; whether their episodes end says nothing any more.
        """
        self.resting = self.resting | mask

    def _request(self, scene: int, episode: int) -> EpisodeRequest:
        """The planned starts and goals of an episode, and those that the caller of `reset` asked for."""
        planned = {} if self._plan is None else self._plan.of(episode).request
        return {**planned, **self._requests.get(scene, {})}

    def check_begun(self) -> None:
        """Raise RuntimeError, with what to do, before the first `reset` and after `close`."""
        if self._refusal:
            raise RuntimeError(self._refusal)

    # -- a step -----------------------------------------------------------------------------------

    def step(self, actions: Mapping[str, NDArray[np.floating]]) -> SimulationStep:
        """Advance all scenes by one control step.

        `actions` has an array (M, G, A) for each external group, by name, in physical units. Raises KeyError
        if a group is missing.
        """
        self.check_begun()
        commands = {group.name: self._rows(group, actions) for group in self.external}
        self._log.add(self.steps, [commands[group.name] for group in self.external])
        for group in self._visiting:
            group.leave()
        for group in self.groups:
            group.command(commands.get(group.name), self.state)
        self._advance_physics()
        self.steps = self.steps + 1
        contacts = {group.name: group.body.read() for group in self.groups}
        if self._visiting:
            difficulty = self.curriculum.difficulty
            admit_arrivals(self.groups, self.seed, self.episodes, self.steps, difficulty)
        state = self._builder.build(self.seed, self.steps, contacts, self.scenes.count_statics)
        evaluated = {group.name: group.evaluate(state) for group in self.groups}
        terminated, truncated = self._scene_ends(state)
        self.curriculum.end(terminated | truncated, self._episode_values)
        self.state = state = self._next_state(state, evaluated)
        for group in self.groups:
            group.sense(state)
        steps = {
            group.name: GroupStep(evaluated[group.name][0], group.terminated.copy(), group.truncated.copy())
            for group in self.external
        }
        for watch in self.watchers:
            watch()
        return SimulationStep(steps, terminated, truncated)

    def advance(self, actions: Mapping[str, NDArray[np.floating]]) -> SimulationStep:
        """Advance all scenes by `physics.action_repeat` control steps with the same actions.

        Rewards are summed. A scene whose episode ends rests until it is reset.
        """
        result = self.step(actions)
        for _ in range(self.physics.action_repeat - 1):
            done = result.done
            if done.all():
                break
            if done.any():
                self.rest(done)
            result = result.followed_by(self.step(actions))
        return result

    def _advance_physics(self) -> None:
        """Advance all scenes, and set kinematic bodies to where robots blocked them."""
        held_back = self.scenes.step(kinematic_poses(self._kinematic, self.num_scenes), self.resting)
        if held_back:
            scenes, poses = np.array(list(held_back)), np.array(list(held_back.values()))
            for group in self._kinematic:
                first = group.body.first
                group.hold_back(scenes, poses[:, first : first + group.count])

    def _next_state(self, state: State, evaluated: Mapping[str, tuple[Floats, GroupState]]) -> State:
        """The state with which the next step begins: another where goals are renewed or agents have come."""
        groups = {name: group for name, (_, group) in evaluated.items()}
        is_same = all(group is state.groups[name] for name, group in groups.items())
        return state if is_same else replace(state, groups=groups)

    def _rows(self, group: AgentGroup, actions: Mapping[str, NDArray[np.floating]]) -> Array:
        """A group's actions, (N, A)."""
        if group.name not in actions:
            raise KeyError(f"step needs actions of the group {group.name!r}; it got {sorted(actions)}")
        shape = (self.num_scenes, group.count, group.action_size)
        return group_actions(group.name, actions[group.name], shape)

    def _scene_ends(self, state: State) -> tuple[Flags, Flags]:
        """Flags (M,) of scenes whose episodes terminate, and of those whose episodes are truncated."""
        over, terminated = self._nobody, self._nobody
        for index, group in enumerate(self._ending):
            # Those who have left, or may come yet, do not keep others from an end.
            absent = False if group.presence is None else group.presence.absent
            done, own = self._all(group, group.done), self._all(group, group.terminated | absent)
            over, terminated = (over & done, terminated & own) if index else (done, own)
        presences = [group.presence for group in self._ending if group.presence is not None]
        if presences and len(presences) == len(self._ending):
            # Before any of them has come, nothing can have ended.
            came = np.concatenate([each.came.reshape(self.num_scenes, -1) for each in presences], axis=1)
            over = over & came.any(axis=1)
        if any(group.is_external for group in self._visiting):
            left = [self._all(group, group.done) for group in self.external]
            over = over | np.logical_and.reduce(left)
        for group in self.groups:
            diverged = state.groups[group.name].motion.diverged
            if diverged.any():
                # One diverged body may have corrupted the states of all others in its scene.
                over = over | diverged.reshape(self.num_scenes, -1).any(axis=1)
        if not over.any():
            return self._nobody.copy(), self._nobody.copy()
        for group in self.groups:
            group.truncate(scene_rows(over, group.count))
        terminated = terminated & over
        return terminated, over & ~terminated

    def _episode_values(self, metric: str) -> Array:
        """Values (M,) of a metric of the present episodes: the mean over the agents of a group that came."""
        group = self._curriculum_group
        column = self.group(group).metric_names.index(metric)
        values = self.metrics(group)[..., column].astype(np.float64)
        came = ~np.isnan(values)
        counts = came.sum(axis=1)
        sums = np.where(came, values, 0.0).sum(axis=1)
        return np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)

    def _all(self, group: AgentGroup, flags: Flags) -> Flags:
        """Flags (M,) of scenes in which `flags` (N,) are True for all of a group's agents."""
        if group.count == 1:
            return flags
        every: Flags = np.logical_and.reduce(flags.reshape(self.num_scenes, -1), axis=1)
        return every

    def step_passive(self) -> None:
        """Advance only physics by a control step, with the last commands; for benchmarks."""
        self.scenes.step_passive()

    # -- observations and metrics -----------------------------------------------------------------

    def observe(self, group: str | None = None) -> dict[str, Reading]:
        """Observations of a group by sensor name, each (M, G, ...). Repeated calls return the same values."""
        found = self.group(group)
        readings = found.observe()
        return {name: value.reshape(-1, found.count, *value.shape[1:]) for name, value in readings.items()}

    def metric_names(self, group: str | None = None) -> tuple[str, ...]:
        """Names of the columns of `metrics`."""
        sampled = (f"randomisation/{name}" for name in self.randomizer.names)
        return (*self.group(group).metric_names, *sampled)

    def metrics(self, group: str | None = None) -> Floats:
        """Metrics of the present episodes so far, (M, G, n); final for agents that are done."""
        found = self.group(group)
        values = found.metrics()
        if self.randomizer.names:
            values.append(np.repeat(self.scenes.values, found.count, axis=0))
        if not values:
            return np.zeros((self.num_scenes, found.count, 0), np.float32)
        return np.concatenate(values, axis=1).astype(np.float32).reshape(self.num_scenes, found.count, -1)

    def add_metrics(self, group: str, conf: MetricsConf) -> MetricSet:
        """Measure `conf` of a group's episodes as well, from now on; equal settings share one set."""
        found = self.group(group)
        return found.add_metrics(conf, None if self._refusal else self.state.groups[found.name])

    def joint_angles(self, group: str, row: int) -> dict[str, float]:
        """Joint angles [rad] by name of a group's robot in `row`; empty for a kinematic body."""
        return self.group(group).body.joint_angles(row)

    def save_state(self) -> dict[str, Any]:
        """Plain data from which `restore` rebuilds the state: each episode's id and actions so far."""
        return {
            "seed": self.seed,
            "episodes": self.episodes.tolist(),
            "actions": self._log.plain(self.steps),
            "requests": {scene: plain_request(request) for scene, request in self._requests.items()},
            "digest": state_digest(self.state),
            "curriculum": self.curriculum.state(),
        }

    def save_point(self) -> dict[str, Any]:
        """As `save_state`, also before the first episode and after `close`."""
        begun = {} if self._refusal else self.save_state()
        added = {group.name: group.measured.added for group in self.groups}
        episodes = self.episodes.tolist()
        return {"refusal": self._refusal, "seed": self.seed, "episodes": episodes, "metrics": added, **begun}

    def return_to(self, point: dict[str, Any]) -> None:
        """Restore what `save_point` returned; raises as `restore`."""
        for name, confs in point["metrics"].items():
            for conf in confs:
                self.add_metrics(name, MetricsConf.model_validate(conf))
        if not point["refusal"]:
            self.restore(point)
            return
        self.reseed(point["seed"])
        self.episodes = np.array(point["episodes"], np.int64)
        if point["refusal"] == _CLOSED:
            self.close()

    def restore(self, saved: dict[str, Any]) -> None:
        """Restore a saved state bit for bit, by repeating its episodes' actions from their starts.

        Raises `RestoreError` if the resulting state differs, as it may on another processor.
        """
        width = self._ends[-1] if self._ends else 0
        if len(saved["actions"]) != self.num_scenes or any(
            len(action) != width for actions in saved["actions"] for action in actions[:1]
        ):
            raise RestoreError(
                "the episodes under way cannot be played again: they had other scenes or other agents."
            )
        self.reseed(int(saved["seed"]))
        self.episodes = np.array(saved["episodes"], np.int64)
        requests = saved.get("requests", {})
        self._requests = {int(scene): request_from_plain(plain) for scene, plain in requests.items()}
        self.curriculum.restore(saved.get("curriculum"))
        lengths = np.array([len(actions) for actions in saved["actions"]])
        rows = self._log.aligned(saved["actions"])
        self._start(np.ones(self.num_scenes, bool))
        for turn, row in enumerate(rows):
            # Shorter episodes start later, so that all end at the same step.
            starting = lengths == len(rows) - turn
            if starting.any():
                self._start(starting)
            parts = np.split(row, self._ends[:-1], axis=1)
            shapes = ((self.num_scenes, group.count, group.action_size) for group in self.external)
            actions = {
                group.name: part.reshape(shape)
                for group, part, shape in zip(self.external, parts, shapes, strict=True)
            }
            self.step(actions)
        if (lengths == 0).any():
            self._start(lengths == 0)
        # Episodes that ended while these were repeated do not count.
        self.curriculum.restore(saved.get("curriculum"))
        check_arrival(saved.get("digest"), self.state)

    def close(self) -> None:
        """Release the physics engine."""
        self._refusal = _CLOSED
        self.scenes.close()
