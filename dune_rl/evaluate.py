"""Measure a policy on numbered episodes: `python -m dune_rl.evaluate checkpoint=runs/NAME episodes=100`."""

import os
from argparse import Namespace
from functools import partial
from pathlib import Path

from rich.progress import Progress, TaskID

from dune_rl import command
from dune_rl.command import Page
from dune_rl.config.compose import compose_evaluation
from dune_rl.config.schema import EvaluateConf
from dune_rl.errors import ConfigError
from dune_rl.learning.evaluation import Row, evaluate, summary, write_csv
from dune_rl.learning.layout import Layout
from dune_rl.learning.policies import GoToGoal, Policy, UniformRandom, load_policy
from dune_rl.learning.table import paired_line, results_table

USAGE = (
    ("python -m dune_rl.evaluate checkpoint=runs/NAME", "a trained policy"),
    ("python -m dune_rl.evaluate policy=random +world=flat", "a built-in one"),
    ("python -m dune_rl.evaluate checkpoint=RUN against=random", "two, in pairs"),
)
CLOSING = (
    "A checkpoint brings the settings of its run; what you write changes them. Equal\n"
    "seeds and settings give every policy the same episodes, so that results pair."
)
SETTINGS = (
    ("checkpoint=PATH", "a run's folder, or a file of weights"),
    ("policy=NAME", "go_to_goal or random, instead of a checkpoint"),
    ("against=NAME", "a built-in policy to compare with, in pairs"),
    ("episodes=N", "how many to run"),
    ("seed=N", "of the episodes"),
    ("scenes=N", "episodes side by side; no result depends on it"),
    ("out=FILE", "CSV with a row for each episode"),
)


def main() -> None:
    """Run the command line; ends the process."""
    command.run(Page("Measure a policy on numbered episodes.", USAGE, SETTINGS, CLOSING), _main)


def _main(parsed: Namespace) -> None:
    conf = command.settings_around_checkpoint(parsed, compose_evaluation)
    if conf is not None:
        _evaluate(conf)


def _evaluate(conf: EvaluateConf) -> None:
    # Only now, since loading the physics engine takes a second and prints a line.
    from dune_rl.config.build import make_torchrl_env

    out = Path(conf.out) if conf.out else _default_out(conf)
    _check_writable(out)
    console = command.console()
    env = make_torchrl_env(conf, min(conf.scenes, conf.episodes), conf.seed)
    layout = Layout.of(env)
    policies = dict([_policy(conf, layout)])
    if conf.against is not None:
        policies[conf.against] = _built_in(conf.against, layout, conf.seed)
    results: dict[str, list[Row]] = {}
    with Progress(console=console, disable=not console.is_terminal, transient=True) as bar:
        for name, policy in policies.items():
            task = bar.add_task(name, total=conf.episodes)
            # The task is bound now: the next round has another.
            advance = partial(_advance, bar, task)
            results[name] = evaluate(policy, env, conf.episodes, conf.seed, progress=advance)
    env.close()
    title = f"{conf.world.name}: {conf.episodes} episodes of seed {conf.seed}"
    console.print(results_table({name: summary(rows) for name, rows in results.items()}, title))
    if len(results) == 2:
        console.print(paired_line(*results.items()))
    write_csv(out, [_record(name, conf, row) for name, rows in results.items() for row in rows])
    console.print(f"Episodes: {out}", highlight=False, soft_wrap=True)


def _advance(bar: Progress, task: TaskID, done: int) -> None:
    bar.update(task, completed=done)


def _policy(conf: EvaluateConf, layout: Layout) -> tuple[str, Policy]:
    if conf.checkpoint is not None:
        path = Path(conf.checkpoint)
        name = path.name if path.is_dir() else path.parent.name or path.stem
        return name, load_policy(path, layout)[0]
    assert conf.policy is not None
    return conf.policy, _built_in(conf.policy, layout, conf.seed)


def _built_in(name: str, layout: Layout, seed: int) -> Policy:
    return UniformRandom(layout, seed) if name == "random" else GoToGoal(layout)


def _record(name: str, conf: EvaluateConf, row: Row) -> dict[str, object]:
    return {
        "policy": name,
        "world": conf.world.name,
        "seed": conf.seed,
        **{key: int(value) if float(value).is_integer() else value for key, value in row.items()},
    }


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


if __name__ == "__main__":
    main()
