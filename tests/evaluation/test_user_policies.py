"""Policies of users: functions by import path, and ONNX files."""

import csv
import json
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import pytest

from dune_rl import evaluate
from dune_rl.config.commands import EvaluateConf
from dune_rl.config.compose import compose
from dune_rl.core.errors import ConfigError
from dune_rl.evaluation.policies import policy_sources
from dune_rl.evaluation.provenance import check_same_sources
from dune_rl.evaluation.running import EvaluationPlan

Call = Callable[..., int]
WORDS = ("+world=flat", "actors=none", "episodes=2", "task.terminations.time_limit.max_steps=15")
CODE = """
import numpy as np

def straight(observation):
    goal = observation["goal"]
    assert goal.dtype == np.float32 and goal.ndim == 2
    speed = 1.0 * np.maximum(np.cos(goal[:, 1]), 0.0)
    return np.stack([speed, goal[:, 1]], axis=1)

class Straight:
    def __call__(self, observation):
        return straight(observation)

def short(observation):
    return np.zeros((len(observation["goal"]), 1))

def undefined(observation):
    return np.full((len(observation["goal"]), 2), np.nan)

def misspelt(observation):
    return observation["gaol"]

def words(observation):
    return "left"

class Unmade:
    def __init__(self, file):
        pass

number = 3
"""


@pytest.fixture
def module(folder: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    (folder / "my_drivers.py").write_text(CODE)
    (folder / "broken_drivers.py").write_text("1 / 0")
    monkeypatch.syspath_prepend(folder)
    return "my_drivers"


def _returns(path: Path) -> dict[str, list[float]]:
    found: dict[str, list[float]] = {}
    for row in csv.DictReader((path / "episodes.csv").read_text().splitlines()):
        found.setdefault(row["policy"], []).append(float(row["return"]))
    return found


def test_a_function_and_a_class_drive(call: Call, folder: Path, module: str) -> None:
    names = f"policy=[{module}:straight,{module}:Straight,go_to_goal]"
    assert call(evaluate.main, names, *WORDS, "out=results") == 0
    returns = _returns(folder / "results")
    assert list(returns) == ["straight", "Straight", "go_to_goal"]
    assert returns["straight"] == returns["Straight"] == pytest.approx(returns["go_to_goal"], abs=1e-3)
    pairs = list(csv.DictReader((folder / "results" / "comparison.csv").read_text().splitlines()))
    assert [(row["first"], row["second"]) for row in pairs if row["measure"] == "SR"] == [
        *(("straight", "Straight"), ("straight", "go_to_goal"), ("Straight", "go_to_goal")),
    ]


def test_a_folder_alone_runs_no_code(folder: Path, module: str) -> None:
    name = f"{module}:straight"
    plan = EvaluationPlan.of_settings(compose(EvaluateConf, ["+world=flat", f"policy={name}", "episodes=2"]))
    provenance = {"policies": [plan.sources[0].plain()]}
    for trusted in ((), ("other:straight",)):
        with pytest.raises(ConfigError, match=f"results of {name}, whose code .*\n.* add policy={name}"):
            check_same_sources(plan, provenance, folder, trusted)
    check_same_sources(plan, provenance, folder, [name])


@pytest.mark.slow(all_but=["*missing*", "*short*", "*misspelt*"])
@pytest.mark.parametrize(
    ("policy", "message"),
    [
        ("my_drivers:short", r"actions must be finite numbers of shape (2, 2) (got (2, 1))"),
        ("my_drivers:undefined", "actions must be finite numbers of shape (2, 2) (some are not finite)"),
        ("my_drivers:words", "actions must be finite numbers of shape (2, 2) (got <U4)"),
        ("my_drivers:misspelt", "policy misspelt failed: KeyError: 'gaol' (line 21 of "),
        ("my_drivers:Unmade", "my_drivers:Unmade cannot be made: TypeError: Unmade.__init__() missing 1"),
        ("my_drivers:strait", "has no strait; did you mean my_drivers:straight?"),
        ("my_drivers:missing", "the module my_drivers has no missing"),
        (
            "broken_drivers:f",
            "importing broken_drivers failed: ZeroDivisionError: division by zero (line 1",
        ),
        (":f", "policy=:f: write MODULE:FUNCTION, such as my_drivers:straight"),
        ("my_drivers.py:straight", "write MODULE:FUNCTION, such as my_drivers:straight"),
        ("my_drivers:number", "policy=my_drivers:number is no function, but int"),
        ("no_such_module:f", "the module no_such_module cannot be imported"),
        pytest.param(
            *("absent.onnx", "policy=absent.onnx: there is no such file"),
            marks=pytest.mark.skipif(find_spec("onnxruntime") is None, reason="no onnxruntime"),
        ),
    ],
)
def test_what_is_no_policy_is_named(
    policy: str, message: str, call: Call, folder: Path, module: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(evaluate.main, f"policy={policy}", *WORDS, "out=results") == 2
    error = capsys.readouterr().err
    assert message in error and "Traceback" not in error and error.count("\n") <= 2
    assert not (folder / "results").exists()


def test_an_onnx_file_drives(call: Call, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("onnxruntime")
    onnx = pytest.importorskip("onnx")
    helper, float32 = onnx.helper, onnx.TensorProto.FLOAT
    # Full speed towards the goal: (N, 2) of distance and bearing -> (N, 2) of speed and heading.
    nodes = [
        helper.make_node("MatMul", ["goal", "weights"], ["turned"]),
        helper.make_node("Add", ["turned", "bias"], ["action"]),
    ]
    constants = [
        helper.make_tensor("weights", float32, [2, 2], [0.0, 0.0, 0.0, 1.0]),
        helper.make_tensor("bias", float32, [2], [9.0, 0.0]),
    ]
    for name, batch in (("driver", "n"), ("single", 1)):
        graph = helper.make_graph(
            nodes,
            name,
            [helper.make_tensor_value_info("goal", float32, [batch, 2])],
            [helper.make_tensor_value_info("action", float32, [batch, 2])],
            constants,
        )
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
        if batch == "n":
            trained = json.dumps({"decision_s": 0.2, "control_step_s": 0.05})
            helper.set_model_props(model, {"dune_rl": trained})
        onnx.save(model, folder / f"{name}.onnx")
    assert call(evaluate.main, "policy=[driver.onnx,single.onnx]", *WORDS, "out=results") == 0
    noted = "note: driver was trained with physics.action_repeat=4, and decides here with 1"
    assert capsys.readouterr().err.splitlines() == [noted]
    returns = _returns(folder / "results")
    assert list(returns) == ["driver", "single"]
    # Exporters fix the batch at one unless told otherwise.
    assert returns["driver"] == pytest.approx(returns["single"], abs=1e-3)
    actions = [{"name": "speed", "low": 0.0, "high": 9.0}, {"name": "heading", "low": -3.14, "high": 3.14}]
    helper.set_model_props(model, {"dune_rl": json.dumps({"action": actions})})
    onnx.save(model, folder / "faster.onnx")
    assert call(evaluate.main, "policy=faster.onnx", *WORDS, "out=faster") == 2
    error = capsys.readouterr().err
    assert "policy=faster.onnx was made for another environment: actions lie in [0, 9], [-3.14" in error
    same = helper.make_graph(
        [helper.make_node("Identity", ["goal"], ["action"])],
        "wide",
        [helper.make_tensor_value_info("goal", float32, ["n", 3])],
        [helper.make_tensor_value_info("action", float32, ["n", 3])],
    )
    wide = helper.make_model(same, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.save(wide, folder / "wide.onnx")
    assert call(evaluate.main, "policy=wide.onnx", *WORDS, "out=wide") == 2
    assert "policy=wide.onnx reads goal of size 3, and gets 2; set the sensors" in capsys.readouterr().err
    (folder / "broken.onnx").write_bytes(b"no graph")
    assert call(evaluate.main, "policy=broken.onnx", *WORDS, "out=broken") == 2
    assert not (folder / "broken").exists()


def test_a_checkpoint_in_the_current_folder_has_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mine").mkdir()
    monkeypatch.chdir(tmp_path / "mine")
    conf = compose(EvaluateConf, ["+world=flat", "policy=random"]).model_copy(update={"checkpoint": (".",)})
    assert [source.name for source in policy_sources(conf)] == ["mine", "random"]
