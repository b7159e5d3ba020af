"""Speed of training: one update, and frames per second beside those of collecting alone."""

import tempfile
import time
from collections.abc import Callable, Generator
from contextlib import closing
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torchrl.envs import EnvBase

from dune_rl.commands.benchmark.measuring import time_calls
from dune_rl.config.build import make_learning_env
from dune_rl.config.commands import BenchmarkConf
from dune_rl.config.compose import compose_environment
from dune_rl.core.errors import ConfigError
from dune_rl.core.suggestions import advise
from dune_rl.learning.collector import TransitionCollector, learner_threads
from dune_rl.learning.group_policy import select_group
from dune_rl.learning.learners import build_learners
from dune_rl.learning.registry import ALGORITHMS
from dune_rl.learning.settings import LearningConf

MakeEnv = Callable[[int, int], EnvBase]

_TOTAL_FRAMES = 1_000_000
# Batches before the clock starts, in which the replay fills and code is compiled.
_FIRST_BATCHES, _UPDATE_BATCHES = 3, 4
# Observations of which an update is measured: the settings' defaults, and those of far-seeing policies.
_SENSORS = {"update_ms": "default", "update_ms_perception": "perception"}


def measure_learning(conf: BenchmarkConf, algorithm: str) -> dict[str, Any]:
    """Times [ms] of one update of an algorithm with its default settings, and the speed of training by it.

    Updates are of Rover Zero's policy, on one thread. `learn_ratio` is the frames per second of training
    over those of the same processes that only collect, by the same policy; both with the settings of `conf`.
    """
    learning = _settings(algorithm)
    found: dict[str, Any] = {"algorithm": algorithm}
    for field, sensors in _SENSORS.items():
        environment = compose_environment("flat", [f"sensors={sensors}", "actors=none"])
        found[field] = _update_ms(partial(make_learning_env, environment), learning, conf.seed)
    measured = partial(_frames_per_s, partial(make_learning_env, conf), learning, conf)
    training, collecting = measured(learns=True), measured(learns=False)
    collector = learning.collector
    return {
        **found,
        "learn_ratio": training / collecting,
        "training_frames_per_s": training,
        "collecting_frames_per_s": collecting,
        "collector": collector.mode,
        "workers": collector.processes,
        "scenes_each": collector.scenes,
    }


def _settings(algorithm: str) -> LearningConf:
    """The default settings of an algorithm, without a warm-up."""
    kind = ALGORITHMS.settings_class(algorithm)
    if kind is None:
        raise ConfigError(
            f"algorithms: there is no algorithm {algorithm!r}; {advise(algorithm, ALGORITHMS.names())}"
        )
    starts = {"learning_starts": 0} if "learning_starts" in kind.model_fields else {}
    settings: LearningConf = kind.model_validate({"name": algorithm, **starts})
    return settings.resolved("cpu")


def _train(
    make_env: MakeEnv, learning: LearningConf, seed: int, *, learns: bool = True
) -> Generator[tuple[int, int, float], None, None]:
    """Frames, updates, and the time [s] that these took, of each batch of a training.

    Without `learns`, the batches are collected by the first weights of the policies, and thrown away.
    """
    env = make_env(1, seed)
    threads, frames = learner_threads(learning.collector), 0
    torch.manual_seed(seed)
    with tempfile.TemporaryDirectory() as folder:
        learners = build_learners(learning, env, _TOTAL_FRAMES, Path(folder), torch.device("cpu"))
        env.close()
        for learner in learners.values():
            make_env = learner.wrap_environment(make_env, warms_up=False)
        policies = {group: learner.make_policy() for group, learner in learners.items()}
        collector = TransitionCollector(learning.collector, make_env, policies, seed, threads=threads)
        torch.set_num_threads(threads)
        try:
            for batch in collector:
                before = sum(learner.updates for learner in learners.values())
                frames, taken_s = frames + batch.numel(), 0.0
                for group, learner in learners.items() if learns else ():
                    learner.absorb(select_group(batch, group), frames)
                    taken_s += time_calls(learner.update)
                collector.send({group: learner.policy for group, learner in learners.items()})
                yield batch.numel(), sum(learner.updates for learner in learners.values()) - before, taken_s
        finally:
            collector.close()
            for learner in learners.values():
                learner.close()


def _update_ms(make_env: MakeEnv, learning: LearningConf, seed: int) -> float:
    """Median over batches of the time of one update [ms]."""
    collector = learning.collector.model_copy(update={"mode": "serial"})
    training = _train(make_env, learning.model_copy(update={"collector": collector}), seed)
    with closing(training):
        learned = (each for each in training if each[1])
        batches = list(islice(learned, _FIRST_BATCHES, _FIRST_BATCHES + _UPDATE_BATCHES))
    return 1e3 * float(np.median([taken_s / updates for _, updates, taken_s in batches]))


def _frames_per_s(make_env: MakeEnv, learning: LearningConf, conf: BenchmarkConf, *, learns: bool) -> float:
    """Frames per second once the first batches are over, for as many batches as there are rounds."""
    with closing(_train(make_env, learning, conf.seed, learns=learns)) as training:
        for _ in islice(training, _FIRST_BATCHES):
            pass
        start = time.perf_counter()
        frames = sum(each[0] for each in islice(training, conf.rounds))
        return frames / (time.perf_counter() - start)
