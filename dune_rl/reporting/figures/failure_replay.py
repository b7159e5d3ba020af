"""Runs episodes of an evaluation again, to take pictures of the last seconds before they failed."""

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from tensordict import TensorDictBase

from dune_rl.core.errors import DuneError
from dune_rl.env.pictures import Moment, Pictures
from dune_rl.env.simulation import VectorSimulation
from dune_rl.evaluation.blocks import EpisodeBlock
from dune_rl.evaluation.folder import read_provenance, read_settings
from dune_rl.evaluation.policies import PolicySource
from dune_rl.evaluation.provenance import check_same_sources
from dune_rl.evaluation.running import BlockRunner, EvaluationPlan
from dune_rl.reporting.comparison import EvaluatedPolicy
from dune_rl.reporting.figures.results import COLLISION, FAILURES, failures_of
from dune_rl.reporting.figures.track_data import TrackSite
from dune_rl.reporting.rows import Row
from dune_rl.statistics.measures import MetricsRow

Picture = NDArray[np.uint8]
# Pictures are of these instants before a failure, and of the failure itself [s].
BEFORE_S = (3.0, 2.0, 1.0, 0.0)
_EVERY_S = 0.25
# A row that was repeated is the same if these are.
_COMPARED = ("steps", "collisions", "success")


@dataclass(frozen=True, eq=False)
class Replay:
    """Pictures (H, W, 3) of a failure at `before_s` [s] before it, which was `time_s` [s] after the start."""

    pictures: list[Picture]
    before_s: list[float]
    time_s: float


@dataclass(eq=False)
class Failure:
    """A failure of a method: its kind ("collision", or the metric of an ending) and the episode's row.

    It is one of `count` of its kind. It is shown by pictures (`replay`), or else by its `track` on a map; the
    `reason` says why it has no pictures.
    """

    method: EvaluatedPolicy
    kind: str
    row: Row
    count: int = 1
    replay: Replay | None = None
    track: TrackSite | None = None
    reason: str = ""

    @property
    def key(self) -> tuple[int, str]:
        """Number of the episode, and agent."""
        return int(self.row["episode"]), str(self.row["agent"])

    @property
    def kind_name(self) -> str:
        """What the kind is called."""
        return COLLISION.name if self.kind == COLLISION.name else FAILURES[self.kind].name

    @property
    def is_shown(self) -> bool:
        """Whether there are pictures, or a track."""
        return self.replay is not None or self.track is not None


@dataclass
class _Watched:
    """A wanted failure while its episode runs."""

    failure: Failure
    moments: deque[tuple[int, Moment]] = field(default_factory=deque)
    replay: Replay | None = None
    row: MetricsRow | None = None


def replay_failures(
    failures: Sequence[Failure], size: tuple[int, int], progress: Callable[[], None] = lambda: None
) -> None:
    """Give `failures` of one method their pictures, of `size` [px], or the reason why there are none.

    The episodes run as their evaluation ran them: in the same batches, as the last bits of a network depend
    on how many run side by side. With a built-in policy each runs by itself first, which is quicker. An
    episode that comes out otherwise than its row says gives no pictures. `progress` is called after each.
    """
    try:
        plan, source = _plan(failures[0].method)
    except DuneError as error:
        return _give_up(failures, str(error), progress)
    plan = replace(plan, sources=(source,))
    if source.kind == "built-in" and plan.scenes > 1:
        _replay(replace(plan, conf=plan.conf.model_copy(update={"scenes": 1})), failures, size, progress)
        failures, progress = [one for one in failures if one.replay is None], lambda: None
    if failures:
        _replay(plan, failures, size, progress)


def _replay(
    plan: EvaluationPlan, failures: Sequence[Failure], size: tuple[int, int], progress: Callable[[], None]
) -> None:
    try:
        runner = BlockRunner(plan)
    except (DuneError, OSError, ValueError) as error:
        return _give_up(failures, f"its episodes cannot be run: {error}", progress)
    try:
        for first in sorted({one.key[0] // plan.scenes * plan.scenes for one in failures}):
            count = min(plan.scenes, plan.episodes - first)
            watched = [_Watched(one) for one in failures if first <= one.key[0] < first + count]
            try:
                runner.watch(EpisodeBlock(0, first, count), _Watcher(runner, watched, size))
            except (DuneError, OSError, ValueError) as error:
                _give_up([each.failure for each in watched], f"its episode cannot be run: {error}", progress)
                continue
            for each in watched:
                _tell_outcome(each)
                progress()
    finally:
        runner.close()


def _give_up(failures: Sequence[Failure], reason: str, progress: Callable[[], None]) -> None:
    for one in failures:
        one.reason = reason.splitlines()[0]
        progress()


def _plan(method: EvaluatedPolicy) -> tuple[EvaluationPlan, PolicySource]:
    """The plan of a method's evaluation, and its policy; DuneError where these are not there any more."""
    conf = read_settings(method.run.path)
    if conf.protocol is not None:
        raise DuneError("its episodes are those of whole runs, which reports do not run again")
    plan = EvaluationPlan.of_settings(conf)
    source = next((each for each in plan.sources if each.name == method.policy), None)
    if source is None:
        raise DuneError("its policy is not among those of the settings")
    provenance, alone = read_provenance(method.run.path), replace(plan, sources=(source,))
    check_same_sources(alone, provenance, method.run.path, trusted=(source.location,))
    if source.kind == "callable":
        # A report must not run code that a folder names.
        raise DuneError("its policy is a function of a user's, which reports do not run")
    return plan, source


def _tell_outcome(watched: _Watched) -> None:
    failure, row, stored = watched.failure, watched.row, watched.failure.row
    if row is None:
        failure.reason = "its episode did not end"
        return
    known = [name for name in _COMPARED if name in stored and name in row]
    same = failures_of(row) == failures_of(stored)
    if not same or any(float(row[name]) != float(stored[name]) for name in known):
        failure.reason = "its episode came out differently on this machine"
    else:
        failure.replay = watched.replay
        failure.reason = "" if watched.replay else "its failure was not met again"


class _Watcher:
    """Takes the pictures of watched failures as their episodes run; an `EpisodeObserver`."""

    def __init__(self, runner: BlockRunner, watched: Sequence[_Watched], size: tuple[int, int]) -> None:
        self._simulation: VectorSimulation = runner.env.base_env.simulation
        self._agents = runner.agents
        self._pictures = Pictures(self._simulation)
        self._watched, self._size = watched, size
        self._step_s = self._simulation.physics.control_step_s
        self._every = max(1, round(_EVERY_S / self._step_s))
        self._kept = 1 + round(max(BEFORE_S) / self._step_s / self._every)

    def begin(self) -> None:
        """Nothing is known of an episode before its first step."""

    def step(self, after: TensorDictBase) -> None:
        """Note where everybody is, and render what was noted if a failure has happened."""
        for each in self._watched:
            if each.replay is None:
                self._look(each)

    def _look(self, watched: _Watched) -> None:
        episode, agent = watched.failure.key
        scenes = np.flatnonzero((self._simulation.episodes == episode) & ~self._simulation.resting)
        if not len(scenes):
            return
        scene = int(scenes[0])
        step = int(self._simulation.steps[scene])
        group = next(each for each in self._simulation.groups if agent in each.names)
        row = scene * group.count + group.names.index(agent)
        state = self._simulation.state.groups[group.name]
        if state.absent is not None and state.absent[row]:
            return
        failed = (
            bool(state.contacts.total[row]) if watched.failure.kind == "collision" else bool(group.done[row])
        )
        if failed or step % self._every == 0:
            watched.moments.append((step, self._pictures.moment(scene, agent)))
            if len(watched.moments) > self._kept + 1:
                watched.moments.popleft()
        if failed:
            watched.replay = self._render(watched.moments, scene, step)

    def _render(self, moments: Sequence[tuple[int, Moment]], scene: int, last: int) -> Replay:
        steps = np.array([step for step, _ in moments])
        wanted = last - np.array(BEFORE_S) / self._step_s
        # Before the start there is nothing to show.
        chosen = np.unique(np.abs(steps[:, None] - wanted[wanted > 0]).argmin(axis=0))
        width, height = self._size
        pictures = [self._pictures.of_moment(moments[at][1], scene, width, height) for at in chosen.tolist()]
        before = [(last - int(steps[at])) * self._step_s for at in chosen.tolist()]
        return Replay(pictures, before, last * self._step_s)

    def finish(self, rows: Mapping[str, list[MetricsRow]]) -> None:
        """Keep the rows of watched episodes."""
        for group, agents in rows.items():
            for row in agents:
                name = self._agents[group][int(row["agent"])]
                for each in self._watched:
                    if each.failure.key == (int(row["episode"]), name):
                        each.row = dict(row)
