"""The generated parts of pages, by name: `<!-- generated: NAME -->` in a page stands for one of these."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from conf_comments import option_summary, read_comments
from realism_tables import devices_table, faults_table, sensors_table
from settings_tables import Section, Setting, as_code, first_paragraph, read_section, render_section
from vort_table import vort_table

from dune_rl.behaviours.paths.follower import PathConf
from dune_rl.behaviours.registry import BEHAVIOURS
from dune_rl.bodies.person import PersonConf
from dune_rl.bodies.registry import BODIES
from dune_rl.commands.engines import EnginesConf
from dune_rl.commands.pages import PAGES, HelpPage
from dune_rl.commands.report import ReportConf
from dune_rl.config.agents import AgentGroupConf
from dune_rl.config.commands import BenchmarkConf, EvaluateConf, ForecastConf, GazeboConf, RosConf, ViewConf
from dune_rl.config.compose import compose_environment
from dune_rl.config.schema import Conf, EnvConf
from dune_rl.core import paths
from dune_rl.core.registry import Registry
from dune_rl.core.settings import Settings
from dune_rl.env.randomisation import RandomisationConf
from dune_rl.learning.crossq.settings import CrossqConf
from dune_rl.learning.discrete_sac.settings import DiscreteSacConf
from dune_rl.learning.imitation.settings import ImitationConf
from dune_rl.learning.ppo.settings import PpoConf
from dune_rl.learning.sac.settings import SacConf
from dune_rl.learning.settings import LearningConf
from dune_rl.metrics.catalogue import CATALOGUE
from dune_rl.metrics.episode import MetricsConf
from dune_rl.metrics.registry import METRICS
from dune_rl.physics.interface import PhysicsConf
from dune_rl.rendering.weather import WeatherConf
from dune_rl.robots.registry import ROBOTS
from dune_rl.sensors.registry import SENSORS
from dune_rl.sensors.settings import SensorSettings
from dune_rl.tasks.registry import REWARDS, TERMINATIONS
from dune_rl.tasks.task import TaskConf
from dune_rl.trajectories.settings import TrajectoryConf
from dune_rl.worlds.registry import WORLDS
from dune_rl.worlds.surfaces import SURFACES

COMMANDS: Mapping[str, tuple[Any, str]] = {
    "train": (Conf, "train"),
    "evaluate": (EvaluateConf, "evaluate"),
    "forecast": (ForecastConf, "forecast"),
    "export": (GazeboConf, "export"),
    "ros": (RosConf, "ros"),
    "view": (ViewConf, "view"),
    "benchmark": (BenchmarkConf, "benchmark"),
}
SECTIONS: Mapping[str, tuple[Any, str]] = {
    "weather": (WeatherConf, "weather/clear"),
    "physics": (PhysicsConf, "physics/bullet"),
    "randomisation": (RandomisationConf, "randomisation/none"),
}
ALGORITHMS: Mapping[str, type[Settings]] = {
    "sac": SacConf,
    "crossq": CrossqConf,
    "discrete_sac": DiscreteSacConf,
    "ppo": PpoConf,
    "imitation": ImitationConf,
}
# Commands that take no settings of an environment.
_ALONE: Mapping[str, tuple[type[Settings], HelpPage]] = {
    "engines": (EnginesConf, PAGES["engines"]),
    "report": (ReportConf, PAGES["report"]),
    "trajectory": (TrajectoryConf, PAGES["trajectory"]),
}
_TAGS = frozenset({"name", "term", "sensor"})


def command_settings(command: str) -> Section:
    """The settings that a command has beside those of an environment."""
    if command in _ALONE:
        # They have no files in conf/: the help of the command says what its settings mean.
        alone, page = _ALONE[command]
        return read_section(alone, "", {words.split("=")[0]: said for words, said in page.settings})
    model, file = COMMANDS[command]
    own = frozenset(model.model_fields) - frozenset(EnvConf.model_fields) - {"learning"}
    section = read_section(model, "", read_comments(file), only=own)
    # Of the file, which names a new folder for each run.
    known = {"run_dir": "`runs/TIME_WORLD_seedSEED`"}
    section.settings = [
        replace(each, default=known.get(each.path, each.default)) for each in section.settings
    ]
    return section


def section_settings(name: str) -> Section:
    """The settings of a section that is the same whatever option is chosen."""
    model, file = SECTIONS[name]
    return read_section(model, name, read_comments(file), without=frozenset({"name"}))


def algorithm_settings(name: str) -> Section:
    """The settings of `learning` with the algorithm `name`, without those that every algorithm has."""
    model = ALGORITHMS[name]
    own = frozenset(model.model_fields) - frozenset(LearningConf.model_fields)
    return read_section(model, "learning", read_comments(f"learning/{name}"), only=own)


def common_learning_settings() -> Section:
    """The settings of `learning` that every algorithm has; defaults are those of sac."""
    common = frozenset(LearningConf.model_fields) - {"name"}
    comments = read_comments("learning/sac")
    return read_section(SacConf, "learning", comments, only=common, without=frozenset({"name"}))


def sensor_settings() -> Section:
    """The settings of the sensors, without those of their faults."""
    every = frozenset(SensorSettings.model_fields)
    section = read_section(SensorSettings, "sensors.NAME", {})
    section.settings[0] = replace(section.settings[0], default="`NAME`")
    section.sections = [
        inner
        for name in SENSORS.own
        if (
            inner := read_section(SENSORS.settings_class(name), f"sensors.{name}", {}, without=every)
        ).settings
    ]
    return section


def environment_settings() -> Section:
    """`agents`, `robots`, which writes into it, and `shield`: what the agents of a scene are."""
    comments = read_comments("environment")
    section = read_section(EnvConf, "", comments, only=frozenset({"agents", "shield"}))
    section.settings.append(Setting("robots", "`null`", "list of robots, or `null`", comments["robots"]))
    return section


def group_settings() -> Section:
    """The settings of an agent group, of a person's body and of its path."""
    comments = {path.removeprefix("walker."): text for path, text in read_comments("actors/walkers").items()}
    comments["body"] = (
        "a robot or a [body of actors](../../how_to/actors.md): a name, or `{name: NAME}` with settings"
    )
    group = read_section(AgentGroupConf, "agents.NAME", comments, only=frozenset(AgentGroupConf.model_fields))
    group.sections = []
    for name, model in (("body", PersonConf), ("path", PathConf)):
        own = {key.removeprefix(f"{name}."): text for key, text in comments.items()}
        own.setdefault("motion", _BODY_MEANINGS["motion"])
        group.sections.append(read_section(model, f"agents.NAME.{name}", own, without=frozenset({"name"})))
    return group


def spawn_settings() -> Section:
    """The settings of starts and goals."""
    return _only_section(read_section(TaskConf, "task", read_comments("task/point_goal")), "task.spawn")


def metrics_settings() -> Section:
    """The settings of the metrics as a whole."""
    return read_section(MetricsConf, "metrics", read_comments("metrics/paper"))


def part_settings(kind: str) -> Section:
    """The settings of every built-in part of a kind, a section for each part."""
    registry, path, files = KINDS[kind]
    whole = Section("", "")
    for name in registry.own:
        model = registry.settings_class(name)
        assert model is not None
        comments = files(name)
        section = read_section(model, path.replace("NAME", name), comments, without=_TAGS)
        section.about = comments.get("", "") or (model.__doc__ or "")
        whole.sections.append(section)
    return whole


def _option_comments(group: str) -> Callable[[str], dict[str, str]]:
    def read(name: str) -> dict[str, str]:
        summary = option_summary(paths.conf_folder() / group / f"{name}.yaml")
        return {"": summary, **read_comments(f"{group}/{name}")}

    return read


def _robot_comments(name: str) -> dict[str, str]:
    return {"path": "file of the robot's description", **_option_comments("robot")(name)}


def _term_comments(section: str, file: str, common: Mapping[str, str]) -> Callable[[str], dict[str, str]]:
    def read(name: str) -> dict[str, str]:
        comments = read_comments(file)
        inside = f"{section}.{name}."
        own = {path.removeprefix(inside): text for path, text in comments.items() if path.startswith(inside)}
        return {**common, **own}

    return read


_BODY_MEANINGS = {
    "motion": "motion model: its name, or a section with its settings",
    "speed_mps": "top speed [m/s]",
    "max_turn_radps": "how fast it turns [rad/s]",
    "radius_m": "of the capsule that robots can hit [m]",
    "height_m": "height [m]",
    "max_push_n": "largest horizontal force on a robot [N]",
    "max_slope_deg": "steepest ground that it crosses [deg]",
    "max_water_m": "deepest water that it crosses [m]",
    "looks": "what sensors see: a capsule in clothes, or a figure with limbs that swing",
    "clothes": "of figures: alike, or mixed (six outfits in turn)",
}
_REWARD_MEANINGS = {
    "weight": "factor on the term",
    "termination": "name of the termination term",
    "comfort_m": "clearance below which the value grows [m]",
    "own_group": "whether other agents of the own group count too",
    "groups": "names of the groups of robots that count; none: all others do",
    "ahead_m": "how far ahead of the robot, on its way [m]",
    "width_m": "how far beside the robot's way the value falls to 0 [m]",
    "pushing": "value of a further step in which the agent moves on into the robot",
    "min_speed_mps": "slower than this an agent runs into nothing [m/s]",
    "unless": "names of rewards: the term pays nothing in a step in which one of these does",
}
_TERMINATION_MEANINGS = {
    "truncates": "the episode is cut off, which is no end of the task",
    "renew": "the agent gets another goal, and its episode goes on",
    "distance_m": "a return nearer than this is a collision [m]",
    "steps": "how many steps with a collision an episode may have",
}
_METRIC_MEANINGS = {
    "termination": "name of the termination term",
    "reduce": "what makes one value of an episode's steps",
    "initial": "the value before the first step that has one",
    "groups": "names of the groups whose agents count; none: all others do",
    "kinds": "classes of what is touched: static, robot, person, vehicle, animal, drone, or one of one's own",
    "max_m": "the largest gap or clearance that counts [m]",
    "within_m": "gap below which an agent is near [m]",
    "least_m": "smallest gap of the class [m]",
    "most_m": "gap from which on an encounter is of another class [m]",
    "time_s": "time to contact below which it is a near miss [s]",
    "least_mps": "speed below which there is no slip [m/s]",
    "uneven_tilt_deg": "tilt above which ground is uneven [deg]",
    "distance_m": "a return nearer than this is a collision [m]",
    "readings": "how many of the last readings a row is the mean of",
    "every_s": "time between rows [s]",
    "rough_mps2": "acceleration, gravity included, above which a row is rough [m/s²]; null: all rows count",
    "of": "which rows count: all, or those that have a clearance",
    "outcome": "which attempts count: those that reach the goal, or all",
    "reached_s": "an attempt that reaches the goal counts if it lasts longer [s]",
    "failed_s": "an attempt that fails counts if it lasts longer [s]",
}
KINDS: Mapping[str, tuple[Registry[Any], str, Callable[[str], dict[str, str]]]] = {
    "world": (WORLDS, "world=NAME", _option_comments("world")),
    "robot": (ROBOTS, "robot=NAME", _robot_comments),
    "body": (BODIES, "body=NAME", lambda name: _BODY_MEANINGS),
    "reward": (REWARDS, "task.rewards.NAME", _term_comments("rewards", "task/point_goal", _REWARD_MEANINGS)),
    "termination": (
        TERMINATIONS,
        "task.terminations.NAME",
        _term_comments("terminations", "task/point_goal", _TERMINATION_MEANINGS),
    ),
    "metric": (METRICS, "metrics.terms.NAME", _term_comments("terms", "metrics/paper", _METRIC_MEANINGS)),
    "behaviour": (BEHAVIOURS, "controller=NAME", lambda name: {}),
}


def load_parts() -> None:
    """Read the settings of all parts, before autodoc puts texts in the place of their defaults."""
    for registry, _, _ in KINDS.values():
        for name in registry.own:
            registry.settings_class(name)


def _only_section(section: Section, path: str) -> Section:
    (found,) = (each for each in section.sections if each.path == path)
    return found


def options_table(group: str) -> str:
    """The options of a group, each with what the comment at the top of its file says."""
    rows = [
        f"| `{path.stem}` | {as_code(option_summary(path))} |"
        for path in sorted((paths.conf_folder() / group).glob("*.yaml"))
    ]
    return "\n".join(["| option | what it is |", "|---|---|", *rows])


def rewards_table(task: str) -> str:
    """The reward terms of a task: weight, parameters, and what the term's docstring says."""
    conf = compose_environment("flat", [f"task={task}"]).task
    rows = []
    for name, term in conf.rewards.items():
        said = first_paragraph(type(term).__doc__ or "")
        parameters = _parameters(term, {"term", "weight"})
        rows.append(f"| `{name}` | {term.weight:g} | {as_code(said)} | {parameters} |")
    return "\n".join(["| reward | weight | value in a step | parameters |", "|---|---|---|---|", *rows])


def _parameters(term: Settings, without: set[str]) -> str:
    values = term.model_dump(mode="json", exclude=without)
    return "; ".join(f"`{key}` {_shown(value)}" for key, value in values.items() if value != [])


def _shown(value: Any) -> str:
    return (
        ", ".join(value)
        if isinstance(value, list)
        else str(value).lower()
        if value is True or value is False
        else str(value)
    )


def terminations_table(task: str) -> str:
    """The terminations of a task: what the term's docstring says, and whether it truncates."""
    conf = compose_environment("flat", [f"task={task}"]).task
    rows = []
    for name, term in conf.terminations.items():
        said = first_paragraph(type(term).__doc__ or "")
        parameters = _parameters(term, {"term", "truncates", "renew"})
        effect = (
            "another goal"
            if getattr(term, "renew", False)
            else "truncates"
            if term.truncates
            else "terminates"
        )
        rows.append(f"| `{name}` | {effect} | {as_code(said)} | {parameters} |")
    return "\n".join(["| name | effect | when | parameters |", "|---|---|---|---|", *rows])


def surfaces_table() -> str:
    """The contact properties of every surface."""
    rows = [
        f"| {each.name} | {each.friction:g} | {each.restitution:g} | {each.stiffness_npm:.1e} "
        f"| {each.rolling_resistance:g} |"
        for each in SURFACES
    ]
    head = "| surface | friction | restitution | stiffness [N/m] | rolling resistance |"
    return "\n".join([head, "|---|---|---|---|---|", *rows])


def measures_table() -> str:
    """The measures of evaluations, with the metric that each is made of; arrows point to better values."""
    arrows, escaped = {"higher": " ↑", "lower": " ↓"}, "\\|"
    rows = []
    for measure in CATALOGUE:
        of = f"`{measure.metric}`" + (f" / `{measure.per}`" if measure.per else "")
        name = f"**{measure.name}**{arrows.get(measure.better or '', '')}"
        cells = (name, of, measure.meaning, measure.unit, measure.formula, measure.source)
        rows.append(f"| {' | '.join(cell.replace('|', escaped) for cell in cells)} |")
    head = "| name, better | metric | meaning | unit | formula of an episode | source |"
    return "\n".join([head, "|---|---|---|---|---|---|", *rows])


def generated_part(words: str, level: int) -> str:
    """The Markdown that `<!-- generated: WORDS -->` stands for, with headings from `level` on.

    Raises KeyError for words that mean nothing.
    """
    kind, *rest = words.split()
    if kind in _TABLES:
        return _TABLES[kind](*rest)
    return render_section(_SETTINGS[kind](*rest), level)


_SETTINGS: Mapping[str, Callable[..., Section]] = {
    "command": command_settings,
    "section": section_settings,
    "learning": common_learning_settings,
    "algorithm": algorithm_settings,
    "sensors": sensor_settings,
    "environment": environment_settings,
    "group": group_settings,
    "spawn": spawn_settings,
    "metrics": metrics_settings,
    "parts": part_settings,
}
_TABLES: Mapping[str, Callable[..., str]] = {
    "options": options_table,
    "rewards": rewards_table,
    "terminations": terminations_table,
    "surfaces": surfaces_table,
    "measures": measures_table,
    "vort": vort_table,
    "realism-sensors": sensors_table,
    "realism-faults": faults_table,
    "realism-devices": devices_table,
}
