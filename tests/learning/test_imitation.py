"""Imitation: a teacher's costs of all commands as labels, and a policy that learns them."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import step_mdp

from dune_rl.config.build import make_learning_env
from dune_rl.config.compose import compose_environment
from dune_rl.core.errors import ConfigError
from dune_rl.env.torchrl.episode_metrics import simulation_in
from dune_rl.learning.algorithm import LearnerContext
from dune_rl.learning.checkpoint import LAST_POLICY_FILE
from dune_rl.learning.drivers import BoundDriver, DriverPolicy
from dune_rl.learning.group_policy import Deterministic
from dune_rl.learning.imitation.learner import Imitation
from dune_rl.learning.imitation.settings import ImitationConf
from dune_rl.learning.imitation.teacher import TEACHER_COSTS, TeacherLabels
from dune_rl.learning.networks.commands import command_grid, make_command_network
from dune_rl.learning.policy_spec import PolicySpec
from dune_rl.learning.settings import CollectorConf, EvaluationConf
from dune_rl.learning.trainer import Trainer
from dune_rl.state.command_grid import CommandGridConf

WORDS = ("actors=walkers", "task.terminations.time_limit.max_steps=80")
SPEC = PolicySpec({"goal": 2, "lidar": 36}, (-1.0, -3.14), (1.0, 3.14), ("lidar",))
SMALL = CommandGridConf(speeds=2, reverse_speeds=1, headings=5)


def make_env(scenes: int = 4, seed: int = 3, world: str = "inspection", **options):
    return make_learning_env(compose_environment(world, WORDS), scenes, seed, **options)


def test_a_grid_has_every_speed_with_every_heading_and_both_stand_still_and_straight_on() -> None:
    grid = command_grid(SPEC, CommandGridConf())
    assert grid.shape == (13 * 15, 2)
    assert grid.amin(0).tolist() == pytest.approx([-1.0, -1.0]) and grid.amax(0).tolist() == [1.0, 1.0]
    assert (grid == 0.0).all(1).sum() == 1
    forward_only = PolicySpec({"goal": 2}, (0.0, -0.5), (1.0, 0.5))
    assert command_grid(forward_only, SMALL).amin(0).tolist() == [0.0, -0.5]
    with pytest.raises(ConfigError, match="this one has 3 components"):
        command_grid(PolicySpec({"goal": 2}, (0.0,) * 3, (1.0,) * 3), SMALL)


@pytest.mark.slow
def test_the_planner_drives_by_the_command_that_it_scores_cheapest() -> None:
    env = make_env()
    env.reset()
    simulation = simulation_in(env)
    group = simulation.external[0]
    acts, scores = (BoundDriver("planner", simulation, group) for _ in range(2))
    commands = command_grid(PolicySpec.of(env, "rover"), CommandGridConf()).double().numpy()
    differences = []
    for _ in range(25):
        actions = acts.act()
        costs = scores.costs(commands, 8.0)
        scores.record(actions)
        assert costs.min(axis=1) == pytest.approx(np.zeros(4)) and costs.max() <= 8.0
        differences.append(np.abs(commands[costs.argmin(axis=1)] - actions).max())
        simulation.step({"rover": actions.reshape(4, 1, 2).astype(np.float32)})
    env.close()
    # Both grids have the same speeds and yaw rates; costs that are equal by rounding may be told apart.
    assert np.median(differences) < 1e-5


def labelled(share: float, noise: float = 0.0, change_cost: float = 0.0, standing_cost: float = 0.0):
    env = make_env()
    commands = command_grid(PolicySpec.of(env, "rover"), SMALL).double().numpy()
    labels = TeacherLabels("rover", "planner", commands, 8.0, change_cost, standing_cost, share, noise)
    return env.append_transform(labels), commands


@pytest.mark.slow
def test_labels_are_of_the_state_before_a_step_and_the_teacher_drives_in_its_share() -> None:
    env, commands = labelled(1.0)
    still = torch.zeros(4, 1, 2)
    rollout = env.rollout(20, lambda td: td.set(("rover", "action"), still), break_when_any_done=False)
    costs = rollout["next", "rover", TEACHER_COSTS]
    assert costs.shape == (4, 20, 1, len(commands))
    assert "teacher_costs" not in rollout["rover"].keys()  # noqa: SIM118
    assert float(costs.min(-1).values.abs().max()) == pytest.approx(0.0)
    # The policy would have stood still.
    assert float(rollout["next", "rover", "observation", "velocity"][..., 0].abs().max()) > 0.3
    own, _ = labelled(0.0)
    rollout = own.rollout(20, lambda td: td.set(("rover", "action"), still), break_when_any_done=False)
    assert float(rollout["next", "rover", "observation", "velocity"][..., 0].abs().max()) < 0.2
    noisy, _ = labelled(0.0, 1.0)
    rollout = noisy.rollout(60, lambda td: td.set(("rover", "action"), still), break_when_any_done=False)
    assert float(rollout["next", "rover", "observation", "velocity"][..., 0].abs().max()) > 0.2
    for each in (env, own, noisy):
        each.close()


def test_changes_of_the_command_cost_what_they_are_told_to() -> None:
    found = {}
    for change_cost in (0.0, 0.5):
        env, commands = labelled(0.0, change_cost=change_cost)
        td = env.reset()
        before = torch.tensor([0.7, -0.4]).expand(4, 1, 2)
        td = step_mdp(env.step(td.set(("rover", "action"), before.clone())))
        after = env.step(td.set(("rover", "action"), before.clone()))
        found[change_cost] = after["next", "rover", TEACHER_COSTS][:, 0].double()
        env.close()
    change = torch.tensor(np.abs(commands - [0.7, -0.4]).sum(axis=1))
    wanted = found[0.0] + 0.5 * change
    wanted = (wanted - wanted.min(-1, keepdim=True).values).clamp(max=8.0)
    # Those that are cut off at 8 m are not known to be more.
    known = found[0.0] < 7.0
    assert found[0.5][known].numpy() == pytest.approx(wanted[known].numpy(), abs=1e-4)


@pytest.mark.slow
def test_commands_of_no_speed_cost_what_they_are_told_to() -> None:
    found = {}
    for standing_cost in (0.0, 0.5):
        env, commands = labelled(0.0, standing_cost=standing_cost)
        after = env.step(env.reset().set(("rover", "action"), torch.zeros(4, 1, 2)))
        found[standing_cost] = after["next", "rover", TEACHER_COSTS][:, 0].double()
        env.close()
    stands = torch.tensor(commands[:, 0] == 0.0)
    assert stands.any() and not stands.all()
    wanted = found[0.0] + 0.5 * stands
    wanted = (wanted - wanted.min(-1, keepdim=True).values).clamp(max=8.0)
    assert found[0.5].numpy() == pytest.approx(wanted.numpy(), abs=1e-4)


def test_a_driver_without_costs_labels_by_the_distance_from_its_action() -> None:
    env = make_env(world="flat")
    commands = command_grid(PolicySpec.of(env, "rover"), SMALL).double().numpy()
    env.append_transform(TeacherLabels("rover", "mppi", commands, 8.0, 0.0, 0.0, 0.0, 0.0))
    reference = DriverPolicy("mppi", simulation_in(env), simulation_in(env).external[0])
    td = env.reset()
    wanted = reference(td.clone())["rover", "action"][:, 0]
    costs = env.step(td.set(("rover", "action"), torch.zeros(4, 1, 2)))["next", "rover", TEACHER_COSTS][:, 0]
    chosen = torch.from_numpy(commands).float()[costs.argmin(-1)]
    scale = torch.tensor([2.0, 2 * np.pi])
    nearest = ((torch.from_numpy(commands).float() - wanted[:, None]) / scale).norm(dim=-1).min(-1).values
    assert ((chosen - wanted) / scale).norm(dim=-1) == pytest.approx(nearest, abs=1e-5)
    env.close()


def learner(tmp_path: Path, **changes) -> Imitation:
    conf = ImitationConf(hidden=(32,), commands=SMALL, batch_size=64, updates_per_frame=0.1, **changes)
    context = LearnerContext("rover", 1, SPEC, 4096, tmp_path, torch.device("cpu"), "imitation")
    return Imitation(context, conf)


def test_what_is_learned_is_the_cost_of_every_command(tmp_path: Path) -> None:
    torch.manual_seed(0)
    imitation = learner(tmp_path, learning_starts=0, learning_rate=3e-3, max_cost=2.0)
    grid = command_grid(SPEC, SMALL)
    # A teacher that turns towards the goal at full speed.
    for _ in range(6):
        bearing = torch.rand(32, 16, 1, 1) * 2 - 1
        distance = torch.rand(32, 16, 1, 1) * 5
        costs = (grid[:, 1] - bearing).abs() + 0.5 * (1.0 - grid[:, 0])
        costs = costs - costs.min(-1, keepdim=True).values
        observation = {"goal": torch.cat([distance, bearing], -1), "lidar": torch.full((32, 16, 1, 36), 6.0)}
        shape = (32, 16, 1)
        running = torch.zeros(*shape, 1, dtype=torch.bool)
        after = TensorDict({TEACHER_COSTS: costs.clamp(max=2.0), "done": running}, shape)
        now = {"observation": TensorDict(observation, shape), "done": running, "next": after}
        imitation.absorb(TensorDict(now, shape), 512)
        logged = imitation.update()
    assert imitation.updates == 6 * 512 // 10
    assert logged["imitation/regret_m"] < 0.05
    test = TensorDict(
        {"rover": TensorDict({"observation": {key: each[:, 0] for key, each in observation.items()}})}, [32]
    )
    action = Deterministic(imitation.policy)(test)["rover", "action"][:, 0]
    assert (action[:, 0] > 0.9).float().mean() > 0.9
    best = grid[(grid[None, :, 1] - bearing[:, 0, 0]).abs().argmin(-1), 1]
    assert ((action[:, 1] - best).abs() < 0.3).float().mean() > 0.85


def test_a_policy_begins_with_the_costs_that_its_prior_guesses(tmp_path: Path) -> None:
    spec = PolicySpec({"goal": 2, "guess": 4 * 5}, (-1.0, -3.14), (1.0, 3.14))
    conf = ImitationConf(commands=SMALL, prior="guess", hidden=(16,))
    context = LearnerContext("rover", 1, spec, 4096, tmp_path, torch.device("cpu"), "imitation")
    found = Imitation(context, conf)
    torch.manual_seed(0)
    guess = 8.0 * torch.rand(6, 20)
    parts = TensorDict({"goal": torch.randn(6, 2), "guess": guess}, [6])
    acted = found.policy.network(parts.clone())
    torch.testing.assert_close(acted["costs"], guess)
    assert torch.equal(acted["action"], command_grid(spec, SMALL)[guess.argmin(-1)])
    # It counts once more where it decides, and not in what is learned.
    torch.nn.init.normal_(found.policy.network[1].module.body[-1].weight)
    for weight in (0.0, 3.0):
        settings = {**found.network_settings(), "prior_weight": weight}
        again = make_command_network(spec, settings)
        again.load_state_dict(found.policy.network.state_dict())
        acted = again(parts.clone())
        torch.testing.assert_close(acted["costs"], found.policy.network(parts.clone())["costs"])
        decisive = acted["costs"] + weight * guess
        assert torch.equal(acted["action"], command_grid(spec, SMALL)[decisive.argmin(-1)])
    for prior, said in (
        ("guessed", "no vector that the policy observes; did you mean guess"),
        ("command_costs", r"add \+sensors\.command_costs={}"),
        ("goal", "has 2 v"),
    ):
        wrong = conf.model_copy(update={"prior": prior})
        with pytest.raises(ConfigError, match=f"learning\\.prior={prior}.*{said}"):
            Imitation(context, wrong)


@pytest.mark.slow
def test_a_run_saves_and_goes_on(tmp_path: Path) -> None:
    conf = ImitationConf(
        hidden=(32,),
        commands=SMALL,
        batch_size=64,
        learning_starts=128,
        collector=CollectorConf(mode="serial", scenes=4, steps=16),
        evaluation=EvaluationConf(every_frames=10_000, episodes=2, scenes=2, tracks=0),
    )
    make = partial(Trainer, make_env, tmp_path / "run", conf, seed=1, total_frames=384)
    first = make().train(stop_after_frames=192)
    assert first.frames == 192
    result = make(resume=tmp_path / "run").train()
    assert result.frames == 384 and result.updates > first.updates > 0
    assert len(result.evaluation["rover"]) == 2
    # No warning tells that critics begin anew, as there are none.
    further = conf.model_copy(update={"start_from": str(tmp_path / "run" / LAST_POLICY_FILE)})
    assert Trainer(make_env, tmp_path / "b", further, seed=1, total_frames=64).train().frames == 64


@pytest.mark.slow
def test_what_cannot_teach_is_refused_before_training(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"no behaviour 'planer'.* planner"):
        ImitationConf(teacher="planer")
    joints = make_learning_env(compose_environment("flat", ["robot=hyperdog", "robot.action=joints"]), 1, 0)
    with pytest.raises(ConfigError, match=r"an action of speed and heading, and this one has 12"):
        Trainer(lambda *_: joints, tmp_path / "a", ImitationConf(), seed=1, total_frames=64)
    blind = make_learning_env(compose_environment("flat", ["sensors=[goal]"]), 1, 0)
    with pytest.raises(ConfigError, match=r"learning.teacher=mppi: .* has no lidar"):
        Trainer(lambda *_: blind, tmp_path / "b", ImitationConf(teacher="mppi"), seed=1, total_frames=64)
    words = ["+sensors.height_scan={privileged: true}"]
    hidden = make_learning_env(compose_environment("flat", words), 1, 0)
    with pytest.raises(ConfigError, match="no critic that would read the privileged height_scan"):
        Trainer(lambda *_: hidden, tmp_path / "c", ImitationConf(), seed=1, total_frames=64)
    words = ["sensors=perception", "+sensors.command_costs={commands: {max_heading_rad: 0.5}}"]
    narrow = make_learning_env(compose_environment("flat", words), 1, 0)
    with pytest.raises(ConfigError, match=r"sensors.command_costs.commands \(.*=0.5\), differ"):
        Trainer(
            lambda *_: narrow, tmp_path / "d", ImitationConf(prior="command_costs"), seed=1, total_frames=64
        )
    for each in (joints, blind, hidden, narrow):
        each.close()
