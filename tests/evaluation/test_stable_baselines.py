"""Files of Stable-Baselines3 act as the library does, and nothing in them is run."""

import base64
import io
import json
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces

import dune_rl
from dune_rl.commands import evaluate
from dune_rl.core.errors import ConfigError
from dune_rl.evaluation.stable_baselines import read_stable_baselines
from dune_rl.learning.policy_spec import PolicySpec

sb3 = pytest.importorskip("stable_baselines3")

Call = Callable[..., int]
WORDS = ("+world=flat", "actors=none", "episodes=2", "scenes=2", "task.terminations.time_limit.max_steps=6")
LOW, HIGH = np.array([-0.5, -3.0], np.float32), np.array([1.0, 3.0], np.float32)
FLAT = spaces.Box(-1.0, 1.0, (7,))
PARTS = spaces.Dict(
    {
        "goal": spaces.Box(-1.0, 1.0, (2,)),
        "camera": spaces.Box(0, 255, (40, 36, 3), np.uint8),
        "depth": spaces.Box(0.0, 1.0, (2, 3, 1)),
    }
)


# Without normalisation, the library takes all arrays of three axes for images.
IMAGE = spaces.Dict({key: PARTS[key] for key in ("goal", "camera")})


class Still(gymnasium.Env[Any, Any]):
    """An environment of these observations in which nothing happens."""

    def __init__(self, observation_space: spaces.Space[Any]) -> None:
        self.observation_space = observation_space
        self.action_space = spaces.Box(LOW, HIGH)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        return self.observation_space.sample(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        return self.observation_space.sample(), 0.0, False, False, {}


def make_model(algorithm: str, space: spaces.Space[Any], **kwargs: Any) -> Any:
    name = "MlpPolicy" if space is FLAT else "MultiInputPolicy"
    more = {"buffer_size": 1} if algorithm in ("SAC", "TD3", "DDPG") else {}
    return getattr(sb3, algorithm)(name, Still(space), device="cpu", seed=3, **more, **kwargs)


def rewrite(file: Path, change: Callable[[dict[str, Any]], None]) -> None:
    """Change the JSON of a file."""
    with zipfile.ZipFile(file) as archive:
        content = {name: archive.read(name) for name in archive.namelist()}
    data = json.loads(content["data"])
    change(data)
    content["data"] = json.dumps(data).encode()
    with zipfile.ZipFile(file, "w") as archive:
        for name, value in content.items():
            archive.writestr(name, value)


@pytest.mark.parametrize(
    ("algorithm", "space", "kwargs"),
    [
        ("SAC", FLAT, {}),
        ("SAC", PARTS, {"policy_kwargs": {"net_arch": [16]}}),
        ("SAC", FLAT, {"use_sde": True}),
        ("SAC", FLAT, {"policy_kwargs": {"net_arch": []}}),
        ("TD3", FLAT, {"policy_kwargs": {"net_arch": [8, 9, 10], "activation_fn": "Tanh"}}),
        ("DDPG", FLAT, {"policy_kwargs": {"net_arch": []}}),
        ("PPO", FLAT, {"policy_kwargs": {"net_arch": {"pi": [5], "vf": [6]}, "activation_fn": "ELU"}}),
        ("PPO", FLAT, {"use_sde": True}),
        ("PPO", PARTS, {"policy_kwargs": {"share_features_extractor": False}}),
        ("PPO", IMAGE, {"policy_kwargs": {"normalize_images": False, "net_arch": []}}),
        ("A2C", PARTS, {}),
    ],
)
def test_actions_are_those_of_the_library(
    algorithm: str, space: spaces.Space[Any], kwargs: dict[str, Any], tmp_path: Path
) -> None:
    from torch import nn

    settings = dict(kwargs.get("policy_kwargs", {}))
    if "activation_fn" in settings:
        settings["activation_fn"] = getattr(nn, settings["activation_fn"])
        kwargs = {**kwargs, "policy_kwargs": settings}
    model = make_model(algorithm, space, **kwargs)
    model.save(tmp_path / "model.zip")
    policy = read_stable_baselines(tmp_path / "model.zip")
    space.seed(5)
    observations = [space.sample() for _ in range(20)]
    if isinstance(space, spaces.Dict):
        readings = {key: np.stack([one[key] for one in observations]) for key in space.spaces}
        given: Any = {**readings, "camera": readings["camera"].transpose(0, 3, 1, 2)}
    else:
        given = np.stack(observations)
        # The readings of two sensors, side by side by their names.
        readings = {"imu": given[:, 3:], "goal": given[:, :3]}
    expected, _ = model.policy.predict(given, deterministic=True)
    found = np.clip(policy(readings), LOW, HIGH)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5)
    assert np.ptp(found, axis=0).min() > 1e-4
    policy.require(PolicySpec({}, tuple(LOW.tolist()), tuple(HIGH.tolist())))


def test_an_evaluation_drives_by_a_file(call: Call, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    env = dune_rl.gym_env("flat", 0, flatten=True, overrides=["actors=none"])
    model = sb3.SAC("MlpPolicy", env, device="cpu", seed=1, buffer_size=1, policy_kwargs={"net_arch": [4]})
    observation, _ = env.reset(seed=4)
    model.save(folder / "mine.zip")
    env.close()
    assert call(evaluate.main, "policy=mine.zip", *WORDS, "steps=true", "out=results") == 0
    assert "mine" in (folder / "results" / "episodes.csv").read_text()
    assert call(evaluate.main, "verify=results") == 0
    capsys.readouterr()
    policy = read_stable_baselines(folder / "mine.zip")
    found = policy({"all": observation[None]})
    np.testing.assert_allclose(found[0], model.predict(observation, deterministic=True)[0], atol=1e-5)
    for words, message in (
        (
            ("policy=mine.zip", "sensors.enabled=[goal,imu]"),
            "was trained on 77 values, and goal, imu have",
        ),
        (("policy=mine.zip", "robot=leo_rover"), "was trained with actions in [-1, 1], [-3.14159, 3.14159]"),
        (("checkpoint=mine.zip",), "mine.zip is a file of another library; write policy=mine.zip"),
    ):
        assert call(evaluate.main, *words, *WORDS, "out=other") == 2
        error = capsys.readouterr().err
        assert message in error and "Traceback" not in error


class Trap:
    """What a pickle can do when it is loaded."""

    def __reduce__(self) -> tuple[Any, ...]:
        return exec, ("raise SystemError('code of a file was run')",)


def test_pickles_are_left_alone(tmp_path: Path) -> None:
    file = tmp_path / "model.zip"
    make_model("PPO", FLAT).save(file)
    trap = base64.b64encode(pickle.dumps(Trap())).decode()

    def set_traps(data: dict[str, Any]) -> None:
        data["extra"] = {":type:": "x", ":serialized:": trap}
        for value in data.values():
            if isinstance(value, dict) and ":serialized:" in value:
                value[":serialized:"] = trap

    rewrite(file, set_traps)
    with pytest.raises(SystemError, match="code of a file was run"):
        sb3.PPO.load(file)
    assert read_stable_baselines(file)({"all": np.zeros((1, 7), np.float32)}).shape == (1, 2)
    with zipfile.ZipFile(file, "a") as archive, pytest.warns(UserWarning, match="Duplicate name"):
        archive.writestr("policy.pth", pickle.dumps(Trap()))
    with pytest.raises(ConfigError, match="is damaged, or was not written by Stable-Baselines3"):
        read_stable_baselines(file)


def test_what_cannot_be_told_is_refused(tmp_path: Path) -> None:
    from torch import nn

    file = tmp_path / "model.zip"

    def refuses(message: str, change: Callable[[dict[str, Any]], None] = lambda data: None) -> None:
        rewrite(file, change)
        with pytest.raises(ConfigError, match=message) as caught:
            read_stable_baselines(file)
        assert str(caught.value).count("\n") <= 1

    with pytest.raises(ConfigError, match=r"cannot be read: No such file"):
        read_stable_baselines(file)
    file.write_bytes(b"PK")
    with pytest.raises(ConfigError, match="is damaged, or was not written by"):
        read_stable_baselines(file)
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("data", "{}")
    with pytest.raises(ConfigError, match="is damaged, or was not written by"):
        read_stable_baselines(file)

    def own_class(data: dict[str, Any]) -> None:
        data["policy_class"]["__module__"] = "my.policies"

    model = make_model("PPO", FLAT)
    model.save(file)
    refuses(r"has a policy class of its own \(my.policies\)", own_class)
    model.save(file)
    refuses("has no bounds of continuous actions", lambda data: data["action_space"].pop("low"))
    model.save(file)
    refuses(
        "has the activation <class 'my.Sine'>",
        lambda data: data.update(policy_kwargs={"activation_fn": "<class 'my.Sine'>"}),
    )
    squashing = {"squash_output": True}
    make_model("PPO", FLAT, use_sde=True, policy_kwargs=squashing).save(file)
    refuses("has squash_output=True, which is not read")
    changed = make_model("PPO", FLAT)
    changed.policy.action_net = nn.Sequential(changed.policy.action_net, nn.LayerNorm(2))
    changed.save(file)
    refuses(r"has a network that is not read \(action_net\.0\.bias\)")
    sb3.DQN("MlpPolicy", "CartPole-v1", device="cpu", buffer_size=1).save(file)
    refuses("has no bounds of continuous actions|has a network that is not read")


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        ("actor.mu.bias", (3,)),
        ("actor.mu.weight", (2, 9)),
        ("actor.latent_pi.0.weight", (9, 7)),
    ],
)
def test_weights_that_do_not_fit_each_other_are_refused(
    name: str, shape: tuple[int, ...], tmp_path: Path
) -> None:
    file = tmp_path / "model.zip"
    make_model("SAC", FLAT, policy_kwargs={"net_arch": [8]}).save(file)
    with zipfile.ZipFile(file) as archive:
        content = {each: archive.read(each) for each in archive.namelist()}
    weights = torch.load(io.BytesIO(content["policy.pth"]), weights_only=True)
    assert name in weights
    changed = io.BytesIO()
    torch.save({**weights, name: torch.zeros(*shape)}, changed)
    content["policy.pth"] = changed.getvalue()
    with zipfile.ZipFile(file, "w") as archive:
        for each, value in content.items():
            archive.writestr(each, value)
    with pytest.raises(ConfigError, match="do not fit each other"):
        read_stable_baselines(file)


def test_as_many_bounds_as_actions_are_required(tmp_path: Path) -> None:
    file = tmp_path / "model.zip"
    make_model("PPO", FLAT).save(file)
    rewrite(file, lambda data: data["action_space"].update(low="[-1. -1. -1.]", high="[1. 1. 1.]"))
    with pytest.raises(ConfigError, match="do not fit each other"):
        read_stable_baselines(file)
