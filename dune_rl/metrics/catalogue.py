"""The measures that evaluations report: what each means, and which metric of an episode it comes from."""

from collections.abc import Sequence

from dune_rl.metrics.episode import BUILT_IN
from dune_rl.metrics.measure import PAPER as _PAPER
from dune_rl.metrics.measure import Measure
from dune_rl.metrics.protocol_measures import PROTOCOL_MEASURES

__all__ = ["CATALOGUE", "Measure", "measure_of", "measures_of"]

CATALOGUE: tuple[Measure, ...] = (
    Measure(
        "SR",
        "success",
        "goal reached without collision",
        "%",
        "higher",
        "1 if the goal is reached and nothing was touched, else 0",
        _PAPER,
        is_share=True,
        scale=100.0,
        decimals=1,
    ),
    Measure(
        "TR",
        "reached",
        "goal reached",
        "%",
        "higher",
        "1 if the goal is reached, else 0",
        _PAPER,
        is_share=True,
        scale=100.0,
        decimals=1,
    ),
    Measure(
        "TC",
        "collisions",
        "collisions per episode",
        "",
        "lower",
        "number of contacts that begin, one for each body; one that is touched again within 1 s counts once",
        _PAPER,
        are_counts=True,
    ),
    Measure(
        "MTT",
        "time_to_goal",
        "mean time to traverse",
        "s",
        "lower",
        "time from the start to the first goal, with or without collisions; episodes that reach one",
        _PAPER,
    ),
    Measure(
        "OC",
        "clearance",
        "obstacle clearance",
        "m",
        "higher",
        "mean over time of min(distance of the outline to the nearest obstacle or agent, 12 m)",
        _PAPER,
    ),
    Measure(
        "VR",
        "vertical_roughness",
        "vertical roughness",
        "m/s²",
        "lower",
        "mean over time of |acceleration along the body's z| without gravity, of control steps",
        _PAPER,
    ),
    Measure(
        "VORT",
        "vort",
        "velocity over rough terrain",
        "m/s",
        "higher",
        "mean horizontal speed while the tilt is above uneven_tilt_deg (5°); episodes that meet such ground",
        _PAPER,
    ),
    Measure(
        "TSR",
        "smoothness",
        "smoothness of route",
        "",
        "lower",
        "mean over time of |acceleration| [m/s²], without gravity, + |angular velocity| [rad/s]",
        _PAPER,
    ),
    Measure(
        "SPL",
        "spl",
        "success weighted by path length",
        "",
        "higher",
        "success x d / max(path, d), d the straight distance from start to goal: a lower bound of the SPL by "
        "shortest paths",
        "Anderson et al. 2018",
    ),
    Measure(
        "path", "path_length", "path length", "m", None, "sum of the horizontal steps", "Anderson et al. 2018"
    ),
    Measure("speed", "mean_speed", "mean speed", "m/s", None, "mean horizontal speed"),
    Measure("roll", "roll", "mean |roll|", "°", "lower", "mean over time of |roll|"),
    Measure("max roll", "max_roll", "largest |roll|", "°", "lower", "maximum over time of |roll|"),
    Measure("pitch", "pitch", "mean |pitch|", "°", "lower", "mean over time of |pitch|"),
    Measure("max pitch", "max_pitch", "largest |pitch|", "°", "lower", "maximum over time of |pitch|"),
    Measure(
        "jerk",
        "jerk",
        "jerk",
        "m/s³",
        "lower",
        "mean over time of |change of the acceleration between control steps| / step, all axes",
        "Francis et al. 2023",
    ),
    Measure(
        "slip",
        "slip",
        "longitudinal slip",
        "",
        "lower",
        "mean over time of |r w - v| / max(|r w|, |v|), while the faster is above 0.1 m/s",
        "Wong, Theory of Ground Vehicles",
    ),
    Measure("contact", "time_in_collision", "time in collision", "s", "lower", "time with something touched"),
    Measure(
        "near misses",
        "near_misses",
        "near misses per episode",
        "",
        "lower",
        "spells with a time to contact below 1 s at constant velocities, in which nothing is touched",
        "Hayward 1972",
        are_counts=True,
    ),
    Measure(
        "gap",
        "actor_gap",
        "gap to the nearest agent",
        "m",
        "higher",
        "mean over time of the gap between discs, from 0 to 12 m",
        "Francis et al. 2023",
    ),
    Measure(
        "min gap",
        "min_actor_gap",
        "smallest gap to an agent",
        "m",
        "higher",
        "minimum over time of the gap, from 0 to 12 m",
        "Francis et al. 2023",
    ),
    Measure(
        "intrusion",
        "intrusion",
        "time in personal space",
        "s",
        "lower",
        "time with a gap below 1.2 m to an agent",
        "Hall 1966; Francis et al. 2023",
    ),
    Measure(
        "s/goal",
        "duration",
        "seconds per goal",
        "s",
        "lower",
        "time of all episodes / goals reached in them",
        "the DUnE authors' later study",
        per="goals",
    ),
    Measure(
        "risk/goal",
        "risk_seconds",
        "seconds near agents by nearness, per goal",
        "s",
        "lower",
        "sum over time of max(0, 1 - gap / 1 m) / goals reached; not the risk-seconds of the later study",
        "",
        per="goals",
    ),
    Measure(
        "at risk/goal",
        "seconds_at_risk",
        "risk-seconds per goal: within 0.5 m",
        "s",
        "lower",
        "time with a gap below 0.5 m to an agent / goals reached",
        "the DUnE authors' later study",
        per="goals",
    ),
    Measure(
        "enc <0.5",
        "encounters_intimate",
        "encounters closer than 0.5 m",
        "",
        "lower",
        "spells with a gap below 1.2 m whose smallest gap is below 0.5 m",
        "the DUnE authors' later study",
        are_counts=True,
    ),
    Measure(
        "enc <0.8",
        "encounters_personal",
        "encounters of 0.5 to 0.8 m",
        "",
        None,
        "spells with a gap below 1.2 m whose smallest gap is 0.5 to 0.8 m",
        "the DUnE authors' later study",
        are_counts=True,
    ),
    Measure(
        "enc <1.2",
        "encounters_social",
        "encounters of 0.8 to 1.2 m",
        "",
        None,
        "spells with a gap below 1.2 m whose smallest gap is 0.8 to 1.2 m",
        "the DUnE authors' later study",
        are_counts=True,
    ),
    Measure(
        "TC static",
        "collisions_static",
        "collisions with what never moves",
        "",
        "lower",
        "number of contacts with what never moves that begin, one for each body",
        "",
        are_counts=True,
    ),
    Measure(
        "TC robot",
        "collisions_robot",
        "collisions with other robots",
        "",
        "lower",
        "number of contacts with other robots that begin, one for each body",
        "",
        are_counts=True,
    ),
    Measure(
        "TC person",
        "collisions_person",
        "collisions with persons",
        "",
        "lower",
        "number of contacts with persons that begin, one for each body",
        "",
        are_counts=True,
    ),
    Measure(
        "TC vehicle",
        "collisions_vehicle",
        "collisions with vehicles",
        "",
        "lower",
        "number of contacts with vehicles that begin, one for each body",
        "",
        are_counts=True,
    ),
    Measure(
        "TC animal",
        "collisions_animal",
        "collisions with animals",
        "",
        "lower",
        "number of contacts with animals that begin, one for each body",
        "",
        are_counts=True,
    ),
    Measure(
        "TC drone",
        "collisions_drone",
        "collisions with drones",
        "",
        "lower",
        "number of contacts with drones that begin, one for each body",
        "",
        are_counts=True,
    ),
    Measure(
        "stuck",
        "stuck_count",
        "times stuck",
        "",
        "lower",
        "number of ends by the termination stuck",
        are_counts=True,
    ),
    Measure(
        "flips",
        "flip_count",
        "times flipped",
        "",
        "lower",
        "number of ends by the termination flipped",
        are_counts=True,
    ),
    Measure(
        "uneven",
        "uneven_time",
        "time on uneven ground",
        "s",
        None,
        "time while the tilt is above uneven_tilt_deg (5°), which is that of VORT",
    ),
    Measure("energy", "energy_wh", "drawn from the battery", "W h", "lower", "motors' work and idling"),
    Measure(
        "battery", "battery_share", "share of a full battery", "%", "lower", "energy / capacity", scale=100.0
    ),
    Measure("range", "range_km", "with a full battery", "km", "higher", "path / share of the battery"),
    *PROTOCOL_MEASURES,
)

_BY_NAME = {measure.name: measure for measure in CATALOGUE}


def measure_of(name: str) -> Measure:
    """The measure of a name; users' own have none but the name."""
    return _BY_NAME.get(name, Measure(name, name))


# Metrics of which no measure is made: ids, and details that the CSV has.
_DETAILS = {
    "agent",
    *BUILT_IN,
    "set",
    "world",
    "seed",
    "world_seed",
    "goals",
    "min_clearance",
    "diverged",
    "stuck",
    "flipped",
    "out_of_world",
    "timeout",
    # Those of the published code are sums, which only mean something when they are divided.
    *("dune_code_attempts", "dune_code_clearance_rows", "dune_code_rough_rows", "dune_code_rows"),
}


def measures_of(metrics: Sequence[str]) -> list[Measure]:
    """The measures that metrics of these names give: those of the catalogue, then users' own by their names.

    Names with a slash (reward terms and what was drawn at random) give none.
    """
    known = [
        measure
        for measure in CATALOGUE
        if measure.metric in metrics and (measure.per is None or measure.per in metrics)
    ]
    taken = {measure.metric for measure in CATALOGUE} | _DETAILS
    own = [Measure(name, name) for name in metrics if name not in taken and "/" not in name]
    return [*known, *own]
