"""Sites of a set that a training run has had are found, so that an evaluation can say so."""

from typing import Any

import pytest

from dune_rl.evaluation.episode_sets.apply import sites_of_training
from dune_rl.evaluation.episode_sets.files import read_episode_set


def config(world: str, seed: int | None, drawn: Any = None) -> dict[str, Any]:
    return {"world": {"name": world, "seed": seed}, "randomisation": {"world_seed": drawn}}


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        (config("inspection", 0), []),
        (config("inspection", 503), [503]),
        (config("rubicon", 503), []),
        (config("inspection", 503, {"name": "integers", "low": 1000, "high": 1_000_000}), []),
        (config("inspection", 0, {"name": "integers", "low": 1, "high": 502}), [500, 501, 502]),
        (config("inspection", 0, {"name": "choice", "values": [7, 501, 530]}), [501, 530]),
        (config("inspection", 0, [520, 521]), [520, 521]),
        (
            config("mixed", 0, [502, 507]) | {"world": {"name": "mixed", "families": ["flat", "inspection"]}},
            [503, 505, 507],
        ),
        ({}, []),
    ],
)
def test_sites_of_a_fixed_seed_and_of_drawn_ones(settings: dict[str, Any], expected: list[int]) -> None:
    episode_set = read_episode_set("inspection-v1")
    assert {one.world_seed for one in episode_set.episodes} >= {500, 549}
    assert sites_of_training(settings, episode_set) == expected


def test_a_world_without_seeds_has_none() -> None:
    assert sites_of_training(config("flat", None), read_episode_set("flat-v1")) == []
