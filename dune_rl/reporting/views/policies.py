"""The policy that acts for the external agents of a view."""

from collections.abc import Callable
from pathlib import Path

from torchrl.envs import EnvBase

from dune_rl.config.commands import ViewConf
from dune_rl.learning.group_policy import Policy
from dune_rl.learning.policies import built_in_policy
from dune_rl.learning.saved_policies import load_policy

# What built-in policies read, where it is not `goal` alone.
SENSORS_OF_POLICIES = {"mppi": ("lidar", "goal", "velocity"), "planner": ()}


def policy_factory(conf: ViewConf, env: EnvBase) -> Callable[[], Policy]:
    """Makes the policy of `conf` for all external groups of `env`: a new one for each episode.

    A random policy thus does not depend on the episodes before.
    """
    if conf.checkpoint is not None:
        trained, _ = load_policy(Path(conf.checkpoint), env, allow_more=True)
        return lambda: trained
    return lambda: built_in_policy(conf.policy or "go_to_goal", env, conf.seed)
