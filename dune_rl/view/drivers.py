"""Who drives what is looked at, and how an episode ended."""

from collections.abc import Callable, Mapping
from pathlib import Path

from torchrl.envs import EnvBase

from dune_rl.config.schema import ViewConf
from dune_rl.learning.group_policy import Policy
from dune_rl.learning.policies import built_in_policy
from dune_rl.learning.saved_policies import load_policy

_ENDINGS = {
    "success": "goal reached",
    "reached": "goal reached, after a collision",
    "stuck": "stuck",
    "flipped": "turned over",
    "out_of_world": "left the world",
    "diverged": "physics diverged",
}


def driver(conf: ViewConf, env: EnvBase) -> Callable[[], Policy]:
    """Makes the policy that `conf` asks for, anew for each drive, so that none depends on those before it."""
    if conf.checkpoint is not None:
        trained = load_policy(Path(conf.checkpoint), env, allow_more=True)[0]
        return lambda: trained
    return lambda: built_in_policy(conf.policy or "go_to_goal", env, conf.seed)


def ending(metrics: Mapping[str, float]) -> str:
    """In words, how an episode of these final metrics ended."""
    return next((text for name, text in _ENDINGS.items() if metrics[name] > 0), "out of time")
