"""What `python -m dune_rl.evaluate` does: run the episodes, show the table and write the CSV."""

import os
from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from dune_rl import command
from dune_rl.config.compose import compose_evaluation
from dune_rl.config.schema import EvaluateConf
from dune_rl.errors import ConfigError
from dune_rl.learning.run.progress import show_episodes

if TYPE_CHECKING:
    from dune_rl.env.torchrl import DuneEnv
    from dune_rl.learning.group_policy import Policy
    from dune_rl.learning.measures import MetricsRow


def run(parsed: Namespace) -> None:
    """Evaluate as the command line says."""
    conf = command.compose_with_checkpoint(parsed, compose_evaluation)
    if conf is not None:
        _evaluate(conf)


def _evaluate(conf: EvaluateConf) -> None:
    # Only now, since loading PyTorch and the physics engine takes seconds.
    from dune_rl.config.build import make_learning_env
    from dune_rl.learning.evaluation import evaluate
    from dune_rl.learning.measures import write_csv

    out = Path(conf.out) if conf.out else _default_out(conf)
    _check_writable(out)
    console = command.make_console()
    env = make_learning_env(conf, min(conf.scenes, conf.episodes), conf.seed)
    command.print_world_notes(console, conf)
    agents: dict[str, list[str]] = env.group_map
    results: dict[str, dict[str, list[MetricsRow]]] = {}
    for name, policy in _policies(conf, env).items():
        with show_episodes(console, name, conf.episodes) as show:
            results[name] = evaluate(policy, env, conf.episodes, conf.seed, progress=show)
    env.close()
    # Groups without metrics have no rows.
    for group in next(iter(results.values())):
        title = f"{conf.world.name}, {group}" if len(agents) > 1 else conf.world.name
        _show(console, conf, title, {name: rows[group] for name, rows in results.items()}, len(agents[group]))
    records = [
        _record(name, conf, agents[group], row)
        for name, by_group in results.items()
        for group, rows in by_group.items()
        for row in rows
    ]
    write_csv(out, [dict.fromkeys(key for each in records for key in each) | record for record in records])
    console.print(f"Episodes: {out}", highlight=False, soft_wrap=True)


def _show(
    console: Console, conf: EvaluateConf, title: str, results: dict[str, list["MetricsRow"]], num_agents: int
) -> None:
    """Print the table of one group, and the paired test where two policies are compared."""
    from dune_rl.learning.measures import estimate_metrics
    from dune_rl.learning.table import paired_line, results_table

    title = f"{title}: {conf.episodes} episodes of seed {conf.seed}"
    estimates = {name: estimate_metrics(rows) for name, rows in results.items()}
    console.print(results_table(estimates, title, num_agents=num_agents))
    if len(results) == 2 and all("success" in rows[0] for rows in results.values()):
        console.print(paired_line(*results.items()))


def _policies(conf: EvaluateConf, env: "DuneEnv") -> dict[str, "Policy"]:
    from dune_rl.learning.policies import built_in_policy
    from dune_rl.learning.saved_policies import load_policy

    policies: dict[str, Policy] = {}
    if conf.checkpoint is not None:
        path = Path(conf.checkpoint)
        name = path.name if path.is_dir() else path.parent.name or path.stem
        policies[name] = load_policy(path, env)[0]
    for built_in in (conf.policy, conf.against):
        if built_in is not None:
            policies[built_in] = built_in_policy(built_in, env, conf.seed)
    return policies


def _record(policy: str, conf: EvaluateConf, agents: list[str], row: "MetricsRow") -> dict[str, object]:
    metrics = {key: int(value) if float(value).is_integer() else value for key, value in row.items()}
    agent = agents[int(metrics.pop("agent"))]
    return {"policy": policy, "world": conf.world.name, "seed": conf.seed, "agent": agent, **metrics}


def _default_out(conf: EvaluateConf) -> Path:
    # Beside the file of the other engine, not in its place.
    engine = "" if conf.physics.backend == "bullet" else f"_{conf.physics.backend}"
    stem = f"{conf.world.name}{engine}_seed{conf.seed}.csv"
    if conf.checkpoint is None:
        return Path(f"episodes_{conf.policy}_{stem}")
    path = Path(conf.checkpoint)
    return (path if path.is_dir() else path.parent) / f"episodes_{stem}"


def _check_writable(out: Path) -> None:
    # Before the episodes are run, not after.
    out.parent.mkdir(parents=True, exist_ok=True)
    if out.is_dir() or not os.access(out.parent, os.W_OK):
        raise ConfigError(f"out={out} cannot be written; choose another file")
