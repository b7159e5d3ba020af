"""The training loop on the point mass: that it continues, counts, saves, and learns."""

import signal
from functools import partial
from itertools import product
from pathlib import Path

import pytest
import torch
from point_mass import PointMass, make_point_mass
from training import assert_halves_make_a_whole, small, trainer, weights

from dune_rl.core.errors import CheckpointError
from dune_rl.learning.checkpoint import CHECKPOINT_FILE
from dune_rl.learning.collector import TransitionCollector, environment_seed
from dune_rl.learning.group_policy import GroupPolicy
from dune_rl.learning.networks.policy import Architecture, make_policy_network
from dune_rl.learning.policy_spec import PolicySpec
from dune_rl.learning.run.progress import Reporter, SpeedMeter, TrainingStatus
from dune_rl.learning.settings import CollectorConf, EvaluationConf


@pytest.mark.slow
def test_halves_make_a_whole(tmp_path: Path) -> None:
    assert_halves_make_a_whole(make_point_mass, tmp_path)


@pytest.mark.slow
def test_another_seed_gives_other_weights(tmp_path: Path) -> None:
    trainer(tmp_path / "a").train(stop_after_frames=768)
    trainer(tmp_path / "b").train(stop_after_frames=768)
    trainer(tmp_path / "c", seed=4).train(stop_after_frames=768)
    a, b, c = (weights(tmp_path / name) for name in "abc")
    assert all(torch.equal(a[key], b[key]) for key in a)
    assert not all(torch.equal(a[key], c[key]) for key in a)


@pytest.mark.slow
def test_a_run_stopped_during_its_warm_up_goes_on_as_if_it_had_not_been(tmp_path: Path) -> None:
    guided = small(warm_up="go_to_goal")
    trainer(tmp_path / "whole", guided).train(stop_after_frames=768)
    first = trainer(tmp_path / "halves", guided).train(stop_after_frames=256)
    assert first.frames < guided.learning_starts and first.updates == 0
    trainer(tmp_path / "halves", guided, resume=tmp_path / "halves").train(768)
    whole, halves = weights(tmp_path / "whole"), weights(tmp_path / "halves")
    assert not [key for key, value in whole.items() if not value.equal(halves[key])]


class StoppingAmidAnEvaluation(Reporter):
    """Ends the run in order at the first episodes of its first evaluation."""

    def update(self, status: TrainingStatus) -> None:
        if status.activity.startswith("evaluating 0/"):
            signal.raise_signal(signal.SIGTERM)


@pytest.mark.slow
def test_an_evaluation_that_a_signal_cut_off_is_made_when_the_run_goes_on(tmp_path: Path) -> None:
    conf = small(learning_starts=128, evaluation=EvaluationConf(every_frames=256, episodes=2))
    trainer(tmp_path / "whole", conf, total_frames=512).train()
    stopped = trainer(
        tmp_path / "halves", conf, total_frames=512, reporter=StoppingAmidAnEvaluation()
    ).train()
    assert stopped.signal == signal.SIGTERM and not stopped.evaluation
    trainer(tmp_path / "halves", conf, total_frames=512, resume=tmp_path / "halves").train()
    files = [(tmp_path / name / "metrics.csv").read_bytes() for name in ("whole", "halves")]
    assert files[0] == files[1]


@pytest.mark.slow
def test_a_finished_run_keeps_its_files(tmp_path: Path) -> None:
    result = trainer(tmp_path / "run").train()
    assert [row["episode"] for row in result.evaluation["rover"]] == list(range(10))
    for name in ("policy_best.pt", "policy_last.pt", "metrics.csv", "curve.png", CHECKPOINT_FILE):
        assert (tmp_path / "run" / name).stat().st_size > 0
    assert (tmp_path / "run" / "policy_best.pt").stat().st_size < 2_000_000
    lines = (tmp_path / "run" / "metrics.csv").read_text().splitlines()
    assert lines[0] == "kind,frames,updates,episodes,SR,TR,TC,MTT,OC,VR,VORT,TSR,return,steps"
    # 512 frames of random actions; the batch that completes them is learned from already.
    assert result.updates == (2048 - 512 + 128) // 16
    assert result.signal is None


@pytest.mark.slow
def test_workers_act_by_the_weights_that_they_are_sent() -> None:
    spec = PolicySpec.of(make_point_mass(4, 0), "rover")

    def make_policy() -> GroupPolicy:
        return GroupPolicy("rover", spec, make_policy_network(spec, Architecture((8,))))

    conf = CollectorConf(mode="async", workers=1, scenes=4, steps=4)
    collector = TransitionCollector(conf, make_point_mass, {"rover": make_policy()}, seed=1)
    try:
        trained = make_policy()
        with torch.no_grad():
            # A certain policy: full speed ahead, turning by a heading that the statistics set.
            last = trained.network[1].module[0].module.body[-1]
            last.weight.zero_()
            last.bias.copy_(torch.tensor([9.0, 0.0, -20.0, -20.0]))
        collector.send({"rover": trained})
        batches = iter(collector)
        batch = [next(batches) for _ in range(4)][-1]
        assert (batch["rover", "action"][..., 0] > 0.75).all()
        assert set(batch["rover"].keys()) == {
            "observation", "metrics", "action", "done", "terminated", "truncated"
        }  # fmt: skip
        workers = list(collector._collector.procs)
    finally:
        collector.close()
    assert not any(worker.is_alive() for worker in workers if not worker._closed)


@pytest.mark.slow
def test_async_run_resumes_its_counts(tmp_path: Path) -> None:
    first = trainer(tmp_path / "run").train(stop_after_frames=640)
    second = trainer(tmp_path / "run", small(mode="async"), resume=tmp_path / "run").train(1024)
    assert first.frames < second.frames == 1024
    assert second.updates == (1024 - 512 + 128) // 16


def test_run_on_disk_storage_resumes(tmp_path: Path) -> None:
    trainer(tmp_path / "run", small(storage="disk")).train(stop_after_frames=640)
    again = trainer(tmp_path / "run", small(storage="disk"), resume=tmp_path / "run")
    assert len(again._learners["rover"]._replay) == 640
    assert list((tmp_path / "run" / "replay-rover").glob("*.memmap"))
    assert again.train(768).frames == 768
    assert not (tmp_path / "run" / "replay-rover").exists()
    assert [path.name for path in (tmp_path / "run").glob("replay-*")] == ["replay-rover-768.npy"]


def test_a_run_is_not_overwritten(tmp_path: Path) -> None:
    trainer(tmp_path / "run").train(stop_after_frames=128)
    with pytest.raises(CheckpointError, match="already holds a run"):
        trainer(tmp_path / "run")


def test_other_networks_do_not_resume(tmp_path: Path) -> None:
    trainer(tmp_path / "run").train(stop_after_frames=128)
    with pytest.raises(CheckpointError, match=r"learning\.hidden=\[32,32\]"):
        trainer(tmp_path / "run", small(hidden=(16,)), resume=tmp_path / "run")


def test_other_groups_do_not_resume(tmp_path: Path) -> None:
    trainer(tmp_path / "run").train(stop_after_frames=128)
    other = partial(PointMass, groups={"dog": 1})
    with pytest.raises(CheckpointError, match="trains rover, and the groups here are dog"):
        trainer(tmp_path / "run", make_env=other, resume=tmp_path / "run")


def test_a_signal_stops_a_run_which_is_saved(tmp_path: Path) -> None:
    class Stopper(Reporter):
        """Sends SIGTERM to this process after 600 frames."""

        def update(self, status: TrainingStatus) -> None:
            if status.frames >= 600:
                signal.raise_signal(signal.SIGTERM)

    result = trainer(tmp_path / "run", reporter=Stopper()).train()
    assert result.signal == signal.SIGTERM and result.frames == 640
    assert trainer(tmp_path / "run", resume=tmp_path / "run").frames == 640


def test_training_seeds_are_no_evaluation_seeds() -> None:
    uses = product(range(20), range(4), (0, 9))
    seeds = {environment_seed(seed, worker, frames) for seed, worker, frames in uses}
    assert len(seeds) == 160
    assert min(seeds) > 10_000_000


def test_speeds_leave_out_a_pause_and_outlast_it() -> None:
    clock = iter([0.0, 2.0, 100.0, 101.0])
    speed = SpeedMeter(lambda: next(clock))
    assert speed.mark(0, 0) == (0.0, 0.0)
    assert speed.mark(600, 40) == (300.0, 20.0)
    speed.pause(98.0)
    assert speed.mark(600, 40) == (300.0, 20.0)
    assert speed.mark(700, 50) == (100.0, 10.0)
