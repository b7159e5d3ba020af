"""Settings of published runs and evaluations, in all forms that they were saved in."""

import warnings
from pathlib import Path

import numpy as np
import pytest
import yaml
from published_tasks import with_terms

from dune_rl.config.commands import EvaluateConf
from dune_rl.config.compose import compose
from dune_rl.config.saved import upgrade_saved
from dune_rl.config.schema import Conf, EnvConf
from dune_rl.env.distributions import Choice, LogUniform, Normal, Uniform
from dune_rl.env.domain_randomizer import DomainRandomizer
from dune_rl.env.randomisation import RandomisationConf
from dune_rl.learning.checkpoint import read_checkpoint_file
from dune_rl.metrics.episode import MetricsConf
from dune_rl.rendering.light import LightConf
from dune_rl.rendering.weather import WeatherConf
from dune_rl.sensors.conf import parse_sensors
from dune_rl.tasks.task import TaskConf
from dune_rl.worlds.appearance import with_own_sun
from dune_rl.worlds.flat import FlatConf, build_flat

EXPERIMENTS = Path(__file__).parents[2] / "experiments"
FLAT = build_flat(FlatConf())


@pytest.mark.slow(all_but=["*-v2-yaml0", "seed2-pt", "forecast-yaml"])
@pytest.mark.parametrize(
    "file",
    sorted([*EXPERIMENTS.rglob("config.yaml"), *EXPERIMENTS.rglob("policy.pt")]),
    ids=lambda file: f"{file.parent.name}-{file.suffix[1:]}",
)
def test_settings_of_the_studies_are_read(file: Path) -> None:
    if file.suffix == ".pt":
        saved = dict(read_checkpoint_file(file, "policy")["config"])
    else:
        saved = yaml.safe_load(file.read_text())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        conf = compose(EvaluateConf, ["policy=random"], (), saved)
    agents = saved.get("agents") or {"rover": {}}
    assert conf.external_groups[0].name in agents
    # The oldest runs had another form of this, and the default.
    said = saved["task"].get("terminations", {"time_limit": {"max_steps": 2000}})
    steps = said["time_limit"]["max_steps"]
    assert conf.task.terminations["time_limit"].max_steps == steps  # type: ignore[attr-defined]
    if "learning" in saved:
        assert compose(Conf, [], (), saved).groups == conf.groups


def test_the_oldest_runs_had_the_default_task_and_metrics() -> None:
    saved = yaml.safe_load((EXPERIMENTS / "flat" / "seed1" / "config.yaml").read_text())
    old = saved["task"]["reward"] | saved["task"]["termination"]
    assert (old["alpha"], old["goal"], old["contact"], old["goal_distance_m"], old["stuck_steps"]) == (
        *(1.5, 100.0, -10.0),
        *(0.75, 300),
    )
    conf = EnvConf.model_validate(
        {name: value for name, value in upgrade_saved(saved).items() if name in EnvConf.model_fields}
    )
    assert (conf.task, conf.metrics) == (TaskConf(), MetricsConf())
    changed = compose(EvaluateConf, ["policy=random", "task.terminations.time_limit.max_steps=5"], (), saved)
    assert changed.task == with_terms(TaskConf(), terminations={"time_limit": {"max_steps": 5}})


def test_angles_of_older_runs_are_the_same_in_degrees() -> None:
    saved = yaml.safe_load((EXPERIMENTS / "inspection" / "config.yaml").read_text())
    conf = compose(EvaluateConf, ["policy=random"], (), saved)
    old = saved["sensors"]
    assert conf.sensors["lidar"].fov_deg == 360.0
    camera = parse_sensors(upgrade_saved({"sensors": old | {"enabled": ["camera"]}})["sensors"])["camera"]
    assert np.deg2rad(camera.fov_deg) == pytest.approx(old["camera"]["fov_rad"])  # type: ignore[attr-defined]
    assert np.deg2rad(conf.weather.light.sun_bearing_deg) == pytest.approx(2.2)


def test_the_former_default_sun_gives_way_to_a_world_s_own() -> None:
    world = build_flat(FlatConf())
    world.light = LightConf(sun_bearing_deg=10.0)
    for old in ({}, {"sun_bearing_rad": 2.2, "sun_elevation_rad": 0.75}):
        weather = WeatherConf.model_validate(upgrade_saved({"weather": {"light": old}})["weather"])
        assert with_own_sun(world, weather).light == world.light


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ([-1.0, 2.0], Uniform(low=-57.295779513, high=114.591559026)),
        ([0.0, 1.0, 2.0], Choice(values=(0.0, 57.295779513, 114.591559026))),
        ({"name": "log_uniform", "low": np.pi / 6, "high": np.pi}, LogUniform(low=30.0, high=180.0)),
        (
            {"name": "normal", "mean": np.pi / 2, "deviation": np.pi / 18, "low": 0.0, "high": np.pi},
            Normal(mean=90.0, deviation=10.0, low=0.0, high=180.0),
        ),
        (None, None),
    ],
)
def test_every_number_of_a_distribution_becomes_degrees(old: object, new: object) -> None:
    conf = RandomisationConf.model_validate(
        upgrade_saved({"randomisation": {"sun_bearing_rad": old}})["randomisation"]
    )
    assert conf.sun_bearing_deg == new


def test_an_older_run_s_seed_keeps_its_suns() -> None:
    old = {"sun_bearing_rad": {"name": "uniform", "low": -2.0, "high": 2.0}, "friction": [0.5, 1.5]}
    conf = RandomisationConf.model_validate(upgrade_saved({"randomisation": old})["randomisation"])
    randomizer = DomainRandomizer(FlatConf(), WeatherConf(), conf, lambda _: FLAT)
    drawn = [dict(zip(randomizer.names, randomizer.draw(3, episode), strict=True)) for episode in range(3)]
    # As they were drawn in radians.
    expected = [-1.7755365337416786, -1.0998335036208027, -0.015683946771946733]
    assert [values["sun_bearing_deg"] for values in drawn] == pytest.approx(np.rad2deg(expected), abs=1e-6)


def test_grids_of_commands_keep_their_headings() -> None:
    saved = compose(Conf, ["+world=flat", "sensors=perception", "+sensors.command_costs={}"])
    plain = saved.model_dump(mode="json")
    assert compose(Conf, ["+world=flat"], (), plain).sensors == saved.sensors


def test_saved_look_aheads_without_gap_errors_keep_exact_gaps() -> None:
    before = {"sensor": "command_costs", "max_cost": 5.0}
    rover = {"body": "rover_zero", "sensors": {"costs": before}}
    upgraded = upgrade_saved({"sensors": {"costs": before}, "agents": {"rover": rover}})
    for sensors in (upgraded["sensors"], upgraded["agents"]["rover"]["sensors"]):
        own = sensors["costs"]
        assert (own["max_cost"], own["gap_error_m"], own["gap_error_growth_mps"]) == (5.0, 0.0, 0.0)
    own = {**before, "gap_error_m": 0.1, "gap_error_growth_mps": 0.2}
    kept = upgrade_saved({"sensors": {"costs": own}})["sensors"]["costs"]
    assert (kept["gap_error_m"], kept["gap_error_growth_mps"]) == (0.1, 0.2)
    assert before == {"sensor": "command_costs", "max_cost": 5.0}
