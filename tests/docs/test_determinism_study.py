"""The comparison of the study of determinism (`experiments/reliability`) finds faults that are planted."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dune_rl.env.simulation import VectorSimulation

STUDY = Path(__file__).parents[2] / "experiments" / "reliability"
STEPS = 24

pytestmark = pytest.mark.slow

Observe = Callable[[VectorSimulation, str], dict[str, Any]]


class SameProcess:
    """In place of a pool of another process, which has no planted fault."""

    def apply(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        return function(*arguments)


@pytest.fixture
def compare(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[[], Any]:
    monkeypatch.setattr(sys, "path", [str(STUDY), *sys.path])
    import combinations
    import determinism

    chosen = combinations.Combination("flat", "rover_zero", "bullet", "walkers")
    return lambda: determinism.compare(chosen, STEPS, tmp_path, SameProcess())


def counts(row: Any) -> tuple[bool, bool, bool]:
    assert not row.fault and min(row.again_of, row.scenes_of, row.restored_of) > 0
    return row.again > 0, row.scenes > 0, row.restored > 0


def plant(monkeypatch: pytest.MonkeyPatch, error: Callable[[VectorSimulation], Any]) -> None:
    """Add `error(simulation)` (M, 1, 1), far below what is noticed in driving, to what is observed."""
    observe: Observe = VectorSimulation.observe

    def wrong(self: VectorSimulation, name: str) -> dict[str, Any]:
        found = dict(observe(self, name))
        first = next(iter(found))
        found[first] = found[first] + np.float32(1e-4) * error(self)
        return found

    monkeypatch.setattr(VectorSimulation, "observe", wrong)


def test_equal_drives_are_found_equal(compare: Callable[[], Any]) -> None:
    assert counts(compare()) == (False, False, False)


def test_what_changes_from_call_to_call_is_found(
    compare: Callable[[], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = iter(range(1, 10**6))
    plant(monkeypatch, lambda simulation: np.float32(next(calls)))
    row = compare()
    assert counts(row) == (True, True, True)
    assert row.first == "again: episode 0, step 0"


def test_what_depends_on_the_number_of_scenes_is_found(
    compare: Callable[[], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    plant(monkeypatch, lambda simulation: np.float32(simulation.num_scenes))
    assert counts(compare()) == (False, True, False)


def test_what_a_saved_state_lacks_is_found(
    compare: Callable[[], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    restored: set[int] = set()
    restore = VectorSimulation.restore

    def forget(self: VectorSimulation, state: dict[str, Any]) -> Any:
        restored.add(id(self))
        return restore(self, state)

    monkeypatch.setattr(VectorSimulation, "restore", forget)
    plant(monkeypatch, lambda simulation: np.float32(id(simulation) in restored))
    assert counts(compare()) == (False, False, True)
