"""The success rate that the study of inspection publishes is still that of the policy in the tree (slow)."""

import csv
from functools import partial
from pathlib import Path

import pytest
from scipy.stats import fisher_exact

from dune_rl.config.build import make_learning_env
from dune_rl.config.commands import EvaluateConf
from dune_rl.config.compose import compose
from dune_rl.learning.checkpoint import read_checkpoint_file
from dune_rl.learning.evaluation import evaluate
from dune_rl.learning.policies import built_in_policy
from dune_rl.learning.saved_policies import load_policy

STUDY = Path(__file__).parents[2] / "experiments" / "inspection"
# How rarely the test fails though nothing has changed: other processors round otherwise, so that an episode
# here and there ends in another way, and at worst all episodes are new ones of the same kind.
FALSE_ALARMS = 0.001
EPISODES = 100

Count = tuple[int, int]


def is_consistent(measured: Count, published: Count) -> bool:
    """Whether (successes, episodes) may be of one rate: Fisher's exact test, two-sided."""
    table = [[successes, episodes - successes] for successes, episodes in (measured, published)]
    return bool(fisher_exact(table).pvalue >= FALSE_ALARMS)


def published(policy: str) -> Count:
    """Successes and episodes of a policy of the study."""
    with (STUDY / "evaluation" / "episodes.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["policy"] == policy]
    return sum(float(row["success"]) == 1.0 for row in rows), len(rows)


@pytest.mark.parametrize(
    ("successes", "expected"),
    [(0, False), (55, False), (72, False), (89, True), (80, True), (96, True), (100, False)],
)
def test_which_rates_are_consistent(successes: int, expected: bool) -> None:
    """The published 177 of 200: a rate of 72 % is refused, and so is one that is too good to be true."""
    assert published("inspection") == (177, 200)
    assert is_consistent((successes, EPISODES), published("inspection")) == expected


@pytest.mark.slow
@pytest.mark.parametrize("name", ["inspection", "go_to_goal"])
def test_the_published_rates_hold(name: str) -> None:
    """On the first episodes of the study's seed; a policy that is worse, `go_to_goal`, is told apart."""
    file = STUDY / "policy.pt"
    conf = compose(EvaluateConf, [f"checkpoint={file}"], [], read_checkpoint_file(file, "policy")["config"])
    env = make_learning_env(conf, 16, seed=21)
    policies = {
        "inspection": lambda: load_policy(file, env)[0],
        "go_to_goal": partial(built_in_policy, name, env),
    }
    rows = evaluate(policies[name](), env, EPISODES, seed=21)["rover"]
    env.close()
    measured = round(sum(row["success"] for row in rows)), EPISODES
    assert is_consistent(measured, published(name)), f"{measured} of {published(name)}"
    other = "go_to_goal" if name == "inspection" else "inspection"
    assert not is_consistent(measured, published(other))
