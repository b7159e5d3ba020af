"""The driver `oracle`, and the forecasts that it drives by."""

from dataclasses import replace

import numpy as np
import pytest
from drivers import DrivenBodies
from yards import yard

from dune_rl.behaviours.drivers.oracle import Oracle
from dune_rl.behaviours.drivers.planner import Planner
from dune_rl.config.build import make_simulation
from dune_rl.config.compose import compose_environment
from dune_rl.env.simulation import VectorSimulation

STEPS = 12


def places_of(simulation: VectorSimulation, steps: int) -> np.ndarray:
    """Places (M, steps, K, 2) of the rover's neighbours in the next control steps."""
    rest = {group.name: np.zeros((2, 1, group.action_size)) for group in simulation.external}
    found = []
    for _ in range(steps):
        simulation.step(rest)
        found.append(simulation.state.groups["rover"].neighbours[..., :2])
    return np.stack(found, axis=1)


@pytest.mark.slow
@pytest.mark.parametrize("path", ["{}", "{pauses_s: 0.3, length_range_m: [1.5, 2.5]}", "{mode: once}"])
def test_forecasts_are_where_walkers_go(path: str) -> None:
    walker = f"{{body: person, count: 3, path: {path}, controller: path}}"
    person = "{body: person, path: {}, controller: social_force}"
    conf = compose_environment(
        "flat",
        [f"+agents={{person: {person}, walker: {walker}, rover: {{body: rover_zero}}}}"],
        {"sensors": {"enabled": ["goal"]}},
    )
    simulation = make_simulation(conf, 2, seed=5)
    try:
        simulation.reset()
        rover = simulation.group("rover")
        for _ in range(4):
            known = rover.forecast_neighbours(conf.physics.control_step_s, STEPS)
            places = np.moveaxis(places_of(simulation, STEPS), 1, 2)
            assert np.isnan(known[:, 0]).all()
            assert known[:, 1:] == pytest.approx(places[:, 1:], abs=1e-6)
            # They walked, so that a forecast of where they are would not do.
            assert np.ptp(places[:, 1:], axis=2).max() > 0.1
    finally:
        simulation.close()


FORWARD, STOP = 0, 1


def costs(
    driver: Planner, forecast: np.ndarray, person: tuple[float, float] = (1.8, -1.6), speed_mps: float = 1.0
) -> np.ndarray:
    """Costs of driving on, and of a stop, of a body at full speed along x, whose highest that is; a person
    stands beside its way, or elsewhere.
    """
    bodies = DrivenBodies(yard(), [0.0, 0.0, 0.0], [8.0, 0.0], [[*person, 0.0, 0.0]])
    bodies.twists[:, 0] = speed_mps
    context = bodies.context()
    vehicle = replace(context.vehicle, max_speed_mps=speed_mps)
    known = replace(context, vehicle=vehicle, forecast=lambda step_s, steps: forecast[None, None, :steps])
    driver.bind(known)
    state, group = bodies.state()
    driver.reset(np.ones(1, bool), group)
    found: np.ndarray = driver.action_costs(state, group, np.array([[speed_mps, 0.0], [0.0, 0.0]]), 8.0)[0]
    return found


def test_oracle_stops_before_who_will_step_into_its_way() -> None:
    steps_in = np.column_stack([np.full(25, 1.8), np.linspace(-1.6, 0.0, 25)])
    assert costs(Planner(1), steps_in).argmin() == FORWARD
    assert costs(Oracle(1), steps_in).argmin() == STOP
    # Nothing is known, or it is about somebody who is elsewhere: as the planner.
    for other in (np.full((25, 2), np.nan), steps_in + np.array([0.0, 5.0])):
        assert (costs(Oracle(1), other) == costs(Planner(1), other)).all()


def test_slow_bodies_look_further_ahead() -> None:
    # Somebody comes from behind, and is there after 3 s: too late for who looks 2.5 s ahead.
    comes = np.column_stack([np.linspace(-3.6, 0.2, 40), np.zeros(40)])
    behind = (-3.6, 0.0)
    late, early = costs(Planner(1), comes, behind, 0.4), costs(Oracle(1), comes, behind, 0.4)
    assert late.argmin() == early.argmin() == FORWARD
    assert early[STOP] > late[STOP] + 1.0
