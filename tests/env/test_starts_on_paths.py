"""Where agents start that steer themselves, and have paths to start on: beside each other."""

from itertools import combinations

import numpy as np
import pytest

from dune_rl.config.build import make_simulation
from dune_rl.config.compose import compose_environment
from dune_rl.env.simulation import VectorSimulation


def gaps(simulation: VectorSimulation) -> list[float]:
    """Distances between the outlines of all people of all scenes who are there, as discs [m]."""
    found = []
    people = [group for group in simulation.groups if group.description.kind == "person"]
    for scene in range(simulation.num_scenes):
        discs = [
            (group.body.poses[row, :2], group.description.reach_m)
            for group in people
            for row in range(scene * group.count, (scene + 1) * group.count)
            if group.presence is None or not group.presence.absent[row]
        ]
        found += [np.hypot(*(a - b)) - first - second for (a, first), (b, second) in combinations(discs, 2)]
    return found


@pytest.mark.slow
def test_people_of_a_crowd_start_beside_each_other() -> None:
    conf = compose_environment(None, ["sensors.enabled=[goal]"], {"scenario": "crowd"})
    simulation = make_simulation(conf, 16, seed=1)
    try:
        simulation.reset()
        assert min(gaps(simulation)) > 0.0
    finally:
        simulation.close()


@pytest.mark.slow(all_but=["orca"])
@pytest.mark.parametrize("controller", ["orca", "external"])
def test_groups_start_beside_each_other_and_beside_walkers(controller: str) -> None:
    group = f"{{body: person, count: 6, path: {{}}, controller: {controller}}}"
    walkers = "{body: person, count: 4, controller: path}"
    conf = compose_environment(
        "flat",
        [f"+agents={{rover: {{body: rover_zero}}, first: {group}, walker: {walkers}, last: {group}}}"],
        {"sensors": {"enabled": ["goal"]}},
    )
    simulation = make_simulation(conf, 8, seed=2)
    try:
        simulation.reset()
        by_name = {group.name: group for group in simulation.groups}
        for scene in range(8):
            for one, other in (
                ("first", "first"),
                ("first", "walker"),
                ("first", "last"),
                ("walker", "last"),
            ):
                a, b = (by_name[name].body.poses.reshape(8, -1, 6)[scene, :, :2] for name in (one, other))
                apart = np.hypot(*np.moveaxis(a[:, None] - b[None], -1, 0))
                if one == other:
                    apart[np.diag_indices(len(apart))] = np.inf
                assert apart.min() > (by_name[one].description.reach_m + by_name[other].description.reach_m)
    finally:
        simulation.close()


@pytest.mark.slow
def test_those_who_come_later_find_room_beside_the_others() -> None:
    group = "{body: person, count: 10, path: {}, controller: orca, presence: {arrive_s: [0.0, 3.0]}}"
    conf = compose_environment("flat", [f"actors.walker={group}", "sensors.enabled=[goal]"])
    simulation = make_simulation(conf, 4, seed=3)
    try:
        simulation.reset()
        visits, arrived = simulation.groups[1].presence, 0
        for _ in range(70):
            before = visits.absent.copy()
            simulation.step({"rover": np.zeros((4, 2))})
            new = before & ~visits.absent
            arrived += int(new.sum())
            if new.any():
                assert min(gaps(simulation), default=np.inf) > -0.05
        assert arrived > 20
    finally:
        simulation.close()
