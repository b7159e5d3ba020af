"""Golden rollouts: digests of all that fixed episodes give, to compare two versions of the code on one
machine.

`python tests/helpers/golden_rollouts.py OUT.csv` writes a row for each case. It runs on the code before
agent groups too (with `PYTHONPATH` on that checkout): agents are taken in their order, whatever they are
called, and the parts of an observation that were renamed keep their former names. The metrics that changed
their definition are left out.
"""

import csv
import hashlib
import sys
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch

import dune_rl

_FORMER_NAMES = {"nearest_agent": "rover"}
# Since agent groups they use the true acceleration of the robot's origin, and endings are rewards by name.
_REDEFINED = ("smoothness", "vertical_roughness", "reward/ending", "reward/stuck", "reward/flipped")
_REDEFINED += ("reward/out_of_world",)
_ENGINES = ("bullet", "dart")


class _Digest:
    def __init__(self) -> None:
        self._hash = hashlib.sha256()

    def add(self, values: Any) -> None:
        if isinstance(values, Mapping):
            named = {_FORMER_NAMES.get(key, key): value for key, value in values.items()}
            for key in sorted(set(named) - set(_REDEFINED)):
                self._hash.update(key.encode())
                self.add(named[key])
        else:
            array = np.asarray(values)
            self._hash.update(f"{array.dtype} {array.shape}".encode() + array.tobytes())

    @property
    def text(self) -> str:
        return self._hash.hexdigest()[:16]


def parallel_digest(steps: int, limit: int | None = None, **settings: Any) -> str:
    """The digest of `steps` steps of the PettingZoo environment, episodes cut off after `limit` steps."""
    env = dune_rl.parallel_env(seed=3, **_limited(settings, limit))
    draws, digest, names = np.random.default_rng(0), _Digest(), list(env.possible_agents)
    given = env.reset()
    for _ in range(steps):
        for part in given:
            for name in names:
                digest.add(part.get(name, {}))
        if not env.agents:
            given = env.reset()
            continue
        given = env.step({name: _action(env.action_space(name), draws) for name in names})
    env.close()
    return digest.text


def _action(space: Any, draws: np.random.Generator) -> np.ndarray:
    """Mostly forward, where an action is a speed and a heading; near rest, where it is joints' angles."""
    action = draws.uniform(space.low, space.high).astype(np.float32)
    if len(action) != 2:
        return 0.05 * action
    action[0], action[1] = abs(action[0]) * 0.9 + 0.1 * space.high[0], 0.2 * action[1]
    return np.clip(action, space.low, space.high)


def torchrl_digest(steps: int, limit: int, **settings: Any) -> str:
    """The digest of `steps` steps of four scenes of the TorchRL environment with one agent each."""
    env = dune_rl.make(num_scenes=4, seed=5, **_limited(settings, limit))
    draws, digest = np.random.default_rng(1), _Digest()
    key = next(iter(env.full_action_spec.keys(True, True)))
    data = env.reset()
    for _ in range(steps):
        share = draws.uniform(size=(4, 2)).astype(np.float32)
        action = np.stack([share[:, 0], (share[:, 1] - 0.5) * 1.2], 1)
        data[key] = torch.from_numpy(action.astype(np.float32)).reshape(env.full_action_spec[key].shape)
        step, data = env.step_and_maybe_reset(data)
        for part in (step["next"], data):
            digest.add({name: _leaf(part, name) for name in _leaves(part)})
    env.close()
    return digest.text


def _leaves(data: Any) -> dict[str, Any]:
    """The keys of the arrays of a step by their last part; those of a group stand for the root's."""
    found: dict[str, Any] = {}
    for key in data.keys(True, True):
        name = key if isinstance(key, str) else key[-1]
        if name not in ("action", "_reset", "metrics") and (name not in found or isinstance(key, tuple)):
            found[name] = key
    return found


def _leaf(data: Any, name: str) -> np.ndarray:
    key = _leaves(data)[name]
    values: np.ndarray = data[key].numpy()
    return values[:, 0] if isinstance(key, tuple) else values


def _limited(settings: dict[str, Any], limit: int | None) -> dict[str, Any]:
    if limit is None:
        return settings
    try:
        import dune_rl.state  # noqa: F401
    except ModuleNotFoundError:
        word = f"task.terminations.time_limit.max_steps={limit}"
    else:
        word = f"task.terminations.time_limit.max_steps={limit}"
    return {**settings, "overrides": [*settings.get("overrides", ()), word]}


def cases() -> dict[str, Callable[[], str]]:
    """Every case by its name."""
    found: dict[str, Callable[[], str]] = {}

    def add(name: str, digest: Callable[..., str], *args: Any, **settings: Any) -> None:
        for engine in _ENGINES:
            words = [f"physics={engine}", *settings.get("overrides", ())]
            found[f"{engine} {name}"] = lambda words=words: digest(*args, **{**settings, "overrides": words})

    add("rover_zero, walkers", parallel_digest, 150, 60, world="inspection", actors="walkers")
    add(
        "rover_zero, external walkers",
        parallel_digest,
        150,
        60,
        world="inspection",
        actors="external_walkers",
    )
    add("leo_rover", parallel_digest, 80, world="rubicon", overrides=["robot=leo_rover"], actors="walkers")
    add("hyperdog", parallel_digest, 80, world="inspection", overrides=["robot=hyperdog"], actors="walkers")
    add(
        "rover_zero and hyperdog",
        parallel_digest,
        80,
        world="inspection",
        robots=["rover_zero", "hyperdog"],
        actors="external_walkers",
    )
    add("four scenes", torchrl_digest, 120, 50, world="inspection", actors="walkers")
    drawn = ["randomisation=everything", "world.surfaces=natural", "world.grass_cover=0.3"]
    add(
        "four scenes, all randomised",
        torchrl_digest,
        120,
        30,
        world="inspection",
        overrides=drawn,
        actors="walkers",
    )
    return found


def main() -> None:
    """Write the digest of every case to the CSV file named on the command line."""
    torch.set_num_threads(1)
    with open(sys.argv[1], "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["case", "digest"])
        for name, digest in cases().items():
            writer.writerow([name, digest()])
            file.flush()


if __name__ == "__main__":
    main()
