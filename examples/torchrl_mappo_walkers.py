"""Multi-agent PPO on two walkers with TorchRL's own modules: python examples/torchrl_mappo_walkers.py

The walkers share one policy, and one critic that sees both (MAPPO); with `--own-critic` the critic judges
each by what it sees alone (IPPO). They learn to walk to and fro between two places, clear of each other and
of the rover, which a behaviour of ours drives. TorchRL collects, estimates advantages and computes the loss.
"""

import argparse
from collections.abc import Sequence
from typing import NamedTuple

import torch
from tensordict import TensorDictBase
from tensordict.nn import NormalParamExtractor, TensorDictModule, TensorDictSequential
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, ReplayBuffer, SamplerWithoutReplacement
from torchrl.envs import EnvBase, RewardSum, TransformedEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import MultiAgentMLP, ProbabilisticActor, TanhNormal
from torchrl.objectives import ClipPPOLoss, ValueEstimators

import dune_rl

GROUP = "walker"
EVALUATION_SEED = 1_000_003


class Result(NamedTuple):
    """Mean returns of a walker's episodes: of those that ended in each batch, and in the evaluation."""

    collected: list[float]
    evaluated: float


def make_env(world: str, scenes: int, seed: int, max_steps: int) -> EnvBase:
    """Scenes in which the walkers are agents, each with one vector of observations."""
    limit = {"max_steps": max_steps, "truncates": True}
    agents = {
        "rover": {"body": "rover_zero", "controller": "go_to_goal"},
        GROUP: {
            "body": "person",
            "count": 2,
            "controller": "external",
            "task": {"name": "walking", "terminations": {"time_limit": limit}},
        },
    }
    env = dune_rl.make(world, scenes, seed, flatten=True, agents=agents)
    return TransformedEnv(env, RewardSum(in_keys=[(GROUP, "reward")], reset_keys=["_reset"]))


def make_policy(env: EnvBase, cells: int) -> ProbabilisticActor:
    """One network for all walkers, each of which acts by what it sees alone."""
    sizes = {"num_cells": [cells, cells], "activation_class": torch.nn.Tanh}
    spec = env.full_action_spec_unbatched[GROUP, "action"]
    agents, numbers = spec.shape
    seen = env.full_observation_spec_unbatched[GROUP, "observation"].shape[-1]
    network = MultiAgentMLP(seen, 2 * numbers, agents, centralised=False, share_params=True, **sizes)
    parameters = TensorDictModule(
        torch.nn.Sequential(network, NormalParamExtractor()),
        in_keys=[(GROUP, "observation")],
        out_keys=[(GROUP, "loc"), (GROUP, "scale")],
    )
    return ProbabilisticActor(
        TensorDictSequential(parameters),
        spec=spec,
        in_keys=[(GROUP, "loc"), (GROUP, "scale")],
        out_keys=[(GROUP, "action")],
        distribution_class=TanhNormal,
        distribution_kwargs={"low": spec.space.low, "high": spec.space.high},
        return_log_prob=True,
        log_prob_key=(GROUP, "log_prob"),
    )


def make_critic(env: EnvBase, cells: int, *, central: bool) -> TensorDictModule:
    """The value of each walker's state: by the observations of all (MAPPO) or of that one (IPPO)."""
    agents, seen = env.full_observation_spec_unbatched[GROUP, "observation"].shape
    sizes = {"num_cells": [cells, cells], "activation_class": torch.nn.Tanh}
    network = MultiAgentMLP(seen, 1, agents, centralised=central, share_params=True, **sizes)
    return TensorDictModule(network, in_keys=[(GROUP, "observation")], out_keys=[(GROUP, "state_value")])


def make_loss(policy: ProbabilisticActor, critic: TensorDictModule) -> ClipPPOLoss:
    """PPO's clipped objective with generalised advantages, of the walkers' keys."""
    loss = ClipPPOLoss(
        policy,
        critic,
        clip_epsilon=0.2,
        entropy_coeff=0.001,
        normalize_advantage=True,
        # Each walker's advantages are normalised for themselves.
        normalize_advantage_exclude_dims=(-2,),
    )
    names = ("reward", "action", "done", "terminated", "advantage", "value_target")
    loss.set_keys(
        **{name: (GROUP, name) for name in names},
        value=(GROUP, "state_value"),
        sample_log_prob=(GROUP, "log_prob"),
    )
    loss.make_value_estimator(ValueEstimators.GAE, gamma=0.99, lmbda=0.95)
    return loss


def mean_return(data: TensorDictBase) -> float:
    """Mean return of the episodes that ended in a batch (scenes, steps); NaN if none did."""
    returns = data["next", GROUP, "episode_reward"][data["next", "done"].squeeze(-1)]
    return float(returns.mean())


def evaluate(env: EnvBase, policy: ProbabilisticActor, max_steps: int) -> float:
    """Mean return of one episode in each scene, by the policy's most likely actions."""
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        return mean_return(env.rollout(max_steps, policy, break_when_any_done=False))


def main(arguments: Sequence[str] | None = None) -> Result:
    """Train and evaluate."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--world", default="flat")
    parser.add_argument("--scenes", type=int, default=16)
    parser.add_argument("--frames", type=int, default=60_000, help="control steps of all scenes together")
    parser.add_argument("--rollout", type=int, default=200, help="steps of each scene between two updates")
    parser.add_argument("--max-steps", type=int, default=200, help="length of an episode")
    parser.add_argument("--epochs", type=int, default=10)
    parser.add_argument("--cells", type=int, default=64)
    parser.add_argument("--own-critic", action="store_true", help="IPPO in place of MAPPO")
    chosen = parser.parse_args(arguments)

    torch.manual_seed(0)
    env = make_env(chosen.world, chosen.scenes, 0, chosen.max_steps)
    policy, critic = (
        make_policy(env, chosen.cells),
        make_critic(env, chosen.cells, central=not chosen.own_critic),
    )
    loss = make_loss(policy, critic)
    optimizer = torch.optim.Adam(loss.parameters(), 3e-4)
    frames = chosen.scenes * chosen.rollout
    collector = Collector(
        env,
        policy,
        frames_per_batch=frames,
        total_frames=-(-chosen.frames // frames) * frames,
        # The policy has no recurrent state.
        auto_register_policy_transforms=False,
    )
    buffer = ReplayBuffer(
        storage=LazyTensorStorage(frames), sampler=SamplerWithoutReplacement(), batch_size=max(frames // 4, 1)
    )
    returns = []
    for batch in collector:
        returns.append(mean_return(batch))
        with torch.no_grad():
            loss.value_estimator(batch, params=loss.critic_network_params)
        buffer.extend(batch.reshape(-1))
        for _ in range(chosen.epochs):
            for part in buffer:
                terms = loss(part)
                optimizer.zero_grad()
                sum(terms[name] for name in ("loss_objective", "loss_entropy", "loss_critic")).backward()
                torch.nn.utils.clip_grad_norm_(loss.parameters(), 1.0)
                optimizer.step()
        collector.update_policy_weights_()
        print(f"{len(returns) * frames:8d} frames   return {returns[-1]:7.2f}", flush=True)
    collector.shutdown()
    test = make_env(chosen.world, chosen.scenes, EVALUATION_SEED, chosen.max_steps)
    evaluated = evaluate(test, policy, chosen.max_steps)
    test.close()
    print(f"return in new episodes: {evaluated:.2f}")
    return Result(returns, evaluated)


if __name__ == "__main__":
    main()
