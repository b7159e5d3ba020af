"""Who drives what is looked at, and how an episode ended."""

from collections.abc import Callable, Mapping
from pathlib import Path

from dune_rl.config.schema import ViewConf
from dune_rl.learning.layout import Layout
from dune_rl.learning.policies import GoToGoal, Policy, UniformRandom, load_policy

_ENDINGS = {
    "success": "goal reached",
    "reached": "goal reached, after a collision",
    "stuck": "stuck",
    "flipped": "turned over",
    "out_of_world": "left the world",
    "diverged": "physics diverged",
}


def driver(conf: ViewConf, layout: Layout) -> Callable[[], Policy]:
    """Makes the policy that `conf` asks for, anew for each drive, so that none depends on those before it."""
    if conf.checkpoint is not None:
        trained = load_policy(Path(conf.checkpoint), layout, more=True)[0]
        return lambda: trained
    if conf.policy == "random":
        return lambda: UniformRandom(layout, conf.seed)
    return lambda: GoToGoal(layout)


def ending(metrics: Mapping[str, float]) -> str:
    """In words, how an episode of these final metrics ended."""
    return next((text for name, text in _ENDINGS.items() if metrics[name] > 0), "out of time")
