"""The registries: settings from parameters, terms with and without a past, and what is said of faults."""

import pickle
import re
import subprocess
import sys
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Annotated, Any

import numpy as np
import pytest
from pydantic import BeforeValidator, Field, SerializeAsAny, TypeAdapter, ValidationError
from user_packages import REGISTRIES, registries_restored

import dune_rl
from dune_rl.core.errors import RegistryError
from dune_rl.core.registry import Registry
from dune_rl.core.settings import Settings
from dune_rl.metrics.registry import METRICS
from dune_rl.sensors.conf import parse_sensors
from dune_rl.sensors.registry import SENSORS
from dune_rl.tasks.registry import REWARDS, RewardTermConf

Entries = TypeAdapter(
    Annotated[
        dict[str, Annotated[SerializeAsAny[RewardTermConf], BeforeValidator(REWARDS.parse_settings)]],
        BeforeValidator(REWARDS.tag_entries),
    ]
)
STATE: Any = SimpleNamespace()
GROUP: Any = SimpleNamespace(speed=np.array([1.0, 3.0]))


@pytest.fixture(autouse=True)
def _no_parts_stay() -> Iterator[None]:
    with registries_restored():
        yield


def slow(state: Any, group: Any, *, top_mps: Annotated[float, Field(gt=0)] = 2.0) -> np.ndarray:
    """Pays for speeds below `top_mps`."""
    return np.asarray(group.speed < top_mps, float)


class Steady:
    """Counts the steps since the start."""

    def __init__(self, num_rows: int, *, gain: float = 1.0) -> None:
        self.counts, self.gain = np.zeros(num_rows), gain

    def reset(self, mask: np.ndarray, group: Any) -> None:
        self.counts[mask] = 0.0

    def __call__(self, state: Any, group: Any) -> np.ndarray:
        self.counts += self.gain
        return self.counts.copy()


class SlowConf(Settings):
    top_mps: float = Field(2.0, gt=0)


def slow_of(state: Any, group: Any, conf: SlowConf) -> np.ndarray:
    return slow(state, group, top_mps=conf.top_mps)


def test_parameters_of_a_function_are_settings() -> None:
    dune_rl.register_reward(slow)
    conf = REWARDS.settings_class("slow")(weight=3.0, top_mps=1.5)
    assert conf.model_dump() == {"term": "slow", "weight": 3.0, "unless": (), "top_mps": 1.5}
    assert REWARDS.bind(conf, 2)(STATE, GROUP).tolist() == [1.0, 0.0]
    with pytest.raises(ValidationError, match="greater than 0"):
        REWARDS.settings_class("slow")(top_mps=0.0)


def test_one_settings_object_takes_the_place_of_parameters() -> None:
    REWARDS.register(slow_of)
    conf = REWARDS.settings_class("slow_of")(top_mps=5.0)
    assert REWARDS.bind(conf, 2)(STATE, GROUP).tolist() == [1.0, 1.0]


def test_a_class_is_made_for_the_rows_and_keeps_its_past() -> None:
    dune_rl.register_metric("steady")(Steady)
    conf = METRICS.settings_class("steady")(gain=2.0)
    term: Any = METRICS.bind(conf, 2)
    term(STATE, GROUP)
    term.reset(np.array([True, False]), GROUP)
    assert term(STATE, GROUP).tolist() == [2.0, 4.0]


def test_entries_name_their_terms() -> None:
    dune_rl.register_reward(slow)
    entries = Entries.validate_python({"slow": {"weight": 2}, "fast": {"term": "slow"}, "none": None})
    assert [(name, conf.term) for name, conf in entries.items()] == [("slow", "slow"), ("fast", "slow")]
    assert Entries.validate_python(Entries.dump_python(entries, mode="json")) == entries
    with pytest.raises(ValidationError, match=r"there is no reward 'slou' .*; did you mean slow\?"):
        Entries.validate_python({"slou": {}})


def test_settings_travel_to_other_processes() -> None:
    dune_rl.register_reward(slow)
    sent = pickle.dumps(REWARDS.settings_class("slow")(top_mps=4.0))
    REWARDS._user_parts.clear()
    there = pickle.loads(sent)
    assert REWARDS.bind(there, 2)(STATE, GROUP).tolist() == [1.0, 1.0]
    assert pickle.loads(pickle.dumps(there)) == there


@dune_rl.sensor_bounds(low=0.0, high=5.0)
def pace(state: Any, group: Any, *, gain: float = 1.0) -> np.ndarray:
    return gain * np.asarray(group.speed)


def test_a_sensor_travels_with_its_settings() -> None:
    dune_rl.register_sensor(pace)
    conf = parse_sensors(["goal", "pace"])
    common = {"realism": None, "privileged": False, "observed": True}
    assert conf["pace"].model_dump() == {"sensor": "pace", **common, "gain": 1.0}
    sent = pickle.dumps(conf)
    SENSORS._user_parts.clear()
    there = pickle.loads(sent)
    assert list(there) == ["goal", "pace"]
    assert SENSORS.part_of(there["pace"]).target is pace


def untyped(state: Any, group: Any, *, gain=1.0) -> np.ndarray: ...  # type: ignore[no-untyped-def]
def swapped(group: Any, state: Any) -> np.ndarray: ...  # type: ignore[empty-body]
def weighted(state: Any, group: Any, *, weight: float = 1.0) -> np.ndarray: ...  # type: ignore[empty-body]
def returns(state: Any, group: Any) -> int: ...  # type: ignore[empty-body]
def unfit(state: Any, group: Any, *, gain: Annotated[float, Field(gt=0)] = 0.0) -> np.ndarray: ...  # type: ignore[empty-body]


class Rowless:
    def __init__(self, gain: float = 1.0) -> None: ...


@pytest.mark.parametrize(
    ("target", "said"),
    [
        (untyped, "whose parameter 'gain' has no type: write such as gain: int = 0."),
        (swapped, "whose first parameters must be state, group."),
        (weighted, "whose parameter 'weight' has a name that settings use themselves."),
        (returns, "made with (num_rows), and says that it returns int."),
        (unfit, "whose default for gain is unfit: Input should be greater than 0."),
        (Rowless, "whose __init__ must have the parameters num_rows."),
        (3, "which must be a function of (state, group) that returns an array, or a class"),
    ],
)
def test_what_cannot_be_a_term_is_said(target: Any, said: str) -> None:
    with pytest.raises(RegistryError, match=re.escape(said)):
        REWARDS.register(target, "broken")


def test_values_of_a_users_term_are_checked() -> None:
    REWARDS.register(lambda state, group: np.zeros(3), "three")
    REWARDS.register(lambda state, group: 1.0, "number")
    for name, what in (("three", r"one of shape \(3,\)"), ("number", "1.0")):
        with pytest.raises(RegistryError, match=rf"must return an array of shape \(2,\).* returned {what}"):
            REWARDS.bind(REWARDS.settings_class(name)(), 2)(STATE, GROUP)


def test_only_classes_are_algorithms() -> None:
    with pytest.raises(RegistryError, match=r"class derived from .*Algorithm, and is <function slow"):
        dune_rl.register_algorithm(slow)


@pytest.mark.parametrize("registry", REGISTRIES, ids=lambda registry: registry.kind)
def test_our_own_parts_are_there(registry: Registry[Any]) -> None:
    assert registry.own
    for name in registry.own:
        settings = registry.settings_class(name)
        assert settings.model_fields[registry.tag].default == name


@pytest.mark.slow
def test_listing_imports_neither_torch_nor_an_engine() -> None:
    program = (
        "import sys; from dune_rl.worlds.registry import WORLDS; from dune_rl.tasks.registry import REWARDS; "
        "from dune_rl.robots.registry import ROBOTS; from dune_rl.sensors.registry import SENSORS; "
        "print(WORLDS.names(), REWARDS.names(), ROBOTS.names(), SENSORS.names()); "
        "print([name for name in ('torch', 'pybullet', 'dartpy') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"
