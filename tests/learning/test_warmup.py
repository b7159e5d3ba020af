"""Who drives in the warm-up, where groups begin in different ways and for different numbers of frames."""

from pathlib import Path

import pytest
import torch
from point_mass import make_two_groups
from training import assert_halves_make_a_whole, make_sac, small

from dune_rl.learning.policies import UniformRandom, WarmUp, WarmupPolicy
from dune_rl.learning.policy_spec import PolicySpec


@pytest.fixture
def specs() -> dict[str, PolicySpec]:
    env = make_two_groups(1, 0)
    return {group: PolicySpec.of(env, group) for group in ("rover", "walker")}


def warm_up_of(folder: Path, specs: dict[str, PolicySpec], **settings: dict) -> WarmUp:
    return WarmUp(
        {
            group: make_sac(spec, folder, hidden=(8,), group=group, **settings[group])
            for group, spec in specs.items()
        }
    )


def test_each_group_is_warmed_up_in_its_own_way(tmp_path: Path, specs) -> None:
    starts = {"learning_starts": 100}
    warm_up = warm_up_of(
        tmp_path, specs, rover={"warm_up": "go_to_goal", **starts}, walker={"warm_up": "random", **starts}
    )
    assert {group: type(one) for group, one in warm_up.begin_phase(0).items()} == {
        "rover": WarmupPolicy,
        "walker": UniformRandom,
    }
    assert warm_up.describe(0) == "scripted" and warm_up.learners_policies() == {}
    assert not warm_up.is_over(99) and warm_up.is_over(100)
    assert warm_up.begin_phase(100) == {} and not warm_up.is_over(100)
    assert warm_up.describe(100) is None and warm_up.learners_policies().keys() == {"rover", "walker"}


def test_a_group_with_a_shorter_warm_up_acts_by_its_learner_afterwards(tmp_path: Path, specs) -> None:
    warm_up = warm_up_of(
        tmp_path,
        specs,
        rover={"warm_up": "random", "learning_starts": 100},
        walker={"warm_up": "random", "learning_starts": 40},
    )
    stages = []
    for frames in (0, 40, 100):
        assert warm_up.begin_phase(frames).keys() == {"rover", "walker"} - warm_up.learners_policies().keys()
        stages.append((warm_up.stage, sorted(warm_up.learners_policies()), warm_up.describe(frames)))
        assert not warm_up.is_over(frames)
    assert stages == [(1, [], "random"), (2, ["walker"], "random"), (0, ["rover", "walker"], None)]


def test_random_actions_fill_the_bounds(specs) -> None:
    env, spec = make_two_groups(8, 0), specs["walker"]
    torch.manual_seed(0)
    policy, observation = UniformRandom("walker", spec), env.reset()
    actions = torch.stack([policy(observation)["walker", "action"].clone() for _ in range(200)]).flatten(
        0, -2
    )
    low, high = torch.tensor(spec.low), torch.tensor(spec.high)
    assert (actions >= low).all() and (actions <= high).all()
    assert (actions.mean(0) - spec.middle).abs().max() < 0.1 * spec.half_range.max()
    assert (actions.min(0).values < low + 0.05 * (high - low)).all()


@pytest.mark.slow
@pytest.mark.parametrize("half", [384, 512], ids=["within a warm-up", "between warm-up and learning"])
def test_halves_of_a_run_with_warm_ups_of_several_lengths_make_a_whole(half: int, tmp_path: Path) -> None:
    learning = small(
        hidden=(8,),
        learning_starts=512,
        warm_up="go_to_goal",
        groups={"walker": {"learning_starts": 256, "warm_up": "random"}},
    )
    assert_halves_make_a_whole(make_two_groups, tmp_path, learning, frames=1024, half=half)
