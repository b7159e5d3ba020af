"""The scan that measures for terms: its range, and in a simulation, where nothing reads it unasked."""

import numpy as np
import pytest
from term_states import agents

import dune_rl
from dune_rl.config.build import make_simulation
from dune_rl.config.compose import compose_environment
from dune_rl.sensors.lidar import DUNE_CODE_LIDAR, MeasuringScan


class FixedBeams:
    """Beams with given ranges."""

    def __init__(self, *ranges: list[float]) -> None:
        self._ranges = np.array(ranges, np.float32)

    def ranges(self, *_: object) -> np.ndarray:
        return self._ranges


def test_returns_out_of_range_are_none() -> None:
    scan = MeasuringScan.__new__(MeasuringScan)
    scan._conf = DUNE_CODE_LIDAR
    scan._beams = FixedBeams([0.14, 3.0, 10.0], [0.16, 0.1, 5.0], [10.0, 10.0, 0.149])
    group = agents(3)
    nearest = scan.nearest_return(group.motion, group.neighbours)
    np.testing.assert_allclose(nearest, [3.0, 0.16, np.nan], rtol=1e-6)


def simulation_of(*overrides: str) -> object:
    conf = compose_environment("flat", ["actors=none", "sensors.enabled=[goal]", *overrides])
    return make_simulation(conf, 2, 3)


def test_it_sees_what_the_lidar_sees() -> None:
    lidar = "sensors.lidar={n_beams: 640, n_segments: 32, range_m: 10.0, min_range_m: 0.15}"
    simulation = simulation_of("metrics=dune_code", "sensors.enabled=[lidar,goal]", lidar)
    simulation.reset()
    for _ in range(20):
        simulation.step({"rover": np.tile([0.8, 0.3], (2, 1, 1))})
    state = simulation.state.groups["rover"]
    seen = simulation.observe("rover")["lidar"][:, 0].min(axis=1)
    expected = np.where(seen < 10.0, seen, np.nan)
    np.testing.assert_allclose(state.nearest_return, expected, rtol=1e-6)
    simulation.close()


def test_nothing_scans_unasked() -> None:
    simulation = simulation_of()
    simulation.reset()
    assert simulation.groups[0].scanner is None
    with pytest.raises(dune_rl.ConfigError, match="needs_scan = True"):
        _ = simulation.state.groups["rover"].nearest_return
    simulation.close()
