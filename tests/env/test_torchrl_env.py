"""The TorchRL environment: groups, partial resets, state, workers, and physics that diverges."""

import io
from functools import partial
from typing import Any

import numpy as np
import pytest
import torch
from scripted_physics import scripted_simulation
from tensordict import TensorDictBase
from torchrl.collectors import Collector
from torchrl.envs import Compose, EnvBase, ParallelEnv, TransformedEnv
from torchrl.envs.utils import RandomPolicy

import dune_rl
from dune_rl.env.torchrl import DuneEnv, EpisodeMetrics, SingleAgent
from dune_rl.errors import ConfigError
from dune_rl.tasks.task import POINT_GOAL_REWARDS

# Goals lie 2 m away and more: some episodes end by arrival, many at once, and the others by time.
SHORT = {"terminations": {"time_limit": {"max_steps": 9}, "goal_reached": {"distance_m": 3.0}}}
ENDS = ("done", "terminated", "truncated")
PROMISED_METRICS = (
    "episode",
    "steps",
    "return",
    "success",
    "reached",
    "collisions",
    "time_to_goal",
    "clearance",
    "min_clearance",
    "vertical_roughness",
    "vort",
    "smoothness",
    "diverged",
    "stuck",
    "flipped",
    "out_of_world",
    "timeout",
)


def five_steps(**terminations: Any) -> dict[str, Any]:
    return {"terminations": {"time_limit": {"max_steps": 5}, **terminations}}


def make(*args: Any, **settings: Any) -> EnvBase:
    """`dune_rl.make`, with metrics."""
    return TransformedEnv(dune_rl.make(*args, **settings), EpisodeMetrics())


def same(one: TensorDictBase, other: TensorDictBase) -> bool:
    """Whether two tensordicts hold the same keys and the same bytes."""
    left, right = one.flatten_keys("/"), other.flatten_keys("/")
    return set(left.keys()) == set(right.keys()) and all(
        value.dtype == right[key].dtype and value.numpy().tobytes() == right[key].numpy().tobytes()
        for key, value in left.items()
    )


def acted(env: EnvBase, data: TensorDictBase, generator: torch.Generator) -> TensorDictBase:
    """`data` with random actions, which depend on `generator` alone."""
    spec = env.full_action_spec
    for key in spec.keys(True, True):
        low, high = spec[key].space.low, spec[key].space.high
        data.set(key, low + (high - low) * torch.rand(low.shape, generator=generator))
    return data


def advance(
    env: EnvBase, data: TensorDictBase, steps: int, seed: int
) -> tuple[TensorDictBase, TensorDictBase]:
    """The steps (time first) of a random rollout with resets, and the data that the next step starts from."""
    generator = torch.Generator().manual_seed(seed)
    out = []
    for _ in range(steps):
        now, data = env.step_and_maybe_reset(acted(env, data, generator))
        out.append(now.clone())
    return torch.stack(out), data


def metric(env: EnvBase, data: TensorDictBase, name: str, group: str = "rover") -> torch.Tensor:
    """A metric of the first agent of each scene."""
    return data[group, "metrics"][..., 0, env.metric_names[group].index(name)]


def observed(data: TensorDictBase, name: str) -> torch.Tensor:
    """What the rover of each scene observes."""
    return data["rover", "observation", name][..., 0, :]


# -- shapes and groups -----------------------------------------------------------------------------


def test_keys_of_a_single_agent_are_flat_with_the_transform() -> None:
    env = dune_rl.make("flat", 3, actors="walkers")
    env = TransformedEnv(env, Compose(EpisodeMetrics(), SingleAgent()))
    shapes = {"lidar": (3, 32), "lidar_past": (3, 32), "imu": (3, 9), "goal": (3, 2), "velocity": (3, 2)}
    assert env.batch_size == (3,)
    data = env.rollout(2)
    for key, shape in shapes.items():
        assert data[key][:, 0].shape == shape
        assert data[key].dtype == torch.float32
        assert env.observation_spec[key].space.low.shape == shape
    assert data["action"].shape == (3, 2, 2)
    assert data["next", "reward"].shape == (3, 2, 1)
    for key in ENDS:
        assert data["next", key].shape == (3, 2, 1)
        assert data["next", key].dtype == torch.bool
    assert data["metrics"].shape == (3, 2, len(env.metric_names["rover"]))
    assert set(data.keys()) == {*shapes, "action", "metrics", "next", *ENDS}
    env.close()


def test_flat_keys_have_the_values_of_the_group() -> None:
    settings: dict[str, Any] = {"actors": "none", "task": SHORT}
    env, flat = make("flat", 3, **settings), dune_rl.make("flat", 3, **settings)
    flat = TransformedEnv(flat, Compose(EpisodeMetrics(), SingleAgent()))
    expected, _ = advance(env, env.reset(), 12, 0)
    found, _ = advance(flat, flat.reset(), 12, 0)
    assert expected["next", "done"].any()
    for name in env.observation_spec["rover", "observation"]:
        assert torch.equal(found["next", name], observed(expected["next"], name))
    for key in ("reward", "metrics"):
        values, others = found["next", key], expected["next", "rover", key][..., 0, :]
        assert torch.equal(values.nan_to_num(-1.0), others.nan_to_num(-1.0))
    assert torch.equal(found["next", "done"], expected["next", "done"])
    env.close()
    flat.close()


@pytest.mark.parametrize("settings", [{"robots": ["rover_zero"] * 2}, {"actors": "external_walkers"}])
def test_several_agents_have_no_flat_keys(settings: dict[str, Any]) -> None:
    env = TransformedEnv(dune_rl.make("flat", 1, **{"actors": "none"} | settings), SingleAgent())
    with pytest.raises(ValueError, match=r"SingleAgent needs one agent, but the environment has rover_0, "):
        env.reset()
    env.close()


def test_an_environment_without_external_agents_is_refused() -> None:
    with pytest.raises(ConfigError, match="no agent group is external"):
        dune_rl.make("flat", 1, agents={"walker": {"body": "person", "controller": "path"}})


def test_agents_are_grouped() -> None:
    env = dune_rl.make("flat", 3, actors="external_walkers")
    assert env.group_map == {"rover": ["rover_0"], "walker": ["walker_0", "walker_1"]}
    data = env.rollout(2)
    widths = {
        "rover": {"lidar": 32, "lidar_past": 32, "imu": 9, "goal": 2, "velocity": 2},
        "walker": {"goal": 2, "nearest_agent": 4, "velocity": 2},
    }
    for group, members in env.group_map.items():
        count = len(members)
        observation = data[group, "observation"]
        assert {key: value.shape[-1] for key, value in observation.items()} == widths[group]
        for value in observation.values():
            assert value.shape[:-1] == (3, 2, count)
            assert value.dtype == torch.float32
        assert data[group, "action"].shape == (3, 2, count, 2)
        assert data["next", group, "reward"].shape == (3, 2, count, 1)
        for key in ENDS:
            assert data["next", group, key].shape == (3, 2, count, 1)
    assert data["next", "done"].shape == (3, 2, 1)
    env.close()


def test_actions_are_in_physical_units() -> None:
    env = dune_rl.make("flat", 2, actors="external_walkers", robot={"drive": {"max_speed_mps": 0.7}})
    rover, walker = (env.full_action_spec[group, "action"].space for group in ("rover", "walker"))
    torch.testing.assert_close(rover.high[0, 0], torch.tensor([0.7, torch.pi]))
    torch.testing.assert_close(rover.low[0, 0], -torch.tensor([0.7, torch.pi]))
    torch.testing.assert_close(walker.low[0, 1], torch.tensor([0.0, -torch.pi]))
    torch.testing.assert_close(walker.high[0, 1], torch.tensor([1.0, torch.pi]))
    env.close()


def test_metric_columns_are_named() -> None:
    env = make("flat", 2, actors="external_walkers")
    names = env.metric_names["rover"]
    assert set(env.metric_names["walker"]) >= {"steps", "return", "goals", "reward/progress"}
    assert set(PROMISED_METRICS) <= set(names)
    terms = [name.removeprefix("reward/") for name in names if name.startswith("reward/")]
    assert terms == list(POINT_GOAL_REWARDS)
    assert len(set(names)) == len(names)
    assert env.observation_spec["rover", "metrics"].shape == (2, 1, len(names))
    data = env.rollout(4)
    assert metric(env, data["next"], "steps").tolist() == [[1, 2, 3, 4]] * 2
    assert metric(env, data["next"], "episode").tolist() == [[0] * 4, [1] * 4]
    returns = data["next", "rover", "reward"][..., 0, 0].cumsum(dim=1)
    torch.testing.assert_close(metric(env, data["next"], "return"), returns)
    env.close()


def test_walkers_end_is_the_rovers_and_is_a_truncation() -> None:
    env = dune_rl.make("flat", 6, actors="external_walkers", task=SHORT)
    steps, _ = advance(env, env.reset(), 20, 0)
    following = steps["next"]
    terminated, truncated = following["terminated"], following["truncated"]
    assert terminated.any() and truncated.any()
    assert torch.equal(following["done"], terminated | truncated)
    assert not (terminated & truncated).any()
    for key in ENDS:
        assert torch.equal(following["rover", key][..., 0], following[key])
    both = following["done"].unsqueeze(2).expand(-1, -1, 2, -1)
    assert torch.equal(following["walker", "done"], both)
    assert torch.equal(following["walker", "truncated"], both)
    assert not following["walker", "terminated"].any()
    env.close()


def test_an_agent_s_end_is_its_own_and_stays_until_the_episode_s() -> None:
    env = make("flat", 4, robots=["rover_zero"] * 3, actors="none", task=SHORT)
    steps, _ = advance(env, env.reset(), 40, 0)
    following = steps["next"]
    team = {key: following["rover", key][..., 0] for key in ENDS}
    assert torch.equal(team["done"], team["terminated"] | team["truncated"])
    assert not (team["terminated"] & team["truncated"]).any()
    # All are done with the episode, and it is over when all are.
    over = following["done"][..., 0]
    assert torch.equal(over, team["done"].all(dim=-1))
    assert torch.equal(following["terminated"][..., 0], team["terminated"].all(dim=-1))
    assert torch.equal(following["truncated"][..., 0], over & ~following["terminated"][..., 0])
    waiting = team["done"] & ~over.unsqueeze(-1)
    assert waiting.any(), "nobody arrived before the others"
    for step in range(39):
        mine, later = waiting[step], team["done"][step + 1]
        assert later[mine].all(), "an end is taken back"
        for key in ENDS:
            assert torch.equal(team[key][step][mine], team[key][step + 1][mine])
        assert not following["rover", "reward"][step + 1][..., 0][mine].any()
        before, after = (following["rover", "metrics"][at][mine].nan_to_num(-1.0) for at in (step, step + 1))
        assert torch.equal(before, after)
    env.close()


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
