"""The adversarial task in the simulation: who gets in the robot's way earns more than who does not."""

import pytest
import torch

import dune_rl
from dune_rl.learning.policies import GoToGoal
from dune_rl.learning.policy_spec import PolicySpec

STEPS, SCENES = 120, 8


def returns(behaviour: str) -> tuple[float, float]:
    """Mean return of a walker, and the robots' mean progress [m], among walkers of one kind."""
    env = dune_rl.make(
        world="flat",
        num_scenes=SCENES,
        seed=2,
        actors="learning_walkers",
        overrides=["actors.walker.task=adversarial", "task.spawn.min_goal_distance_m=8.0"],
    )
    drive = GoToGoal("rover", PolicySpec.of(env, "rover"))
    now, total = drive(env.reset()), 0.0
    begin = now["rover", "observation", "goal"][..., 0].mean()
    for _ in range(STEPS):
        seen = now["walker", "observation"]
        if behaviour == "still":
            action = torch.zeros(SCENES, 4, 2)
        else:
            # To where the robot will be in a second, and no nearer to it than a metre; or away from it.
            listed = seen["neighbours"].unflatten(-1, (4, 7))
            robot = (listed * listed[..., 6:]).sum(-2)
            place, closing, own = robot[..., 1:3], robot[..., 3:5], seen["velocity"]
            ahead = place + closing + own
            bearing = torch.atan2(ahead[..., 1], ahead[..., 0])
            away = bearing + torch.pi if behaviour == "flee" else bearing
            wrapped = torch.atan2(away.sin(), away.cos())
            near = (place.norm(dim=-1) < 1.0) & (behaviour == "block")
            action = torch.stack([robot[..., 0] * ~near, wrapped], dim=-1)
        now["walker", "action"] = action
        after = env.step(now)["next"]
        total += after["walker", "reward"].mean().item()
        done = after["rover", "done"]
        now = drive(after.select("rover", "walker"))
        now["rover", "action"] *= ~done
    progress = begin - now["rover", "observation", "goal"][..., 0].mean()
    env.close()
    return total, float(progress)


@pytest.mark.slow
def test_who_blocks_earns_most_and_who_pushes_least() -> None:
    earned, progress = {}, {}
    for behaviour in ("block", "still", "flee", "push"):
        earned[behaviour], progress[behaviour] = returns(behaviour)
    assert earned["block"] > earned["still"] + 1.0 > earned["flee"] + 1.0
    assert earned["block"] > earned["push"] + 1.0
    assert progress["block"] < progress["still"] and progress["block"] < progress["flee"]
