"""The training loop: collect, learn, evaluate and save, for every agent group that trains."""

import errno
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase

from dune_rl.core.errors import (
    CheckpointError,
    ConfigError,
    DivergenceError,
    DuneError,
    DuneWarning,
    TrainingError,
)
from dune_rl.core.folder_lock import FolderLock
from dune_rl.core.suggestions import typed_word
from dune_rl.env.curriculum import CurriculumConf
from dune_rl.learning.algorithm import MakeEnv
from dune_rl.learning.checkpoint import (
    CHECKPOINT_FILE,
    find_checkpoint_file,
    interpreting,
    read_progress,
)
from dune_rl.learning.collector import TransitionCollector, learner_threads
from dune_rl.learning.evaluation import EvaluationPictures, PeriodicEvaluation
from dune_rl.learning.group_policy import select_group
from dune_rl.learning.learners import build_learners, restore_learners, start_learners
from dune_rl.learning.policies import WarmUp
from dune_rl.learning.policy_spec import PolicySpec
from dune_rl.learning.population import make_population
from dune_rl.learning.process import (
    StopRequest,
    closing_all,
    keep_freed_memory,
    preserve_random_state,
    random_state,
    set_random_state,
    start_resource_tracker,
    stop_on_signals,
)
from dune_rl.learning.run.diverged import DivergedScenes
from dune_rl.learning.run.finite import SkippedUpdates, check_weights
from dune_rl.learning.run.folder import RunFolder
from dune_rl.learning.run.log import RunLog
from dune_rl.learning.run.progress import Reporter, RunStatus
from dune_rl.learning.run.tensorboard import HParam
from dune_rl.learning.settings import LearningConf
from dune_rl.statistics.measures import MetricsRow

# The writer of TensorBoard's file names no file.
_DISK_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO)


@dataclass(frozen=True)
class TrainingResult:
    """Result of a run. `signal` is the number of the signal that stopped it early, or None.

    `updates` is the sum over the groups. `specs` are those of the policies. `evaluation` holds the episodes
    of the last evaluation, by group, and `best_evaluation` those of the best policy; `history` holds the
    rows of metrics.csv.
    """

    run_dir: Path
    frames: int
    updates: int
    signal: int | None
    specs: dict[str, PolicySpec]
    evaluation: dict[str, list[MetricsRow]]
    best_evaluation: dict[str, list[MetricsRow]]
    history: list[dict[str, Any]]


class Trainer:
    """Trains the agent groups of an environment in `run_dir`, from scratch or from a checkpoint (`resume`).

    Every group of `env.group_map` has its own learner, or acts by a frozen policy; `learning` has the
    algorithm and its settings. `make_env(num_scenes, seed)` must be picklable unless the collector is serial;
    with `learning.curriculum` it also takes `curriculum`. Evaluations have the environment of
    `make_evaluation_env`, None: the same.
    `config` is the resolved configuration as plain containers; it is stored with the weights. With a serial
    collector, a run that was stopped and resumed ends with the same weights as an uninterrupted one, but
    while a driver teaches or demonstrates, which forgets what it saw; with
    worker processes, a resumed run starts new episodes. TensorBoard lists `hyperparameters` beside the
    results, and shows what `make_pictures(env, episodes)` draws of the first episodes of each evaluation. The
    best policies are those with which the group `judged` does best; None: all groups in the mean. The caller
    may hold the `lock` of the folder, and then ends it.

    Raises CheckpointError if the folder cannot be written, already holds a
    run, or the checkpoint does not fit. `train` may be called once.
    """

    def __init__(
        self,
        make_env: MakeEnv,
        run_dir: Path,
        learning: LearningConf,
        *,
        seed: int,
        total_frames: int,
        device: str = "cpu",
        config: Mapping[str, Any] | None = None,
        resume: Path | None = None,
        reporter: Reporter | None = None,
        title: str = "",
        hyperparameters: Mapping[str, HParam] | None = None,
        make_pictures: Callable[[EnvBase, int], EvaluationPictures] | None = None,
        judged: str | None = None,
        action_repeat: int = 1,
        make_evaluation_env: MakeEnv | None = None,
        lock: FolderLock | None = None,
    ) -> None:
        start_resource_tracker()
        source = find_checkpoint_file(resume, CHECKPOINT_FILE) if resume else None
        self._saved = read_progress(source) if source else None
        learning = learning.resolved(device)
        if self._saved is not None:
            for note in learning.notes_on_resuming(self._saved["config"].get("learning") or {}, device):
                warnings.warn(note, DuneWarning, stacklevel=2)
        config = {**(config or {}), "learning": learning.model_dump(mode="json")}
        self._folder = RunFolder(run_dir, config, fresh=source is None, lock=lock)
        self._make_env, self._conf = make_env, learning
        self._seed, self._total_frames = seed, total_frames
        self._reporter = reporter or Reporter()
        self._title = title or run_dir.name
        self._threads = learning.threads or learner_threads(learning.collector)

        evaluation = learning.evaluation
        evaluation_seed = seed + evaluation.seed_offset
        make_evaluation_env = make_evaluation_env or make_env
        env = make_evaluation_env(min(evaluation.scenes, evaluation.episodes), evaluation_seed)
        torch.manual_seed(seed)
        np.random.seed(seed % 2**32)
        self._learners = build_learners(learning, env, total_frames, run_dir, torch.device(device))
        self._evaluation = PeriodicEvaluation(evaluation, env, self._learners, evaluation_seed, judged)
        self._population = make_population(learning.population, self._learners)
        self.frames = 0
        self._next_save = learning.checkpoint.every_frames
        self._level: float | None = None
        self._judged, self._action_repeat = judged, action_repeat
        self._warmup = WarmUp(self._learners)
        self._collector: TransitionCollector | None = None
        self._diverged = DivergedScenes(env.metric_names, self._reporter.note)
        self._updates_left_out = SkippedUpdates(self._learners, self._reporter.note)
        self._status = RunStatus(self._reporter, self._evaluation, total_frames)
        if self._saved is None:
            self._folder.started_from = start_learners(self._learners, learning)
        elif source is not None:
            restore_learners(self._learners, self._saved["groups"], source, learning)
            self._folder.started_from = self._saved.get("started_from", {})
            with interpreting(source):
                counters = self._saved["counters"]
                self.frames, self._next_save = counters["frames"], counters["next_save"]
                self._level = self._saved["collector"].get("level")
                self._evaluation.restore(counters)
                if self._population is not None and self._saved["population"] is not None:
                    self._population.restore(self._saved["population"])
                # It is set when the collector is made, when it is too late to refuse the file.
                with preserve_random_state():
                    set_random_state(self._saved["random"])
        self._pictures = None
        if make_pictures is not None and evaluation.tracks:
            self._pictures = make_pictures(env, min(evaluation.tracks, evaluation.episodes))
        resumed_at = None if self._saved is None else self.frames
        self._folder.save_config()
        self._log = RunLog(run_dir, env.metric_names, resumed_at=resumed_at)
        if self._saved is not None and source is not None:
            with interpreting(source):
                self._log.restore(self._saved["log"])
        self._log.begin_session(hyperparameters or {})

    @property
    def config(self) -> dict[str, Any]:
        """The configuration as it is stored with the weights, with what the machine decided."""
        return self._folder.config

    @property
    def warms_up_throughout(self) -> bool:
        """Whether other policies than those that learn would drive until `total_frames`."""
        return self._warmup.goes_on(self._total_frames - 1)

    @property
    def updates(self) -> int:
        return sum(self._updates.values())

    @property
    def _updates(self) -> dict[str, int]:
        return {group: learner.updates for group, learner in self._learners.items()}

    def train(self, stop_after_frames: int | None = None) -> TrainingResult:
        """Run until `total_frames`, or until a signal or `stop_after_frames` ends it early.

        An early end saves everything that resuming needs. A full run ends with
        an evaluation, the curve and the last checkpoint.
        """
        keep_freed_memory()
        end = min(self._total_frames, stop_after_frames or self._total_frames)
        is_whole = False
        try:
            with self._reporter, stop_on_signals(self._reporter.note) as stop, self._explaining_disk_errors():
                self._run(end, stop)
            is_whole = True
        finally:
            self._folder.release(is_whole=is_whole)
        return TrainingResult(
            self._folder.path,
            self.frames,
            self.updates,
            stop.signal,
            {group: learner.context.spec for group, learner in self._learners.items()},
            self._evaluation.rows,
            self._evaluation.best_rows,
            self._log.history,
        )

    def _run(self, end: int, stop: StopRequest) -> None:
        """Train until `end` or until `stop`, save all, and close what the run has opened."""
        threads = torch.get_num_threads()
        torch.set_num_threads(self._threads)
        closes = [self._close_collector, self._evaluation.close]
        closes += [learner.close for learner in self._learners.values()]
        with closing_all([*closes, partial(torch.set_num_threads, threads), self._log.close]):
            collector = self._begin_phase(stop)
            try:
                if self.frames < end and self._evaluation.is_due(self.frames):
                    # A signal ended the run before this evaluation, or amid it.
                    self._evaluate(stop)
                while self.frames < end:
                    self._loop(collector, end, stop)
                    if stop():
                        break
                    if self.frames < end:
                        collector = self._begin_phase(stop)
                self._end(collector, stop)
            except DivergenceError as error:
                # What was saved last is better than what there is now.
                self._log.write()
                raise DivergenceError(
                    f"{error}\n{self._folder.describe_last_save()}, with a lower learning.learning_rate, or "
                    "with the reward or sensor mended that grows"
                ) from error
            except (ConfigError, TrainingError) as error:
                # ConfigError: the collector of the next phase cannot be made, as on a cluster that has gone.
                try:
                    self._save(collector, with_experience=True)
                except DuneError as second:
                    raise type(second)(f"{error}\n{second}\n{self._folder.describe_last_save()}") from error
                self._log.write()
                raise TrainingError(
                    f"{error}\nAll is saved at {self.frames:,} frames; go on with "
                    f"{typed_word('resume', self._folder.path)}"
                ) from error

    def _end(self, collector: TransitionCollector, stop: StopRequest) -> None:
        finished = self.frames >= self._total_frames
        if finished and not self._evaluation.is_done(self.frames) and not stop():
            self._evaluate(stop)
        self._save(collector, with_experience=self._conf.checkpoint.replay or not finished)
        if finished and self._evaluation.rows:
            objective = str(self.config.get("objective", ""))
            self._log.end_session(self._evaluation.rows, objective, self.frames)
        self._log.write()
        self._log.draw(self._title)

    @contextmanager
    def _explaining_disk_errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            if error.errno not in _DISK_ERRORS:
                raise
            # Why there was something to be written, such as the loss of a worker.
            before = f"{error.__context__}\n" if isinstance(error.__context__, DuneError) else ""
            raise CheckpointError(
                f"{before}{self._folder.path} cannot be written: {error.strerror}.\n"
                f"Free some space, or allow writing there. {self._folder.describe_last_save()}"
            ) from error

    def _loop(self, collector: TransitionCollector, end: int, stop: StopRequest) -> None:
        for batch in collector:
            self._learn(batch)
            if self._population is not None and not self._warmup.goes_on(self.frames):
                if self._population.take_if_due(self.frames):
                    collector.fill_places()
                self._log.scalars(None, {"population/snapshots": len(self._population)}, self.frames)
            collector.send(self._warmup.learners_policies())
            self._report()
            if self._evaluation.is_due(self.frames) and not stop():
                self._evaluate(stop)
            if self.frames >= self._next_save:
                while self._next_save <= self.frames:
                    self._next_save += self._conf.checkpoint.every_frames
                self._save(collector, with_experience=self._conf.checkpoint.replay)
            if self.frames >= end or stop() or collector.is_worn or self._warmup.is_over(self.frames):
                return

    def _learn(self, batch: TensorDictBase) -> None:
        warmed_up = self._warmup.goes_on(self.frames)
        self.frames += batch.numel() * self._action_repeat
        diverged = self._diverged.find(batch)
        for group, learner in self._learners.items():
            learner.absorb(select_group(batch, group, diverged), self.frames)
        if self._conf.curriculum is not None:
            level = float(batch["next", "curriculum_level"][..., -1, :].mean())
            self._level = None if warmed_up else level
            self._log.scalars(None, {"curriculum/level": level}, self.frames)
        self._log.log_batch(batch, self.frames, self._updates, "warmup" if warmed_up else "train")
        for group, learner in self._learners.items():
            self._log.scalars(group, learner.update(), self.frames)
        self._log.scalars(None, self._diverged.scalars(), self.frames)
        self._updates_left_out.check()
        self._log.scalars(None, self._updates_left_out.scalars(), self.frames)
        if warmed_up and not self._warmup.goes_on(self.frames):
            # What the learners' policies do is not to be mixed with what others did, nor with their speed.
            self._log.clear_recent()
            self._status.speed.restart()

    def _begin_phase(self, stop: StopRequest) -> TransitionCollector:
        """A collector for the present phase, in place of that of the phase before."""
        self._close_collector()
        self._collector = self._make_collector(stop)
        return self._collector

    def _close_collector(self) -> None:
        if self._collector is not None:
            self._collector.close()
            self._collector = None

    def _make_collector(self, stop: StopRequest) -> TransitionCollector:
        """A collector for the present phase: warm-up policies in this process, then the learners'."""
        if self._saved is not None:
            set_random_state(self._saved["random"])
        policies: dict[str, TensorDictModuleBase] = {
            group: learner.make_policy() for group, learner in self._learners.items()
        }
        first = self._warmup.begin_phase(self.frames)
        conf = self._conf.collector
        if first:
            conf = conf.model_copy(update={"mode": "serial"})
        make_env = self._make_env
        if self._conf.curriculum is not None:
            make_env = partial(make_env, curriculum=self._curriculum_now(self._conf.curriculum))
        for group, learner in self._learners.items():
            make_env = learner.wrap_environment(make_env, warms_up=group in first)
        before = random_state()
        if self._saved is not None and self._saved["collector"]["warming"] == self._warmup.stage:
            # The run had made the networks of this phase already; these must not advance its random state.
            before = self._saved["random"]
        collector = TransitionCollector(
            conf,
            make_env,
            {**policies, **first},
            self._seed,
            frames=self.frames,
            state=self._scenes_to_resume(),
            threads=self._threads,
            stage=self._warmup.stage,
            population=None if first else self._population,
            note=self._reporter.note,
            is_stopped=stop,
        )
        collector.send(self._warmup.learners_policies())
        set_random_state(before)
        self._saved = None
        return collector

    def _curriculum_now(self, conf: CurriculumConf) -> CurriculumConf:
        """The curriculum of the judged group from the present level on, with which new processes begin."""
        conf = conf.model_copy(update={"group": conf.group or self._judged})
        return conf if self._level is None else conf.model_copy(update={"start_level": self._level})

    def _report(self) -> None:
        speeds = self._status.report_batch(
            self.frames,
            self.updates,
            warmup=self._warmup.describe(self.frames),
            success_rate=self._log.success_rate,
        )
        self._log.scalars(None, speeds, self.frames)

    def _evaluate(self, stop: StopRequest) -> None:
        check_weights(self._learners)
        self._status.begin_evaluation(self.frames)
        is_best = self._evaluation.run(
            self.frames, stop, partial(self._status.report_evaluation, self.frames), self._pictures
        )
        self._status.end_evaluation()
        if not self._evaluation.is_done(self.frames):
            return
        for group, learner in self._learners.items():
            self._log.histograms(group, learner.distributions(), self.frames)
        if self._pictures is not None:
            self._log.picture("tracks", self._pictures.draw(), self.frames)
        self._log.log_evaluation(self._evaluation.rows, self.frames, self._updates)
        if is_best:
            self._folder.save_policies(self._learners, self.frames, self._evaluation.score())

    def _save(self, collector: TransitionCollector, *, with_experience: bool) -> None:
        check_weights(self._learners)
        conf = self._conf.collector
        progress = {
            "random": random_state(),
            "counters": {"frames": self.frames, "next_save": self._next_save, **self._evaluation.state()},
            "collector": {
                "mode": conf.mode,
                "scenes": conf.scenes,
                "warming": self._warmup.stage,
                "state": collector.state(),
                "level": self._level,
            },
            "log": self._log.state(),
            "population": None if self._population is None else self._population.state(),
        }
        self._folder.save(self._learners, self.frames, progress, with_experience=with_experience)

    def _scenes_to_resume(self) -> Mapping[str, Any] | None:
        if self._saved is None:
            return None
        then, now = self._saved["collector"], self._conf.collector
        here = (now.mode, now.scenes, self._warmup.stage)
        return then["state"] if here == (then["mode"], then["scenes"], then["warming"]) else None
