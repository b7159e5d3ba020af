"""Columns of result files: their units and meaning."""

from collections.abc import Sequence

from dune_rl.metrics.catalogue import CATALOGUE

_FIXED: dict[str, tuple[str, str]] = {
    "policy": ("", "name of the policy, as in provenance.json"),
    "set": ("", "name of the episode set; empty without one"),
    "world": ("", "name of the world"),
    "world_file": ("", "file of the world, from the folder of the set"),
    "engine": ("", "physics engine"),
    "seed": ("", "seed of the episodes"),
    "agent": ("", "name of the agent"),
    "episode": ("", "number of the episode: all its random draws depend on it and on the seed"),
    "world_seed": ("", "seed of the episode's world; in a set of several files, the number of its file"),
    "run": ("", "number of the run of a protocol"),
    "finished": ("", "1, or 0 for an episode that was cut off with its run"),
    "steps": ("", "control steps"),
    "step": ("", "control step, from 1 on"),
    "return": ("", "sum of rewards"),
    "reward": ("", "reward of the step"),
    "start_x_m": ("m", "position at the start, world frame"),
    "start_y_m": ("m", "position at the start, world frame"),
    "start_yaw_rad": ("rad", "heading at the start"),
    "goal_x_m": ("m", "first goal, world frame"),
    "goal_y_m": ("m", "first goal, world frame"),
    "time_s": ("s", "time since the start"),
    "x_m": ("m", "position, world frame"),
    "y_m": ("m", "position, world frame"),
    "z_m": ("m", "position, world frame"),
    "roll_rad": ("rad", "roll"),
    "pitch_rad": ("rad", "pitch"),
    "yaw_rad": ("rad", "heading"),
    "speed_mps": ("m/s", "forward speed"),
    "yaw_rate_radps": ("rad/s", "yaw rate"),
    "goal_distance_m": (
        "m",
        "horizontal distance to the goal; of an episode: from its start to the first goal",
    ),
    "slope_deg": ("°", "steepest ground on the straight line from the start to the first goal"),
    "clearance_m": ("m", "distance of the outline to the nearest obstacle or agent"),
    "collisions_so_far": ("", "collisions since the start"),
}
# Metrics of every episode that are no measure by themselves; see dune_rl/metrics/episode.py.
_PLAIN_METRICS: dict[str, tuple[str, str]] = {
    "goals": ("", "number of goals reached"),
    "min_clearance": ("m", "smallest obstacle clearance"),
    "diverged": ("", "1 if the episode ended as the physics diverged"),
    "stuck": ("", "1 if the episode ended as the robot was stuck"),
    "flipped": ("", "1 if the episode ended as the robot was flipped"),
    "out_of_world": ("", "1 if the episode ended as the robot left the world"),
    "timeout": ("", "1 if the episode ended at its limit of steps"),
}
# Metrics whose column is a sum that their measure divides.
_SUMS: dict[str, tuple[str, str]] = {
    "duration": ("s", "time of the episode"),
    "risk_seconds": ("s", "time near agents of the chosen groups, weighted by nearness"),
    "seconds_at_risk": ("s", "time within the distance of risk"),
    "dune_code_successes": ("", "attempts that reach the goal, of those that the published code counts"),
    "dune_code_attempts": ("", "attempts that the published code counts"),
    "dune_code_goal_time": ("s", "sum of the times of attempts that reach the goal"),
    "dune_code_collisions": ("", "scans with a return nearer than the distance of a collision"),
    "dune_code_clearance": ("m", "sum over rows of the mean of the last nearest returns"),
    "dune_code_clearance_rows": ("", "rows of the published code's log with a clearance"),
    "dune_code_speed": ("m/s", "sum over rows of the mean of the last speeds"),
    "dune_code_rough_speed": ("m/s", "the same over rough rows"),
    "dune_code_rough_rows": ("", "rough rows"),
    "dune_code_smoothness": ("", "sum over rows of the mean of the last |acceleration| + |angular velocity|"),
    "dune_code_rows": ("", "rows of the published code's log"),
    "dune_code_vertical": ("m/s²", "sum over steps of |vertical acceleration| with gravity"),
}
_UNITLESS = ("", "%")


def describe_columns(names: Sequence[str]) -> list[dict[str, str]]:
    """For each column its name, unit (empty: none) and meaning."""
    measures = {measure.metric: measure for measure in CATALOGUE}
    found = []
    for name in names:
        unit, meaning = (_PLAIN_METRICS | _SUMS | _FIXED).get(name, ("", ""))
        if name in measures and name not in _FIXED and name not in _SUMS:
            measure = measures[name]
            # Shares are stored as 0 and 1.
            unit, meaning = "" if measure.unit in _UNITLESS else measure.unit, measure.meaning
        elif name.startswith("reward/"):
            meaning = f"sum of the reward term {name.partition('/')[2]}"
        elif name.startswith("randomisation/"):
            meaning = f"sampled value of {name.partition('/')[2]}"
        elif name.startswith("action_"):
            meaning = "action component, in its own unit"
        found.append({"column": name, "unit": unit, "meaning": meaning})
    return found


def measured_columns(names: Sequence[str]) -> list[str]:
    """The columns that measure the agent: without ids, places and what was drawn or earned.

    The steps are among them, by which sums over an episode are divided.
    """
    return [name for name in names if (name not in _FIXED or name == "steps") and "/" not in name]
