"""Soft actor-critic, its replay and its collectors, on the point mass."""

import math
from collections.abc import Iterator
from functools import partial
from itertools import product
from pathlib import Path

import pytest
import torch
from point_mass import PointMass, make_point_mass
from tensordict import TensorDict

from dune_rl.errors import CheckpointError
from dune_rl.learning.checkpoint import CHECKPOINT_FILE, CheckpointConf
from dune_rl.learning.collect import Collection, CollectorConf, MakeEnv, environment_seed
from dune_rl.learning.evaluation import EvaluationConf
from dune_rl.learning.layout import Layout
from dune_rl.learning.networks import Architecture, Normaliser, make_policy
from dune_rl.learning.replay import Replay, ReplayConf, Transitions
from dune_rl.learning.run_log import Speed
from dune_rl.learning.sac import Sac, SacConf
from dune_rl.learning.trainer import Trainer, TrainingResult

SMALL = SacConf(
    hidden=(32, 32),
    batch_size=64,
    learning_starts=512,
    updates_per_frame=1 / 16,
    learning_rate=1e-3,
    initial_entropy_coefficient=0.05,
)


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Small networks on busy machines are fastest, and reproducible, on one thread."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def trainer(
    folder: Path,
    *,
    make_env: MakeEnv = make_point_mass,
    sac: SacConf = SMALL,
    mode: str = "serial",
    total_frames: int = 2048,
    resume: Path | None = None,
    evaluate_every: int = 1024,
    save_every: int = 10**6,
    storage: str = "memory",
) -> Trainer:
    """A small run; tests of other environments give their own `make_env`."""
    return Trainer(
        make_env,
        folder,
        sac=sac,
        replay=ReplayConf(capacity=5000, storage=storage),
        collector=CollectorConf(mode=mode, scenes=8, steps=16),
        evaluation=EvaluationConf(every_frames=evaluate_every, episodes=10, scenes=4),
        checkpoint=CheckpointConf(every_frames=save_every),
        seed=3,
        total_frames=total_frames,
        resume=resume,
        config={"seed": 3},
    )


def weights(folder: Path) -> dict[str, torch.Tensor]:
    learner = torch.load(folder / CHECKPOINT_FILE, weights_only=True)["learner"]
    moments = {f"{i}.{k}": v for i, s in learner["optimiser"]["state"].items() for k, v in s.items()}
    return {**learner["policy"], **learner["loss"], **moments}


def assert_halves_make_a_whole(make_env: MakeEnv, folder: Path) -> None:
    """Two half-runs end with the weights, targets and optimiser moments of one whole run, bit for bit."""
    trainer(folder / "whole", make_env=make_env).train()
    first = trainer(folder / "halves", make_env=make_env).train(stop_after_frames=1300)
    assert 0 < first.frames < 2048 and first.updates > 0
    second = trainer(folder / "halves", make_env=make_env, resume=folder / "halves").train()
    assert second.frames == 2048
    whole, halves = weights(folder / "whole"), weights(folder / "halves")
    assert whole.keys() == halves.keys()
    different = [key for key, value in whole.items() if not torch.equal(value, halves[key])]
    assert not different


def test_halves_make_a_whole(tmp_path: Path) -> None:
    assert_halves_make_a_whole(make_point_mass, tmp_path)


def test_another_seed_gives_other_weights(tmp_path: Path) -> None:
    trainer(tmp_path / "a").train(stop_after_frames=1024)
    trainer(tmp_path / "b").train(stop_after_frames=1024)
    other = SMALL.model_copy(update={"learning_rate": 9e-4})
    trainer(tmp_path / "c", sac=other).train(stop_after_frames=1024)
    a, b, c = (weights(tmp_path / name) for name in "abc")
    assert all(torch.equal(a[key], b[key]) for key in a)
    assert not all(torch.equal(a[key], c[key]) for key in a)


def test_learns_to_reach_the_goal(tmp_path: Path) -> None:
    eager = SMALL.model_copy(update={"hidden": (64, 64), "batch_size": 128, "updates_per_frame": 1 / 8})
    result = trainer(tmp_path / "run", sac=eager, total_frames=7168, evaluate_every=7168).train()
    assert [row["episode"] for row in result.evaluation] == list(range(10))
    assert sum(row["success"] for row in result.evaluation) / 10 > 0.9
    for name in ("policy.pt", "policy_last.pt", "metrics.csv", "curve.png", CHECKPOINT_FILE):
        assert (tmp_path / "run" / name).stat().st_size > 0
    assert (tmp_path / "run" / "policy.pt").stat().st_size < 2_000_000


def test_workers_act_by_the_weights_that_they_are_sent() -> None:
    env = make_point_mass(4, 0)
    layout = Layout.of(env)
    conf = CollectorConf(mode="async", workers=1, scenes=4, steps=4)
    collection = Collection(conf, make_point_mass, make_policy(layout, Architecture((8,))), seed=1)
    try:
        trained = make_policy(layout, Architecture((8,)))
        with torch.no_grad():
            # A certain policy: full speed ahead, turning by a heading that the statistics set.
            last = trained[1].module[0].module.body[-1]
            last.weight.zero_()
            last.bias.copy_(torch.tensor([9.0, 0.0, -20.0, -20.0]))
            statistics = trained[0].module.normaliser
            statistics.mean.fill_(7.0)
        collection.send(trained)
        batches = iter(collection)
        seen = [next(batches) for _ in range(4)][-1]
        assert (seen["action"][..., 0] > 0.75).all()
        assert seen["features"].max() > 0 and torch.allclose(
            seen["features"][..., 2:11], statistics(torch.zeros(layout.observation_size))[2:11]
        )
        workers = list(collection._collector.procs)
    finally:
        collection.close()
    assert not any(worker.is_alive() for worker in workers if not worker._closed)


def test_async_run_resumes_its_counts(tmp_path: Path) -> None:
    first = trainer(tmp_path / "run", mode="async").train(stop_after_frames=1000)
    second = trainer(tmp_path / "run", mode="async", resume=tmp_path / "run").train()
    assert first.frames < second.frames == 2048
    assert second.updates == (2048 - 512 + 128) // 16


def test_run_on_disk_storage_resumes(tmp_path: Path) -> None:
    trainer(tmp_path / "run", storage="disk").train(stop_after_frames=1024)
    again = trainer(tmp_path / "run", storage="disk", resume=tmp_path / "run")
    assert len(again._replay) == 1024
    assert list((tmp_path / "run" / "replay").glob("*.memmap"))
    assert again.train().frames == 2048
    assert not (tmp_path / "run" / "replay").exists()


def test_a_run_is_not_overwritten(tmp_path: Path) -> None:
    trainer(tmp_path / "run").train(stop_after_frames=128)
    with pytest.raises(CheckpointError, match="already holds a run"):
        trainer(tmp_path / "run")


def test_other_networks_do_not_resume(tmp_path: Path) -> None:
    trainer(tmp_path / "run").train(stop_after_frames=128)
    with pytest.raises(CheckpointError, match=r"learning\.hidden=\[32, 32\]"):
        trainer(tmp_path / "run", sac=SMALL.model_copy(update={"hidden": (16,)}), resume=tmp_path / "run")


def _episode_batch(layout: Layout, *, terminated: bool, k: int = 512) -> TensorDict:
    observation = {key: torch.zeros(k, size) for key, size in layout.sizes.items()}
    ended = torch.full((k, 1), terminated)
    return TensorDict(
        {
            **observation,
            "action": torch.zeros(k, layout.action_size),
            "next": {
                **observation,
                "reward": torch.ones(k, 1),
                "terminated": ended,
                "truncated": ~ended,
                "done": torch.ones(k, 1, dtype=torch.bool),
            },
        },
        [k],
    )


@pytest.mark.parametrize("terminated", [True, False])
def test_time_limits_bootstrap_and_terminations_do_not(terminated: bool) -> None:
    torch.manual_seed(0)
    layout = Layout.of(make_point_mass(1, 0))
    conf = SacConf(hidden=(16,), gamma=0.9, tau=0.1, learning_rate=1e-2, initial_entropy_coefficient=1e-9)
    sac = Sac(conf, layout, total_frames=1)
    rows = sac.transitions.rows(_episode_batch(layout, terminated=terminated))
    sac.learn([rows] * 600)
    features = torch.zeros(1, layout.observation_size)
    loss = sac._loss
    with loss.qvalue_network_params[0].to_module(loss.qvalue_network):
        value = loss.qvalue_network.module(features, torch.zeros(1, layout.action_size)).item()
    # A reward of 1 for ever is worth 1 / (1 - 0.9) = 10; one that ends the episode is worth 1.
    if terminated:
        assert value == pytest.approx(1.0, abs=0.2)
    else:
        assert value > 5


def test_next_observation_is_the_final_one_not_the_reset_one() -> None:
    make_env = partial(PointMass, limit=4)
    layout = Layout.of(make_env(2, 0))
    transitions = Transitions(layout)
    collection = Collection(
        CollectorConf(mode="serial", scenes=2, steps=12),
        make_env,
        make_policy(layout, Architecture((8,))),
        seed=0,
    )
    batch = next(iter(collection))
    collection.close()
    ends = batch["next", "truncated"].squeeze(-1)
    assert ends.sum() == 6
    rows = transitions.rows(batch).view(*batch.shape, -1)
    n = layout.observation_size
    moved = (rows[..., :2] - rows[..., n : n + 2]).abs()[..., 0]
    # A point moves at most 0.2 m a step; a new episode's goal is somewhere else.
    assert (moved[ends] <= 0.21).all()
    after = rows[:, 1:, :n][ends[:, :-1]]
    assert not torch.equal(after, rows[:, :-1, n : 2 * n][ends[:, :-1]])
    learnt = transitions.batch(
        rows.flatten(0, 1),
        lambda packed: Normaliser(torch.zeros(n, dtype=torch.bool), clip=10.0)(packed.floats),
        reward_scale=1.0,
    )
    assert not learnt["next", "terminated"].any()


def test_entropy_target_is_that_of_scaled_actions() -> None:
    layout = Layout.of(make_point_mass(1, 0))
    sac = Sac(SacConf(target_entropy=-2.0), layout, 1)
    assert sac._loss.target_entropy.item() == pytest.approx(-2 + math.log(0.8) + math.log(math.pi), abs=1e-5)
    features = torch.zeros(20_000, layout.observation_size)
    unit = Layout(layout.sizes, (-1.0, -1.0), (1.0, 1.0))
    entropies = []
    for each in (layout, unit):
        torch.manual_seed(0)
        actor = make_policy(each, Architecture((8,)))[1]
        distribution = actor.get_dist(TensorDict(features=features, batch_size=[20_000]))
        entropies.append(-distribution.rsample_and_log_prob()[1].mean().item())
    assert entropies[0] - entropies[1] == pytest.approx(math.log(0.8) + math.log(math.pi), abs=1e-3)


def test_actions_keep_to_their_bounds_and_scale_for_the_critic() -> None:
    env = make_point_mass(16, 0)
    layout = Layout.of(env)
    policy = make_policy(layout, Architecture((8,)))
    with torch.no_grad():
        policy[1].module[0].module.body[-1].weight.mul_(1000)
    action = policy(env.reset())["action"]
    assert env.action_spec.is_in(action)


def test_ranges_are_normalised_by_their_logarithm() -> None:
    ranges = torch.tensor([[0.25, 5.0], [0.5, -5.0], [1.0, 0.0]])
    normaliser = Normaliser(torch.tensor([True, False]), clip=10.0)
    normaliser.observe(ranges)
    near, middle, far = normaliser(ranges)[:, 0].tolist()
    assert middle - near == pytest.approx(far - middle)
    assert normaliser.mean.tolist() == pytest.approx([math.log(0.5), 0.0], abs=1e-6)


def test_normaliser_merges_batches_exactly() -> None:
    data = torch.randn(1000, 3) * torch.tensor([1.0, 5.0, 0.1]) + torch.tensor([0.0, -20.0, 3.0])
    normaliser = Normaliser(torch.zeros(3, dtype=torch.bool), clip=10.0)
    for part in data.split([1, 99, 400, 500]):
        normaliser.observe(part)
    assert torch.allclose(normaliser.mean, data.mean(0), atol=1e-4)
    assert torch.allclose(normaliser.variance, data.var(0, correction=0), rtol=1e-4)
    assert normaliser(torch.full((1, 3), 1e9)).max() == 10


def test_replay_keeps_the_newest_rows_and_survives_a_save(tmp_path: Path) -> None:
    replay = Replay(ReplayConf(capacity=100), 3, tmp_path / "ring")
    for start in range(0, 250, 50):
        replay.extend(torch.arange(start, start + 50).float()[:, None].expand(50, 3))
    again = Replay(ReplayConf(capacity=100), 3, tmp_path / "ring2")
    again.load(tmp_path / "r.npy", replay.save(tmp_path / "r.npy"))
    for each in (replay, again):
        assert {int(v) for rows in each.minibatches(40, 50) for v in rows[:, 0]} == set(range(150, 250))
    for each in (replay, again):
        each.extend(torch.full((10, 3), -1.0))
    assert torch.equal(replay._buffer.storage[:], again._buffer.storage[:])


def test_learning_rate_falls_linearly_to_its_end() -> None:
    sac = Sac(SacConf(hidden=(4,)), Layout.of(make_point_mass(1, 0)), total_frames=1000)
    rates = [sac.schedule(frames) for frames in (0, 500, 1000, 2000)]
    assert rates == pytest.approx([3e-4, 1.75e-4, 5e-5, 5e-5])


def test_training_seeds_are_no_evaluation_seeds() -> None:
    uses = product(range(20), range(4), (0, 9))
    seeds = {environment_seed(seed, worker, frames) for seed, worker, frames in uses}
    assert len(seeds) == 160
    assert min(seeds) > 10_000_000


def test_half_precision_updates_stay_close() -> None:
    layout = Layout.of(make_point_mass(1, 0))
    losses = []
    for precision in ("float32", "bfloat16"):
        torch.manual_seed(0)
        sac = Sac(SacConf(hidden=(32,), precision=precision), layout, 1)
        rows = torch.randn(256, sac.transitions.width)
        losses.append(sac.learn([rows])["loss/critic"])
    assert losses[0] != losses[1]
    assert losses[1] == pytest.approx(losses[0], rel=0.05)


def test_result_counts_updates_by_the_ratio(tmp_path: Path) -> None:
    result: TrainingResult = trainer(tmp_path / "run").train()
    # 512 frames of random actions; the batch that completes them is learnt from already.
    assert result.updates == (2048 - 512 + 128) // 16
    assert result.signal is None


def test_speeds_leave_out_a_pause_and_outlast_it(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter([0.0, 2.0, 100.0, 101.0])
    monkeypatch.setattr("dune_rl.learning.run_log.time.monotonic", lambda: next(clock))
    speed = Speed()
    assert speed.mark(0, 0) == (0.0, 0.0)
    assert speed.mark(600, 40) == (300.0, 20.0)
    speed.pause()
    assert speed.mark(600, 40) == (300.0, 20.0)
    assert speed.mark(700, 50) == (100.0, 10.0)
