"""The TorchRL environment over resets, saved states, collectors and diverged physics."""

import io
from functools import partial
from typing import Any

import numpy as np
import pytest
import torch
from scripted_physics import scripted_simulation
from tensordict import TensorDictBase
from torchrl.collectors import Collector
from torchrl.envs import ParallelEnv, TransformedEnv
from torchrl.envs.utils import RandomPolicy
from torchrl_steps import SHORT, acted, advance, make, metric, observed

from dune_rl.env.torchrl import DuneEnv, EpisodeMetrics


def five_steps(**terminations: Any) -> dict[str, Any]:
    return {"terminations": {"time_limit": {"max_steps": 5}, **terminations}}


def same(one: TensorDictBase, other: TensorDictBase) -> bool:
    """Whether two tensordicts hold the same keys and the same bytes."""
    left, right = one.flatten_keys("/"), other.flatten_keys("/")
    return set(left.keys()) == set(right.keys()) and all(
        value.dtype == right[key].dtype and value.numpy().tobytes() == right[key].numpy().tobytes()
        for key, value in left.items()
    )


# -- time, and resets ------------------------------------------------------------------------------


@pytest.mark.parametrize("actors", ["none", "external_walkers"])
def test_time_limit_truncates_and_resets_all(actors: str) -> None:
    env = make("flat", 3, actors=actors, task=five_steps())
    data = env.rollout(12, break_when_any_done=False)
    late = torch.tensor([step in (4, 9) for step in range(12)]).expand(3, 12)
    assert torch.equal(data["next", "truncated"][..., 0], late)
    assert torch.equal(data["next", "done"][..., 0], late)
    assert not data["next", "terminated"].any()
    assert torch.equal(metric(env, data["next"], "timeout").bool(), late)
    # Scene i of three runs the episodes i, i + 3, i + 6.
    rounds = torch.tensor([0] * 5 + [3] * 5 + [6] * 2)
    assert torch.equal(metric(env, data, "episode").long(), torch.arange(3)[:, None] + rounds)
    env.close()


def test_the_step_that_ends_shows_the_true_final_observation() -> None:
    env = make("flat", 2, actors="none", task=five_steps())
    data = env.rollout(7, break_when_any_done=False)
    goal, following = observed(data, "goal")[..., 0], observed(data["next"], "goal")[..., 0]
    last, first = following[:, 4], goal[:, 5]
    assert ((goal[:, 4] - last).abs() < 0.06).all()
    assert ((last - first).abs() > 0.06).all()
    assert (metric(env, data["next"], "steps")[:, 4] == 5).all()
    assert (metric(env, data, "steps")[:, 5] == 0).all()
    env.close()


def test_past_scan_of_a_rover_that_stands_is_the_scan_of_0_5_s_ago_but_never_of_another_episode() -> None:
    env = make("inspection", 3, 2, actors="walkers", task=SHORT)
    data, steps = env.reset(), []
    for _ in range(30):
        data["rover", "action"] = torch.zeros(3, 1, 2)
        data = env.step_and_maybe_reset(data)[1]
        steps.append(data.clone())
    told = torch.stack(steps)
    age = metric(env, told, "steps").long()
    for now in range(30):
        for scene in range(3):
            then = now - min(10, int(age[now, scene]))
            if then >= 0:
                past, present = observed(told, "lidar_past")[now, scene], observed(told, "lidar")[then, scene]
                # The suspension gives a little, and at a slant that can carry a beam over an edge.
                assert ((past - present).abs() < 0.05).float().mean() > 0.8
    assert len(set(age[-1].tolist())) > 1
    env.close()


@pytest.mark.slow(all_but=["external_walkers"])
@pytest.mark.parametrize("actors", ["walkers", "external_walkers"])
def test_partial_reset_leaves_other_scenes_alone(actors: str) -> None:
    settings: dict[str, Any] = {
        "actors": actors,
        "task": {"terminations": {"goal_reached": {"distance_m": 0.01}}},
    }
    env, undisturbed = (make("inspection", 4, 7, **settings) for _ in range(2))
    _, data = advance(env, env.reset(), 8, 1)
    _, other = advance(undisturbed, undisturbed.reset(), 8, 1)
    before = data.clone()
    mask = torch.tensor([True, False, False, True])
    data.set("_reset", mask.unsqueeze(-1))
    after = env.reset(data).exclude("_reset")
    stayed = ~mask
    assert same(after[stayed], before[stayed].select(*after.keys(True, True)))
    assert metric(env, after, "episode").tolist() == [4, 1, 2, 7]
    assert metric(env, after, "steps").tolist() == [0, 8, 8, 0]
    steps, _ = advance(env, after, 8, 2)
    expected, _ = advance(undisturbed, other, 8, 2)
    assert same(steps[:, stayed], expected[:, stayed])
    assert not same(steps[:, mask], expected[:, mask])
    env.close()
    undisturbed.close()


def test_reset_episode_is_the_one_a_full_reset_gives() -> None:
    env, other = (make("inspection", 2, 3, actors="walkers") for _ in range(2))
    _, data = advance(env, env.reset(), 5, 1)
    data.set("_reset", torch.tensor([[False], [True]]))
    partly = env.reset(data)
    other.reset()
    wholly = other.reset()
    assert same(partly["rover"][1].exclude("action"), wholly["rover"][1])
    env.close()
    other.close()


def test_set_seed_begins_again_at_episode_zero() -> None:
    env = make("inspection", 2, 5, actors="walkers")
    first = env.reset().clone()
    advance(env, env.reset(), 5, 1)
    env.set_seed(6)
    another = env.reset().clone()
    env.set_seed(5)
    assert same(env.reset(), first)
    assert metric(env, another, "episode").tolist() == [0, 1]
    assert not torch.equal(observed(another, "goal"), observed(first, "goal"))
    env.close()


# -- state and resumption --------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("world", "actors"),
    [("inspection", "walkers"), ("inspection", "external_walkers")],
)
def test_resumed_rollout_equals_the_uninterrupted_one(world: str, actors: str) -> None:
    # Time limits alone would end all at once; arrivals set the scenes apart.
    settings = {
        "actors": actors,
        "task": {"terminations": {"time_limit": {"max_steps": 25}, "goal_reached": {"distance_m": 3.0}}},
    }
    whole = make(world, 5, 21, **settings)
    _, data = advance(whole, whole.reset(), 33, 1)
    file = io.BytesIO()
    torch.save(whole.state(), file)
    file.seek(0)
    resumed = make(world, 5, 99, **settings)
    advance(resumed, resumed.reset(), 4, 9)
    resumed.resume(torch.load(file, weights_only=True))
    steps = metric(whole, data, "steps").tolist()
    assert len(set(steps)) > 1
    again = resumed.reset()
    assert same(again, data.select(*again.keys(True, True)))
    assert metric(whole, again, "steps").tolist() == steps
    expected, _ = advance(whole, data, 40, 2)
    found, _ = advance(resumed, again, 40, 2)
    assert expected["next", "done"].any()
    assert same(found, expected)
    assert whole.state() == resumed.state()
    whole.close()
    resumed.close()


def test_resume_holds_for_one_reset() -> None:
    env = make("flat", 2, 1, actors="none")
    advance(env, env.reset(), 6, 1)
    env.resume(env.state())
    assert metric(env, env.reset(), "steps").tolist() == [6, 6]
    after = env.reset()
    assert metric(env, after, "steps").tolist() == [0, 0]
    assert metric(env, after, "episode").tolist() == [2, 3]
    env.close()


def test_state_of_a_fresh_episode_resumes() -> None:
    env = make("flat", 2, 1, actors="walkers")
    first = env.reset().clone()
    env.resume(env.state())
    assert same(env.reset(), first)
    env.close()


# -- under TorchRL's machinery ---------------------------------------------------------------------


@pytest.mark.parametrize("actors", ["walkers", "external_walkers"])
def test_collector_gives_batches_across_ends(actors: str) -> None:
    env = make("flat", 4, actors=actors, task=SHORT)
    keys = list(env.full_action_spec.keys(True, True))
    policy = RandomPolicy(env.full_action_spec, action_key=keys[0]) if len(keys) == 1 else None
    collector = Collector(env, policy, frames_per_batch=48, total_frames=144, track_traj_ids=False)
    ends, batches, last = 0, 0, None
    for batch in collector:
        assert batch.shape == (4, 12)
        if last is not None:
            # What one batch ends on, the next one starts from.
            steps = metric(env, batch, "steps")[:, 0]
            before = metric(env, last["next"], "steps")
            assert torch.equal(steps, torch.where(last["next", "done"][:, 0], 0.0, before))
        ends += int(batch["next", "done"].sum())
        last = batch[:, -1].clone()
        batches += 1
    assert batches == 3
    assert ends >= 4 * 3
    collector.shutdown()


@pytest.mark.slow
def test_a_worker_process_gives_what_this_process_gives() -> None:
    factory = partial(make, "flat", 3, 4, actors="external_walkers", task=SHORT)
    worker = ParallelEnv(1, factory, mp_start_method="spawn")
    try:
        assert worker.batch_size == (1, 3)
        found, _ = advance(worker, worker.reset(), 20, 3)
    finally:
        worker.close()
    env = factory()
    expected, _ = advance(env, env.reset(), 20, 3)
    assert same(found["next"][:, 0], expected["next"])
    assert expected["next", "done"].sum() >= 6
    env.close()


# -- physics that diverges -------------------------------------------------------------------------


@pytest.mark.parametrize("actors", ["none", "external_walkers"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_diverged_physics_truncates_with_finite_observations(actors: str, value: float) -> None:
    # A scene for each number of the state that can go wrong, and one where none does.
    simulation, robots = scripted_simulation(num_scenes=14, actors=actors)
    env = TransformedEnv(DuneEnv(simulation), EpisodeMetrics())
    data = env.reset()
    for component, robot in enumerate(robots[:13]):
        robot.state[component] = value
    now, after = env.step_and_maybe_reset(acted(env, data, torch.Generator().manual_seed(0)))
    now = now["next"]
    bad = [True] * 13 + [False]
    assert metric(env, now, "diverged").bool().tolist() == bad
    for ends in (now, *(now[group] for group in env.group_map)):
        assert ends["truncated"].reshape(14, -1).all(dim=1).tolist() == bad
        assert not ends["terminated"].any()
    undefined = [env.metric_names["rover"].index(name) for name in ("time_to_goal", "vort")]
    for part in (now, after):
        assert env.observation_spec.contains(part.select(*env.observation_spec.keys(True, True)))
        for key, leaf in part.items(True, True):
            shown = leaf.clone().float()
            if key[-1] == "metrics":
                shown[..., undefined] = 0.0
            assert shown.isfinite().all(), f"{key} is not finite"
    passed = metric(env, after, "episode") - metric(env, now, "episode")
    assert passed.tolist() == [14] * 13 + [0]
    assert not metric(env, after, "diverged").any()
