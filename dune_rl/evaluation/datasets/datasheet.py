"""The datasheet of a dataset: a short Markdown text on its origin, extent, columns and limits."""

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np

from dune_rl.config.commands import EvaluateConf
from dune_rl.evaluation.columns import describe_columns
from dune_rl.evaluation.datasets.transitions import info_columns
from dune_rl.sensors.conf import describe_reading

Row = Mapping[str, Any]


def write_datasheet(
    conf: EvaluateConf,
    origin: Mapping[str, Any],
    rows: Sequence[Row],
    observation: gymnasium.spaces.Dict,
    action: gymnasium.spaces.Box,
    transitions: int,
) -> str:
    """The text, of the settings, the `origin` and the `rows` of the episodes, and how many `transitions`."""
    assert conf.dataset is not None
    name, policy = conf.dataset, origin["policy"]
    sensors = conf.external_groups[0].sensors or {}
    meanings = {
        key: describe_reading(sensors, key).replace("|", "\\|") or f"sensor `{key}`" for key in observation
    }
    lines = [
        f"# {name}",
        "",
        f"{len(rows)} episode{'s' * (len(rows) > 1)}, {transitions} transitions of `{policy['name']}` "
        f"in the world `{conf.world.name}`, simulated by dune_rl {origin['version']}.",
        "",
        "## Origin",
        "",
        f"- Policy: `{policy['name']}` ({policy['kind']}){_weights(policy)}.",
        f"- Episodes: {_episodes(conf, origin, rows)}",
        f"- Physics engine: {origin['engine']}; {conf.physics.decision_hz:g} actions a second.",
        f"- Software: dune_rl {origin['version']}{_commit(origin['git'])}. `metadata.json` has all settings.",
        "",
        "## Extent",
        "",
        *_extent(rows),
        "",
        "## Columns",
        "",
        "A transition is (`observations[t]`, `actions[t]`, `rewards[t]`, `observations[t + 1]`).",
        "",
        "| column | shape | type | lowest | highest | meaning |",
        "|---|---|---|---|---|---|",
        *(_box_row(f"observations/{key}", space, meanings[key]) for key, space in observation.items()),
        _box_row("actions", action, "speed [m/s] and relative heading [rad], or the robot's own commands"),
        "| rewards | () | float32 | | | reward of the step, by the task's settings |",
        "| terminations | () | bool | | | the episode ended by the task, as at a goal or a collision |",
        "| truncations | () | bool | | | the episode was cut off, as by its limit of steps |",
        "",
        "`infos` has the metrics of the episode so far, with each observation; -1: not defined yet.",
        "The metadata of an episode have its final metrics, seed, number, world seed, start and goal:",
        "",
        "| name | unit | meaning |",
        "|---|---|---|",
        *(f"| {each['column']} | {each['unit']} | {each['meaning']} |" for each in _described(rows)),
        "",
        "## Use",
        "",
        "```python",
        "import minari",
        "",
        f'dataset = minari.load_dataset("{name}")',
        "env = dataset.recover_environment()",
        "first = next(iter(dataset.storage.get_episode_metadata([0])))",
        'observation, info = env.reset(seed=first["seed"], options=first["options"])',
        "```",
        "",
        "## Licence",
        "",
        "The data are of a simulation and about no real person. dune_rl is under the MIT licence, which does "
        "not extend to the data: state a licence when you publish them. Files of worlds keep their own.",
        "",
        "## Known limits",
        "",
        "- One policy acted, without exploration: what it never meets is not in the data.",
        "- Sensors, contact with the ground and moving actors are models.",
        "- The environment needs dune_rl, and the files of its world and its set where it has some. Numbers "
        "repeat on one kind of processor; another may round differently.",
        "- Rewards and ends are of the task's settings; compare policies by the metrics.",
        *_limits_of_held_actions(conf),
        "",
    ]
    return "\n".join(lines)


def _limits_of_held_actions(conf: EvaluateConf) -> list[str]:
    if conf.physics.action_repeat == 1:
        return []
    return [
        f"- An action is held for {conf.physics.action_repeat} control steps. Where an episode ends between "
        "them, its last observation may be of moving actors a control step later."
    ]


def _weights(policy: Mapping[str, Any]) -> str:
    trained = f", {policy['trained']}" if policy["trained"] else ""
    return trained + (f", SHA-256 `{policy['sha256']}`" if policy["sha256"] else "")


def _commit(git: Mapping[str, Any] | None) -> str:
    if git is None:
        return ""
    return f", commit `{git['commit']}`" + (" with changes" if git["changed"] else "")


def _episodes(conf: EvaluateConf, origin: Mapping[str, Any], rows: Sequence[Row]) -> str:
    sites = {row["world_seed"] for row in rows if "world_seed" in row}
    where = f"on {len(sites)} sites (`world_seed`)" if len(sites) > 1 else "on one site"
    used = origin["episode_set"]
    if used is None:
        return f"sampled, numbers 0 to {len(rows) - 1} of seed {conf.seed}, {where}."
    return f"the first {len(rows)} of the set `{used['name']}`, SHA-256 `{used['sha256']}`, {where}."


def _extent(rows: Sequence[Row]) -> list[str]:
    """Shares and means of what the episodes came to, as far as they are measured."""
    steps = np.array([row["steps"] for row in rows])
    found = [
        f"- Control steps of an episode: {steps.min():.0f} to {steps.max():.0f}, {steps.mean():.1f} mean."
    ]
    for key, words in (("success", "Successful episodes"), ("collisions", "Episodes with a collision")):
        if all(key in row for row in rows):
            found.append(f"- {words}: {sum(row[key] > 0 for row in rows)} of {len(rows)}.")
    returns = np.array([row["return"] for row in rows])
    return [*found, f"- Return: {returns.mean():.4g} mean, {returns.min():.4g} to {returns.max():.4g}."]


def _box_row(name: str, space: Any, meaning: str) -> str:
    low, high = f"{space.low.min():.4g}", f"{space.high.max():.4g}"
    return f"| {name} | {space.shape} | {space.dtype} | {low} | {high} | {meaning} |"


def _described(rows: Sequence[Row]) -> list[dict[str, str]]:
    """Names, units and meanings of the entries of an episode's metadata; `infos` has those of its metrics."""
    names = list(rows[0])
    recorded = info_columns(tuple(names))
    return [each for each in describe_columns(names) if each["meaning"] or each["column"] in recorded]
