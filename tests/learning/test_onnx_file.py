"""Trained policies as ONNX files, run by ONNX's own runtime."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from documents import DOCS, code_blocks
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from dune_rl import evaluate, export
from dune_rl.commands.export import policy as policy_export
from dune_rl.config.build import make_learning_env
from dune_rl.config.commands import EvaluateConf
from dune_rl.config.compose import compose
from dune_rl.core.files import read_csv
from dune_rl.evaluation.policies import PolicySource
from dune_rl.learning.evaluation import evaluate as run_episodes
from dune_rl.learning.group_policy import Deterministic, GroupPolicy
from dune_rl.learning.networks.policy import BEGINS, MEMORY, Architecture, make_policy_network
from dune_rl.learning.onnx_file import METADATA, onnx_model, sample_inputs
from dune_rl.learning.onnx_policy import OnnxPolicy
from dune_rl.learning.policy_spec import PartSpec, PolicySpec

Call = Callable[..., int]
EXPERIMENTS = Path(__file__).parents[2] / "experiments"
DEPLOY = DOCS / "how_to" / "deploy.md"
FLAT = EXPERIMENTS / "flat" / "seed1" / "policy.pt"


def session_of(file: Path):
    onnxruntime = pytest.importorskip("onnxruntime")
    return onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"])


@pytest.mark.slow
@pytest.mark.parametrize(
    "checkpoint",
    [
        FLAT,
        *(EXPERIMENTS / "policies" / name / "policy.pt" for name in ("all_worlds_1", "reinforcement")),
    ],
    ids=lambda file: file.parent.name,
)
def test_a_published_policy_acts_equally(checkpoint: Path, folder: Path, call: Call, capsys) -> None:
    pytest.importorskip("onnxscript")
    # It compares 10,000 observations itself, and fails where they differ.
    assert call(export.main, f"checkpoint={checkpoint}", "out=policy.onnx") == 0
    assert "over 10,000 observations" in capsys.readouterr().out
    session = session_of(folder / "policy.onnx")
    described = json.loads(session.get_modelmeta().custom_metadata_map[METADATA])
    assert [each["name"] for each in described["action"]] == ["speed_mps", "relative_heading_rad"]
    assert described["decision_s"] == (0.2 if "policies" in str(checkpoint) else 0.05)
    assert all(part["meaning"] for part in described["observation"].values())
    assert "[m]" in described["observation"]["lidar"]["meaning"]
    assert {each.name: each.shape[1:] for each in session.get_inputs()} == {
        key: part["shape"] for key, part in described["observation"].items()
    }


@pytest.mark.slow
@pytest.mark.parametrize("weight", [0.5, float("nan")])
def test_a_model_that_acts_otherwise_is_not_written(
    weight: float, folder: Path, call: Call, capsys, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("onnxscript")
    pytest.importorskip("onnxruntime")

    def other_network(*args: Any) -> Any:
        acting, model = onnx_model(*args)
        with torch.no_grad():
            for each in acting.parameters():
                each.fill_(weight)
        return acting, model

    monkeypatch.setattr(policy_export, "onnx_model", other_network)
    (folder / "policy.onnx").write_text("good")
    assert call(export.main, f"checkpoint={FLAT}", "out=policy.onnx", "overwrite=true") == 2
    assert "in ONNX the policy acts otherwise (by up to" in capsys.readouterr().err
    assert (folder / "policy.onnx").read_text() == "good"


@pytest.mark.slow
def test_a_model_that_onnxruntime_refuses_is_not_written(
    folder: Path, call: Call, capsys, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("onnxscript")
    pytest.importorskip("onnxruntime")
    monkeypatch.setattr(policy_export, "onnx_model", lambda *args: (onnx_model(*args)[0], b"no model"))
    assert call(export.main, f"checkpoint={FLAT}", "out=policy.onnx") == 2
    assert "onnxruntime does not run the policy, so no file was written: " in capsys.readouterr().err
    assert not (folder / "policy.onnx").exists()


@pytest.mark.slow
def test_a_recurrent_policy_keeps_its_memory_outside(folder: Path) -> None:
    pytest.importorskip("onnxscript")
    spec = PolicySpec(
        {"goal": 2, "lidar": 16},
        (-1.0, -2.0),
        (1.0, 3.0),
        ("lidar",),
        {"camera": PartSpec((16, 16, 3), uint8=True, low=0.0, high=255.0)},
    )
    network = make_policy_network(spec, Architecture(hidden=(16,), recurrent=8))
    acting, model = onnx_model(network, spec, {})
    (folder / "policy.onnx").write_bytes(model)
    session = session_of(folder / "policy.onnx")
    assert [each.name for each in session.get_inputs()] == ["goal", "lidar", "camera", MEMORY]
    wanted_memory, memory = None, np.zeros((3, 1, 8), np.float32)
    for step in range(5):
        observed = dict(zip(acting.inputs, sample_inputs(acting, spec, 3), strict=True))
        del observed[MEMORY]
        action, memory = session.run(None, {**{k: v.numpy() for k, v in observed.items()}, MEMORY: memory})
        given = TensorDict({**observed, BEGINS: torch.full((3, 1), step == 0)}, 3)
        if wanted_memory is not None:
            given.set(MEMORY, wanted_memory)
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            result = network(given)
        wanted_memory = result.get(("next", MEMORY))
        np.testing.assert_allclose(action, result.get("action").numpy(), atol=1e-5)
        np.testing.assert_allclose(memory, wanted_memory.numpy(), atol=1e-5)


class Actions:
    """Keeps the actions of an evaluation."""

    def __init__(self) -> None:
        self.found: list[np.ndarray] = []

    def begin(self) -> None:
        pass

    def step(self, after) -> None:
        self.found.append(after["rover", "action"].numpy().copy())

    def finish(self, rows) -> None:
        pass


@pytest.mark.slow
def test_a_recurrent_file_drives_as_its_network_does(folder: Path) -> None:
    """Episodes of two scenes, which begin anew at times of their own."""
    pytest.importorskip("onnxscript")
    pytest.importorskip("onnxruntime")
    words = ["+world=flat", "actors=none", "policy=go_to_goal", "task.terminations.time_limit.max_steps=4"]
    env = make_learning_env(compose(EvaluateConf, words), 2, 0)
    spec = PolicySpec.of(env, "rover")
    network = make_policy_network(spec, Architecture(hidden=(16,), recurrent=8))
    (folder / "policy.onnx").write_bytes(onnx_model(network, spec, {})[1])
    plain = GroupPolicy("rover", spec, network)
    plain.watch(env)
    found = []
    for policy in (Deterministic(plain), PolicySource("policy", "onnx", "policy.onnx").load(env)):
        observer = Actions()
        run_episodes(policy, env, 5, 0, observer=observer)
        found.append(np.stack(observer.found))
    env.close()
    np.testing.assert_allclose(found[0], found[1], atol=1e-4)
    # The memory matters, or nothing would be shown.
    forgetful = OnnxPolicy(folder / "policy.onnx")
    rows = {key: np.ones((1, *spec.part(key).shape), np.float32) for key in spec.keys}
    first, second, again = (forgetful.act(rows, np.array([begins])) for begins in (True, False, True))
    assert np.abs(second - first).max() > 1e-4
    np.testing.assert_array_equal(first, again)


@pytest.mark.slow
def test_an_exported_policy_drives_as_its_checkpoint_does(folder: Path, call: Call) -> None:
    pytest.importorskip("onnxscript")
    assert call(export.main, f"checkpoint={FLAT}", "out=policy.onnx") == 0
    words = ("+world=flat", "actors=none", "episodes=8", "seed=4", "scenes=8")
    assert call(evaluate.main, f"checkpoint={FLAT}", *words, "out=checkpoint") == 0
    assert call(evaluate.main, "policy=policy.onnx", *words, "out=onnx") == 0
    ones, others = (read_csv(folder / name / "episodes.csv") for name in ("checkpoint", "onnx"))
    assert [row["success"] for row in ones] == [row["success"] for row in others]
    # The last digits of an action differ, and the way with them.
    times = np.array([[float(row["time_to_goal"]) for row in rows] for rows in (ones, others)])
    np.testing.assert_allclose(times[0], times[1], atol=0.3)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("out=policy.onnx",), "checkpoint"),
        ((f"checkpoint={FLAT}",), "out"),
        ((f"checkpoint={FLAT}", "out=policy.pt"), "must end in .onnx"),
        (
            (f"checkpoint={FLAT}", "out=taken.onnx"),
            "taken.onnx exists; choose another name",
        ),
        ((f"checkpoint={FLAT}", "out=link.onnx"), "link.onnx is a link that leads nowhere; choose another"),
        ((f"checkpoint={FLAT}", "out=taken.onnx/b.onnx"), "a file of that name is in the way"),
        ((f"checkpoint={FLAT}", "policy.onnx"), "cannot read 'policy.onnx'; write key=value"),
        ((f"checkpoint={FLAT}", "out=a.onnx", "episodes=3"), "episodes"),
        ((f"checkpoint={FLAT}", "out=a.onnx", "group=walker"), "no policy of 'walker'; it has rover"),
        (("checkpoint=absent", "out=a.onnx"), "There is no absent"),
    ],
)
def test_faults_are_named_and_nothing_is_written(
    words: tuple[str, ...], said: str, folder: Path, call: Call, capsys
) -> None:
    if "a.onnx" in " ".join(words):
        pytest.importorskip("onnxscript")
    (folder / "taken.onnx").write_text("mine")
    (folder / "link.onnx").symlink_to("nowhere")
    assert call(export.main, *words) == 2
    assert said in capsys.readouterr().err
    assert sorted(path.name for path in folder.iterdir()) == ["link.onnx", "taken.onnx"]
    assert (folder / "taken.onnx").read_text() == "mine" and (folder / "link.onnx").is_symlink()


@pytest.mark.slow
def test_the_page_s_program_acts(folder: Path, call: Call, capsys) -> None:
    pytest.importorskip("onnxscript")
    pytest.importorskip("onnxruntime")
    assert call(export.main, f"checkpoint={FLAT}", "out=policy.onnx") == 0
    capsys.readouterr()
    (program,) = (
        text for language, text in code_blocks(DOCS / "how_to" / "deploy.md") if language == "python"
    )
    exec(compile(program, "act.py", "exec"), {})
    assert capsys.readouterr().out.startswith("every 0.05 s: ")
