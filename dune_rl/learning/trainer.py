"""The training loop, and what it saves."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase

from dune_rl.errors import CheckpointError
from dune_rl.files import write_atomically
from dune_rl.learning.allocation import keep_freed_memory
from dune_rl.learning.checkpoint import (
    BEST_POLICY_FILE,
    CHECKPOINT_FILE,
    LAST_POLICY_FILE,
    CheckpointConf,
    find,
    read,
    write,
)
from dune_rl.learning.collect import Collection, CollectorConf, MakeEnv, learner_threads
from dune_rl.learning.evaluation import EvaluationConf, Row, averages, evaluate
from dune_rl.learning.interrupts import StopRequest, stop_on_signals
from dune_rl.learning.layout import Layout
from dune_rl.learning.networks import make_policy
from dune_rl.learning.policies import Deterministic, Guide, policy_content
from dune_rl.learning.progress import Reporter, Silent, Status
from dune_rl.learning.random_state import random_state, set_random_state
from dune_rl.learning.replay import Replay, ReplayConf, check_memory
from dune_rl.learning.run_log import RunLog, Speed
from dune_rl.learning.sac import Sac, SacConf


@dataclass(frozen=True)
class TrainingResult:
    """How a run ended. `signal` is the number that stopped it early, or None.

    `evaluation` holds the episodes of the last evaluation; `history` the rows
    of metrics.csv.
    """

    run_dir: Path
    frames: int
    updates: int
    signal: int | None
    evaluation: list[Row]
    history: list[dict[str, Any]]


class Trainer:
    """Trains one policy in `run_dir`, anew or (with `resume`) from its checkpoint there or elsewhere.

    `make_env(num_scenes, seed)` must be picklable unless the collector is
    serial. `config` is the resolved configuration as plain containers; it is
    stored beside the weights. On a serial collector, a run that was stopped
    and resumed ends with the very weights of an uninterrupted one; with worker
    processes everything but the episodes under way is continued.

    Raises CheckpointError if the folder cannot be written, already holds a
    run, or the checkpoint does not fit.
    """

    def __init__(
        self,
        make_env: MakeEnv,
        run_dir: Path,
        *,
        sac: SacConf,
        replay: ReplayConf,
        collector: CollectorConf,
        evaluation: EvaluationConf,
        checkpoint: CheckpointConf,
        seed: int,
        total_frames: int,
        device: str = "cpu",
        config: Mapping[str, Any] | None = None,
        resume: Path | None = None,
        reporter: Reporter | None = None,
        title: str = "",
    ) -> None:
        saved = read(find(resume, CHECKPOINT_FILE), "checkpoint") if resume else None
        _claim(run_dir, fresh=saved is None)
        self._make_env = make_env
        self._run_dir = run_dir
        self._sac_conf, self._replay_conf, self._collector_conf = sac, replay, collector
        self._evaluation_conf, self._checkpoint_conf = evaluation, checkpoint
        self._seed, self._total_frames = seed, total_frames
        self._config = dict(config or {})
        self._reporter = reporter or Silent()
        self._title = title or run_dir.name
        self._threads = sac.threads or learner_threads(collector)

        scenes = min(evaluation.scenes, evaluation.episodes)
        self._evaluation_env: EnvBase = make_env(scenes, seed + evaluation.seed_offset)
        self._layout = Layout.of(self._evaluation_env)
        torch.manual_seed(seed)
        np.random.seed(seed % 2**32)
        self._sac = Sac(sac, self._layout, total_frames, device)
        # Workers and evaluations act on the CPU, whatever device learns.
        self._acting = make_policy(self._layout, sac.architecture)
        transitions = self._sac.transitions
        check_memory(replay, transitions, total_frames)
        self._replay = Replay(replay, transitions.width, run_dir / "replay", device, transitions.dtype)

        self.frames = 0
        self.updates = 0
        self._updates_due = 0.0
        self._warming = False
        self._best_success = -1.0
        self._evaluated_at = -1
        self._next_evaluation = evaluation.every_frames
        self._next_save = checkpoint.every_frames
        self._last_evaluation: list[Row] = []
        self._speed = Speed()
        self._saved = saved
        if saved is not None and resume is not None:
            self._check(saved, resume)
            self._restore(saved, resume)
        self._log = RunLog(run_dir, self._evaluation_env.metric_names, frames=self.frames)
        if saved is not None:
            self._log.restore(saved["log"])

    def train(self, stop_after_frames: int | None = None) -> TrainingResult:
        """Run until `total_frames`, or until a signal or `stop_after_frames` ends it early.

        An early end saves everything that resuming needs. A full run ends with
        an evaluation, the curve and the last checkpoint.
        """
        keep_freed_memory()
        end = min(self._total_frames, stop_after_frames or self._total_frames)
        threads = torch.get_num_threads()
        with self._reporter, stop_on_signals() as stop:
            collection = self._collect()
            torch.set_num_threads(self._threads)
            try:
                if self.frames < end:
                    self._loop(collection, end, stop)
                if self._warming and self.frames < end and not stop():
                    collection.close()
                    collection = self._collect()
                    self._loop(collection, end, stop)
                finished = self.frames >= self._total_frames
                if finished and self._evaluated_at != self.frames and not stop():
                    self._evaluate(stop)
                self._save(collection, with_replay=self._checkpoint_conf.replay or not finished)
                self._log.write()
                self._log.draw(self._title)
            finally:
                collection.close()
                self._replay.close()
                torch.set_num_threads(threads)
                self._log.close()
        return TrainingResult(
            self._run_dir, self.frames, self.updates, stop.signal, self._last_evaluation, self._log.history
        )

    def _loop(self, collection: Collection, end: int, stop: StopRequest) -> None:
        for batch in collection:
            self._absorb(batch)
            self._learn()
            if not self._warming:
                collection.send(self._sac.policy)
            self._report()
            if self.frames >= self._next_evaluation and not stop():
                self._evaluate(stop)
            if self.frames >= self._next_save:
                while self._next_save <= self.frames:
                    self._next_save += self._checkpoint_conf.every_frames
                self._save(collection, with_replay=self._checkpoint_conf.replay)
            if self.frames >= end or stop() or (self._warming and not self._guided()):
                return

    def _guided(self) -> bool:
        return self._sac_conf.warm_up == "go_to_goal" and self.frames < self._sac_conf.learning_starts

    def _collect(self) -> Collection:
        """The collection that is due now: the guide's in this process, then the policy's."""
        self._warming = self._guided()
        conf = self._collector_conf
        policy: TensorDictModuleBase = make_policy(self._layout, self._sac_conf.architecture)
        if self._warming:
            conf = conf.model_copy(update={"mode": "serial"})
            policy = Guide(self._layout)
        # Making networks and first resets must not move the learner's draws: a resumed run makes them anew.
        before = random_state() if self._saved is None else self._saved["random"]
        collection = Collection(
            conf,
            self._make_env,
            policy,
            self._seed,
            frames=self.frames,
            random_frames=0 if self._warming else self._sac_conf.learning_starts - self.frames,
            state=self._scenes_to_resume(),
            learner_threads=self._threads,
            stage=1 if self._warming else 0,
        )
        if not self._warming:
            collection.send(self._sac.policy)
        set_random_state(before)
        self._saved = None
        return collection

    def _absorb(self, batch: TensorDictBase) -> None:
        self.frames += batch.numel()
        rows = self._sac.transitions.rows(batch)
        self._sac.observe(rows)
        self._replay.extend(rows)
        self._log.collected(batch, self.frames, self.updates)
        if self.frames >= self._sac_conf.learning_starts:
            self._updates_due += self._sac_conf.updates_per_frame * batch.numel()

    def _learn(self) -> None:
        count = int(self._updates_due)
        if not count:
            return
        rate = self._sac.schedule(self.frames)
        losses = self._sac.learn(self._replay.minibatches(count, self._sac_conf.batch_size))
        self._updates_due -= count
        self.updates += count
        self._log.learned({**losses, "sac/learning_rate": rate}, self.frames)

    def _report(self, doing: str = "training") -> None:
        frames_per_s, updates_per_s = self._speed.mark(self.frames, self.updates)
        self._log.learned({"speed/frames": frames_per_s, "speed/updates": updates_per_s}, self.frames)
        success = self._log.success_rate
        self._reporter.update(
            Status(self.frames, self._total_frames, frames_per_s, updates_per_s, success, doing)
        )

    def _evaluate(self, stop: StopRequest) -> None:
        self._report("evaluating")
        conf = self._evaluation_conf
        self._acting.load_state_dict(self._sac.policy.state_dict())
        rows = evaluate(
            Deterministic(self._acting),
            self._evaluation_env,
            conf.episodes,
            self._seed + conf.seed_offset,
            stop=stop,
        )
        self._speed.pause()
        if stop():
            # Cut short: its easy episodes are over-represented, and a resumed run will do it again.
            return
        while self._next_evaluation <= self.frames:
            self._next_evaluation += conf.every_frames
        self._evaluated_at = self.frames
        self._last_evaluation = rows
        self._log.evaluated(rows, self.frames, self.updates)
        success = averages(rows)["SR"]
        if success >= self._best_success:
            self._best_success = success
            write(self._run_dir / BEST_POLICY_FILE, "policy", self._policy_content())

    def _policy_content(self) -> dict[str, Any]:
        architecture = self._sac_conf.architecture
        content = policy_content(self._sac.policy, self._layout, architecture, self._config)
        return {**content, "frames": self.frames}

    def _save(self, collection: Collection, *, with_replay: bool) -> None:
        """Write the checkpoint, which names its own replay file, so that no crash can mix two saves."""
        replay: dict[str, Any] | None = None
        if with_replay:
            name = f"replay-{self.frames}.npy"
            try:
                with write_atomically(self._run_dir / name) as temporary:
                    replay = {"file": name, **self._replay.save(temporary)}
            except OSError as error:
                raise CheckpointError(
                    f"{self._run_dir / name} cannot be written: {error.strerror or error}.\n"
                    "Free some space, or set learning.checkpoint.replay=false; the last save is intact."
                ) from error
        content = {
            "layout": self._layout.plain(),
            "architecture": self._sac_conf.architecture.plain(),
            "config": self._config,
            "learner": self._sac.state_dict(),
            "random": random_state(),
            "counters": {
                "frames": self.frames,
                "updates": self.updates,
                "updates_due": self._updates_due,
                "best_success": self._best_success,
                "evaluated_at": self._evaluated_at,
                "next_evaluation": self._next_evaluation,
                "next_save": self._next_save,
            },
            "collector": {
                "mode": self._collector_conf.mode,
                "scenes": self._collector_conf.scenes,
                "warming": self._warming,
                "state": collection.state(),
            },
            "log": self._log.state(),
            "replay": replay,
        }
        write(self._run_dir / CHECKPOINT_FILE, "checkpoint", content)
        write(self._run_dir / LAST_POLICY_FILE, "policy", self._policy_content())
        for old in self._run_dir.glob("replay-*.npy"):
            if replay is None or old.name != replay["file"]:
                old.unlink()

    def _check(self, saved: Mapping[str, Any], source: Path) -> None:
        Layout.from_plain(saved["layout"]).require(self._layout, str(source))
        theirs, ours = saved["architecture"], self._sac_conf.architecture.plain()
        other = [f"learning.{key}={value}" for key, value in theirs.items() if value != ours[key]]
        if other:
            raise CheckpointError(
                f"{source} has networks of another shape. Resume with {' '.join(other)}, or train anew."
            )

    def _restore(self, saved: Mapping[str, Any], source: Path) -> None:
        self._sac.load_state_dict(saved["learner"])
        counters = saved["counters"]
        self.frames, self.updates = counters["frames"], counters["updates"]
        self._updates_due = counters["updates_due"]
        self._best_success = counters["best_success"]
        self._evaluated_at = counters["evaluated_at"]
        self._next_evaluation, self._next_save = counters["next_evaluation"], counters["next_save"]
        if saved["replay"] is not None:
            folder = source if source.is_dir() else source.parent
            self._replay.load(folder / saved["replay"]["file"], saved["replay"])

    def _scenes_to_resume(self) -> Mapping[str, Any] | None:
        if self._saved is None:
            return None
        then, now = self._saved["collector"], self._collector_conf
        same = (then["mode"], then["scenes"], then["warming"]) == (now.mode, now.scenes, self._warming)
        return then["state"] if same else None


def _claim(run_dir: Path, *, fresh: bool) -> None:
    if fresh and (run_dir / CHECKPOINT_FILE).exists():
        raise CheckpointError(
            f"{run_dir} already holds a run.\nContinue it with resume={run_dir}, or name another folder."
        )
    try:
        run_dir.mkdir(parents=True, exist_ok=True)
        with write_atomically(run_dir / ".writable"):
            pass
        (run_dir / ".writable").unlink()
    except OSError as error:
        raise CheckpointError(
            f"The folder {run_dir} cannot be written: {error.strerror or error}.\n"
            "Name another folder for the run."
        ) from error
