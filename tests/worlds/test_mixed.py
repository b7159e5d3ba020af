"""Mixtures of world families, and trainings in them."""

import numpy as np
import pytest
from simulations import act, new_simulation, started_simulation

from dune_rl.config.compose import compose
from dune_rl.config.schema import Conf
from dune_rl.core.errors import ConfigError, WorldError
from dune_rl.worlds.flat import FlatConf
from dune_rl.worlds.island import IslandConf
from dune_rl.worlds.mixed import MixedConf

MIXED = {"name": "mixed", "families": ["flat", "island"], "size_m": 110.0}


def test_the_seed_chooses_the_family_and_its_site() -> None:
    conf = MixedConf(families=("island", "flat", "island"), settings={"flat": {"size_m": 40.0}}, seed=6)
    assert conf.drawn() == IslandConf(seed=6)
    assert conf.model_copy(update={"seed": 7}).drawn() == FlatConf(size_m=40.0)
    assert conf.model_copy(update={"seed": 8, "layout_seed": 3}).drawn() == IslandConf(seed=8, layout_seed=3)
    assert conf.drawn().drawn() == conf.drawn()


@pytest.mark.slow
def test_scenes_are_in_different_families_with_equal_bounds() -> None:
    simulation = new_simulation(MIXED, 8, randomisation={"world_seed": [0, 9]})
    simulation.reset()
    names = {simulation.worlds.worlds[scene].name for scene in range(8)}
    assert names == {"flat", "island"}
    seeds = simulation.randomized["world_seed"]
    for scene, seed in enumerate(seeds):
        assert simulation.worlds.worlds[scene].name == ("flat", "island")[int(seed) % 2]
    _, high = simulation.external[0].observation_bounds["goal"]
    assert high[0] == pytest.approx(110.0 * np.sqrt(2.0))
    for _ in range(3):
        act(simulation, [0.5, 0.1])
    simulation.reset()
    simulation.close()


def test_what_cannot_be_mixed_is_refused() -> None:
    with pytest.raises(ValueError, match=r"settings\.moon are of no family; "):
        MixedConf(settings={"moon": {}})
    with pytest.raises(ValueError, match="cannot be one of its own families"):
        MixedConf(families=("mixed",))
    with pytest.raises(ValueError, match="no world 'islnd'"):
        MixedConf(families=("islnd",))
    small = {**MIXED, "size_m": 30.0, "families": ["flat"]}
    with pytest.raises(WorldError, match=r"'flat' covers .* set world.size_m to hold it"):
        started_simulation(small, randomisation={"world_seed": [0, 9]})


def test_evaluations_have_worlds_that_training_does_not_draw() -> None:
    drawn = "randomisation.world_seed={name: integers, low: 1000, high: 1099}"
    conf = compose(Conf, ["+world=inspection", drawn, "learning.evaluation.world_seeds=[2000,2009]"])
    limits = conf.randomisation.with_new_worlds(conf.learning.evaluation.world_seeds).world_seed.limits
    assert limits == (2000, 2009)
    for seeds, said in (
        (
            "[1099,1200]",
            r"draws worlds of the seeds 1000 to 1099 itself; choose others, such as \[1100,2099\]",
        ),
        ("[3000,2000]", "the first must not be above the second"),
    ):
        with pytest.raises(ConfigError, match=said):
            compose(Conf, ["+world=inspection", drawn, f"learning.evaluation.world_seeds={seeds}"])
    with pytest.raises(ConfigError, match="world=flat has no seed; leave it null"):
        compose(Conf, ["+world=flat", "learning.evaluation.world_seeds=[2000,2009]"])
