"""The configuration: every option composes, YAML and classes agree, and each fault has its words."""

from typing import Any

import pytest
import yaml
from published_tasks import with_terms

from dune_rl.behaviours.paths.follower import PathConf
from dune_rl.behaviours.registry import BEHAVIOURS
from dune_rl.bodies.animals import CowConf, DogConf, SheepConf
from dune_rl.bodies.drone import DroneConf
from dune_rl.bodies.person import ChildConf, PersonConf
from dune_rl.bodies.vehicles import CarConf, TractorConf, TruckConf
from dune_rl.config.agents import AgentGroupConf, roaming_task, walker_sensors
from dune_rl.config.commands import EvaluateConf
from dune_rl.config.compose import compose, compose_environment
from dune_rl.config.group_options import MARK
from dune_rl.config.hydra_session import WHOLE_SETTINGS
from dune_rl.config.schema import Conf, EnvConf
from dune_rl.core import paths
from dune_rl.core.settings import Settings
from dune_rl.env.distributions import Integers, LogUniform, Uniform
from dune_rl.env.randomisation import RandomisationConf
from dune_rl.learning.crossq.settings import CrossqConf
from dune_rl.learning.discrete_sac.settings import DiscreteSacConf
from dune_rl.learning.imitation.settings import ImitationConf
from dune_rl.learning.ppo.settings import PpoConf
from dune_rl.learning.sac.settings import SacConf
from dune_rl.metrics.episode import PAPER_METRICS, MetricsConf
from dune_rl.physics.interface import PhysicsConf
from dune_rl.rendering.light import LightConf
from dune_rl.rendering.weather import WeatherConf
from dune_rl.robots.hyperdog import HyperDogConf
from dune_rl.robots.leo_rover import LeoRoverConf
from dune_rl.robots.rover_zero import RoverZeroConf
from dune_rl.robots.urdf.conf import UrdfConf
from dune_rl.sensors.conf import default_sensors, parse_sensors
from dune_rl.sensors.settings import SensorSettings
from dune_rl.tasks.task import TaskConf, walking_task
from dune_rl.worlds.construction.build import ConstructionConf
from dune_rl.worlds.flat import FlatConf
from dune_rl.worlds.importing.heightmap_world import HeightmapConf
from dune_rl.worlds.importing.mesh_world import MeshConf
from dune_rl.worlds.importing.sdf.build import SdfConf
from dune_rl.worlds.inspection.build import InspectionConf
from dune_rl.worlds.island import IslandConf
from dune_rl.worlds.mixed import MixedConf
from dune_rl.worlds.obstacle_course import ObstacleCourseConf
from dune_rl.worlds.rubicon import RubiconConf

CONF = paths.conf_folder()
OPTIONS = sorted(
    (path.parent.name, path.stem) for path in CONF.glob("*/*.yaml") if path.parent.name not in WHOLE_SETTINGS
)
# What a user says, and no option.
GIVEN = "a/file"
# What each option says, written down a second time as plain objects.
WORLDS = RandomisationConf(
    world_seed=Integers(low=1000, high=1_000_000),
    friction=LogUniform(low=0.6, high=1.25),
    sun_bearing_deg=Uniform(low=-180.0, high=180.0),
    sun_elevation_deg=Uniform(low=14.0, high=74.0),
    brightness=LogUniform(low=0.7, high=1.4),
)
BODY = RandomisationConf(
    mass=Uniform(low=0.8, high=1.3),
    centre_x_m=Uniform(low=-0.03, high=0.03),
    centre_y_m=Uniform(low=-0.02, high=0.02),
    centre_z_m=Uniform(low=-0.02, high=0.05),
    motor_strength=Uniform(low=0.8, high=1.1),
    wheel_friction=LogUniform(low=0.8, high=1.25),
    action_latency_s=Uniform(low=0.0, high=0.1),
)
WALKERS = AgentGroupConf(body=PersonConf(), count=2, controller="path", path=PathConf())
EXTERNAL_WALKERS = AgentGroupConf(body=PersonConf(), count=2, path=PathConf())


def people(controller: dict[str, Any], count: int, speed_mps: float = 1.0) -> AgentGroupConf:
    """Walkers with a behaviour."""
    behaviour = BEHAVIOURS.parse_settings(controller)
    body = PersonConf(speed_mps=speed_mps)
    return WALKERS.model_copy(update={"controller": behaviour, "count": count, "body": body})


def seen_as_figures(group: AgentGroupConf, **settings: Any) -> AgentGroupConf:
    """People with limbs, in clothes of their own."""
    assert isinstance(group.body, PersonConf)
    figure = {"looks": "figure", "clothes": "mixed", **settings}
    return group.model_copy(update={"body": group.body.model_copy(update=figure)})


def roaming(body: Any, count: int, **controller: Any) -> AgentGroupConf:
    """Bodies that start anywhere in the world."""
    behaviour = BEHAVIOURS.parse_settings(controller)
    task = roaming_task(TaskConf.model_validate({"spawn": {"region": "anywhere"}}))
    return AgentGroupConf(body=body, count=count, controller=behaviour, task=task)


TRAFFIC = {"name": "random_waypoint", "range_m": 15.0}
SQUARE = [[-3.0, -3.0], [3.0, -3.0], [3.0, 3.0], [-3.0, 3.0]]
NAVIGATION: dict[str, Any] = {
    "duration": {"reduce": "last", "initial": 0.0},
    "path_length": {"reduce": "sum"},
    "spl": {"reduce": "last", "initial": 0.0},
    "mean_speed": {"term": "ground_speed"},
    "roll": {"term": "abs_roll", "initial": 0.0},
    "max_roll": {"term": "abs_roll", "reduce": "max", "initial": 0.0},
    "pitch": {"term": "abs_pitch", "initial": 0.0},
    "max_pitch": {"term": "abs_pitch", "reduce": "max", "initial": 0.0},
    "jerk": {},
    "time_in_collision": {"reduce": "sum"},
    "near_misses": {"reduce": "sum"},
    "actor_gap": {"initial": 12.0},
    "min_actor_gap": {"term": "actor_gap", "reduce": "min", "initial": 12.0},
    "intrusion": {"term": "seconds_near", "reduce": "sum", "within_m": 1.2},
    "risk_seconds": {"reduce": "sum"},
    "seconds_at_risk": {"term": "seconds_near", "reduce": "sum", "within_m": 0.5},
    "encounters_intimate": {"term": "encounters", "reduce": "last", "initial": 0.0, "most_m": 0.5},
    "encounters_personal": {
        "term": "encounters",
        "reduce": "last",
        "initial": 0.0,
        "least_m": 0.5,
        "most_m": 0.8,
    },
    "encounters_social": {"term": "encounters", "reduce": "last", "initial": 0.0, "least_m": 0.8},
    **{
        f"collisions_{kind}": {"term": "collisions_with", "reduce": "sum", "kinds": (kind,)}
        for kind in ("static", "robot", "person", "vehicle", "animal", "drone")
    },
    "stuck_count": {"term": "ended_by", "termination": "stuck", "reduce": "sum"},
    "flip_count": {"term": "ended_by", "termination": "flipped", "reduce": "sum"},
}
DUNE_CODE_METRICS: dict[str, Any] = {
    "dune_code_successes": {"term": "dune_code_attempts", "reduce": "sum", "outcome": "reached"},
    "dune_code_attempts": {"reduce": "sum"},
    "dune_code_goal_time": {"reduce": "sum"},
    "dune_code_collisions": {"reduce": "sum"},
    "dune_code_clearance": {"reduce": "sum"},
    "dune_code_clearance_rows": {"term": "dune_code_rows", "reduce": "sum", "of": "clearance"},
    "dune_code_speed": {"reduce": "sum"},
    "dune_code_rough_speed": {"term": "dune_code_speed", "reduce": "sum", "rough_mps2": 15.0},
    "dune_code_rough_rows": {"term": "dune_code_rows", "reduce": "sum", "rough_mps2": 15.0},
    "dune_code_smoothness": {"reduce": "sum"},
    "dune_code_rows": {"reduce": "sum"},
    "dune_code_vertical": {"reduce": "sum"},
}
VORT_METRICS: dict[str, Any] = {
    "vort_2": {"term": "vort", "uneven_tilt_deg": 2.0},
    "vort_10": {"term": "vort", "uneven_tilt_deg": 10.0},
    "vort_15": {"term": "vort", "uneven_tilt_deg": 15.0},
    "uneven_2": {"term": "time_on_uneven", "reduce": "sum", "uneven_tilt_deg": 2.0},
    "uneven_time": {"term": "time_on_uneven", "reduce": "sum"},
    "uneven_10": {"term": "time_on_uneven", "reduce": "sum", "uneven_tilt_deg": 10.0},
    "uneven_15": {"term": "time_on_uneven", "reduce": "sum", "uneven_tilt_deg": 15.0},
}


def perception_sensors(**lidar: Any) -> dict[str, SensorSettings]:
    """What `sensors=perception` has, by a LiDAR with these settings."""
    return parse_sensors(
        {
            "lidar": lidar,
            **{
                name: {"sensor": "lidar_past", "past_s": past_s}
                for name, past_s in (("past_025", 0.25), ("past_05", 0.5), ("past_1", 1.0))
            },
            **{name: {} for name in ("agent_tracks", "ground_profile", "low_obstacles")},
            "way_left": {"low_obstacles": "low_obstacles"},
            **{name: {} for name in ("goal_direction", "velocity", "imu_6axis", "last_action")},
        }
    )


def actor_sensors(**neighbours: bool) -> dict[str, SensorSettings]:
    """What actors that learn observe."""
    return parse_sensors(
        {
            "goal": {},
            "neighbours": {"number": 4, "range_m": 10.0, **neighbours},
            "velocity": {"sensor": "planar_velocity"},
            "lidar": {"n_beams": 36, "n_segments": 12, "range_m": 6.0},
        }
    )


ARRIVAL = {"term": "ended_by", "termination": "goal_reached", "weight": 2.0}
TO_AND_FRO = {"goal_reached": {"distance_m": 0.5, "renew": True}}
COOPERATIVE = TaskConf.model_validate(
    {
        "rewards": {
            "progress": {},
            "near_miss": {"weight": -0.5, "comfort_m": 1.2, "own_group": True},
            "goal": ARRIVAL,
            "contact": {"weight": -5.0},
        },
        "terminations": TO_AND_FRO,
    }
)
PLAIN: dict[tuple[str, str], Settings | dict[str, AgentGroupConf]] = {
    ("actors", "none"): {},
    ("actors", "default"): {"walker": WALKERS},
    ("actors", "walkers"): {"walker": WALKERS},
    ("actors", "external_walkers"): {"walker": EXTERNAL_WALKERS},
    ("actors", "cars"): {"car": roaming(CarConf(), 2, speed_mps=3.0, **TRAFFIC)},
    ("actors", "cows"): {
        "cow": AgentGroupConf(
            body=CowConf(),
            count=4,
            controller=BEHAVIOURS.parse_settings(
                {
                    **{"name": "herd", "speed_mps": 0.7, "run_mps": 1.2, "cohesion": 0.6},
                    **{"spacing_m": 3.0, "pause_s": (10.0, 30.0)},
                }
            ),
        )
    },
    ("actors", "crowd"): {
        "walker": seen_as_figures(people({"name": "social_force", "range_m": 5.0}, 12), speed_mps=1.5),
        "child": AgentGroupConf(
            body=ChildConf(speed_mps=1.5, clothes="mixed"),
            count=4,
            controller=BEHAVIOURS.parse_settings(
                {"name": "social_force", "reaction": "curious", "range_m": 5.0}
            ),
            path=PathConf(),
        ),
    },
    ("actors", "crossing"): {"walker": people({"name": "crossing"}, 2)},
    ("actors", "dogs"): {
        "dog": AgentGroupConf(
            body=DogConf(),
            count=2,
            controller=BEHAVIOURS.parse_settings(
                {"name": "random_waypoint", "speed_mps": 2.5, "pause_s": (0.0, 4.0)}
            ),
        )
    },
    ("actors", "drones"): {"drone": roaming(DroneConf(), 2, name="go_to_goal", speed_mps=3.0)},
    ("actors", "flee"): {"walker": people({"name": "flee"}, 4, 1.5)},
    ("actors", "follow"): {"walker": people({"name": "follow"}, 1)},
    ("actors", "herd"): {
        "herd": AgentGroupConf(
            body=SheepConf(), count=8, controller=BEHAVIOURS.parse_settings({"name": "herd"})
        )
    },
    ("actors", "jaywalkers"): {
        "walker": seen_as_figures(people({"name": "crossing", "speed_mps": 1.4}, 3), speed_mps=1.4)
    },
    ("actors", "learning_walkers"): {
        "walker": EXTERNAL_WALKERS.model_copy(
            update={"count": 4, "sensors": actor_sensors(), "task": COOPERATIVE}
        )
    },
    ("actors", "orca"): {"walker": people({"name": "orca"}, 8, 1.5)},
    ("actors", "patrol"): {"walker": people({"name": "patrol", "places": SQUARE}, 2)},
    ("actors", "pedestrians"): {"walker": seen_as_figures(people({"name": "random_waypoint"}, 5))},
    ("actors", "random_waypoint"): {"walker": people({"name": "random_waypoint"}, 5)},
    ("actors", "social_force"): {"walker": people({"name": "social_force"}, 8, 1.5)},
    ("actors", "tractor"): {
        "tractor": roaming(TractorConf(), 1, **(TRAFFIC | {"speed_mps": 1.5, "range_m": 12.0}))
    },
    ("actors", "trucks"): {"truck": roaming(TruckConf(), 2, speed_mps=2.5, **TRAFFIC)},
    ("learning", "imitation"): ImitationConf(),
    ("learning", "crossq"): CrossqConf(),
    ("learning", "discrete_sac"): DiscreteSacConf(),
    ("learning", "ppo"): PpoConf(),
    ("learning", "sac"): SacConf(),
    ("metrics", "paper"): MetricsConf(),
    ("metrics", "dune_code"): MetricsConf(terms={**PAPER_METRICS, **DUNE_CODE_METRICS}),
    ("metrics", "navigation"): MetricsConf(terms={**PAPER_METRICS, **NAVIGATION}),
    ("metrics", "vort"): MetricsConf(terms={**PAPER_METRICS, **VORT_METRICS}),
    ("physics", "bullet"): PhysicsConf(),
    ("randomisation", "none"): RandomisationConf(),
    ("randomisation", "worlds"): WORLDS,
    ("randomisation", "body"): BODY,
    ("randomisation", "everything"): RandomisationConf(**(WORLDS.distributions | BODY.distributions)),
    ("physics", "dart"): PhysicsConf(backend="dart"),
    ("robot", "hyperdog"): HyperDogConf(),
    ("robot", "leo_rover"): LeoRoverConf(),
    ("robot", "rover_zero"): RoverZeroConf(),
    ("robot", "urdf"): UrdfConf(path=GIVEN),
    ("sensors", "default"): default_sensors(),
    ("sensors", "camera"): parse_sensors(["camera", "lidar", "lidar_past", "imu", "goal", "velocity"]),
    ("sensors", "all"): parse_sensors(
        {
            "enabled": [
                *("camera", "lidar", "lidar_past", "lidar_3d", "depth_strip", "height_scan", "imu", "goal"),
                *("velocity", "encoders", "odometry", "currents", "position"),
            ],
            "camera": {"outputs": ["rgb", "depth", "segmentation", "normals", "grey"]},
            "lidar_3d": {"outputs": ["range", "intensity", "segmentation"]},
        }
    ),
    ("sensors", "perception"): perception_sensors(n_segments=64),
    ("sensors", "perception_3d"): perception_sensors(n_segments=64, rings_deg=[-15, -10, -5, 0, 5, 10, 15]),
    ("sensors", "walker"): walker_sensors(),
    ("task", "point_goal"): TaskConf(),
    ("task", "dune_code"): with_terms(
        TaskConf(),
        rewards={
            "distance": {
                "min_progress_m": 0.001,
                "signed": True,
                "heading_limit_deg": 72.0,
                "misaligned": -0.03,
            },
            "heading": {"bonus": 0.0},
            "velocity": {"turn_scale": 0.0015},
            "stuck": {"weight": -25.0},
            "flipped": {"weight": -20.0},
            "out_of_world": {"weight": -10.0},
            "collision": {"term": "scan_collision", "distance_m": 0.3},
            "contact": {"weight": 0.0},
            "long_collision": {"term": "ended_by", "termination": "long_collision", "weight": -20.0},
        },
        terminations={
            "goal_reached": {"distance_m": 0.5, "renew": True},
            "stuck": {"distance_m": 0.001, "steps": 600},
            "long_collision": {"distance_m": 0.3, "steps": 600},
            "time_limit": {"truncates": False},
        },
    ),
    ("task", "clean_goal"): with_terms(
        TaskConf(),
        rewards={
            "progress": {"weight": 1.0},
            **{name: {"weight": 0.0} for name in ("distance", "heading", "velocity", "collision")},
            "goal": {"weight": 5.0},
            **{name: {"weight": -5.0} for name in ("contact", "stuck", "flipped", "out_of_world")},
            "smoothness": {"weight": 0.0},
        },
        terminations={"contact": {}},
    ),
    ("task", "paper"): with_terms(TaskConf(), rewards={"contact": {"weight": 0.0}}),
    ("sensors", "actor"): actor_sensors(),
    ("sensors", "adversary"): actor_sensors(goals=True),
    ("task", "walking"): walking_task(),
    ("task", "cooperative"): COOPERATIVE,
    ("task", "indifferent"): TaskConf.model_validate(
        {"rewards": {"progress": {}, "goal": ARRIVAL}, "terminations": TO_AND_FRO}
    ),
    ("task", "adversarial"): TaskConf.model_validate(
        {
            "rewards": {
                "closing_in": {"weight": 3.0, "ahead_m": 1.0},
                "blocking": {"weight": 0.3, "ahead_m": 2.5, "width_m": 1.0},
                "robot_progress": {"weight": -1.0},
                "ran_into_robot": {"weight": -5.0, "min_speed_mps": 0.05, "pushing": 0.1},
                "hit_by_robot": {"weight": 10.0, "min_speed_mps": 0.05},
            },
            "terminations": TO_AND_FRO,
        }
    ),
    ("weather", "clear"): WeatherConf(),
    ("weather", "dusk"): WeatherConf(light=LightConf(sun_bearing_deg=195.0, sun_elevation_deg=6.0)),
    ("weather", "dust"): WeatherConf(dust_visibility_m=30.0),
    ("weather", "fog"): WeatherConf(fog_visibility_m=50.0),
    ("world", "construction"): ConstructionConf(),
    ("world", "flat"): FlatConf(),
    ("world", "heightmap"): HeightmapConf(path=GIVEN),
    ("world", "island"): IslandConf(),
    ("world", "mixed"): MixedConf(),
    ("world", "obstacle_course"): ObstacleCourseConf(),
    ("world", "mesh"): MeshConf(path=GIVEN),
    ("world", "rubicon"): RubiconConf(),
    ("world", "sdf"): SdfConf(path=GIVEN),
    ("world", "inspection"): InspectionConf(),
}


def words(group: str, option: str) -> list[str]:
    return [f"{group}={option}"] if group == "world" else [f"+world={place(group)}", f"{group}={option}"]


def place(group: str) -> str:
    """A world in which every option of the group makes sense: what is drawn from a seed needs one."""
    return "inspection" if group == "randomisation" else "flat"


@pytest.mark.slow(all_but=["actors-none", "sensors-perception", "task-walking", "world-construction"])
@pytest.mark.parametrize(("group", "option"), OPTIONS)
def test_hydra_and_plain_objects_agree(group: str, option: str) -> None:
    if group == "learning":
        composed: EnvConf = compose(Conf, words(group, option))
    else:
        words_given = [f"{group}.path={GIVEN}"] if hasattr(PLAIN[group, option], "path") else []
        composed = compose_environment(
            option if group == "world" else place(group), words_given, {group: option}
        )
    found = composed.groups[0].body if group == "robot" else getattr(composed, group)
    assert found == PLAIN[group, option]


# The defaults of sensors stand in their settings classes.
@pytest.mark.parametrize(("group", "option"), [each for each in OPTIONS if each[0] != "sensors"])
def test_yaml_states_every_setting(group: str, option: str) -> None:
    stated = yaml.safe_load((CONF / group / f"{option}.yaml").read_text())
    plain = PLAIN[group, option]
    if isinstance(plain, dict):
        plain = EnvConf(world=FlatConf(), actors=plain)
        stated = {"actors": stated}
        settings = leaves({"actors": {name: each.model_dump() for name, each in plain.actors.items()}})
        inherits = "defaults" in stated["actors"]
        stated["actors"].pop("defaults", None)
        # A name stands for all settings of that option.
        named = {f"actors.{each}.{part}" for each in plain.actors for part in ("sensors", "task", "metrics")}
        # A task may be the environment's but for what is stated.
        changed = tuple(
            f"actors.{name}.task." for name, group in stated["actors"].items() if group.get("task")
        )
        settings = {key for key in settings if not key.startswith(changed)} | {
            key for key in leaves(stated) if key.startswith(changed)
        }
    else:
        settings = leaves(plain.model_dump())
        inherits = "defaults" in stated
        stated.pop("defaults", None)
        # A term of the other option is left out by null.
        named = {f"rewards.{name}" for name, term in stated.get("rewards", {}).items() if term is None}
    if inherits:
        # It changes another option, which states the rest; a mark of default actors is no setting.
        assert leaves(stated) - {f"actors.walker.{MARK}"} - named < settings
    else:
        assert leaves(stated) | ({"path"} & settings) | of_every_term(settings) == settings


def of_every_term(paths: set[str]) -> set[str]:
    """The settings that every term has: they are explained once, at the head of its section."""
    own = {"term", "weight", "unless", "truncates", "renew", "reduce", "initial"}
    return {path for path in paths if path.rpartition(".")[2] in own}


def leaves(data: dict[str, Any], prefix: str = "") -> set[str]:
    found: set[str] = set()
    for name, value in data.items():
        found |= leaves(value, f"{prefix}{name}.") if isinstance(value, dict) and value else {prefix + name}
    return found


def test_every_yaml_line_with_a_first_use_is_explained() -> None:
    for path in CONF.glob("*/*.yaml"):
        assert path.read_text().startswith("# "), f"{path} does not say what it is"


def test_root_settings_agree() -> None:
    composed = compose(Conf, ["+world=flat"])
    plain = Conf(world=FlatConf(), actors={"walker": WALKERS}, run_dir=composed.run_dir)
    assert composed == plain
    evaluation = compose(EvaluateConf, ["+world=flat", "policy=random"])
    assert evaluation == EvaluateConf(world=FlatConf(), actors={"walker": WALKERS}, policy="random")
