"""Settings of evaluations by a protocol."""

from collections.abc import Sequence

from dune_rl.config.agents import SHARED
from dune_rl.config.checks import validate
from dune_rl.config.commands import MOST_RUN_STEPS, EvaluateConf
from dune_rl.config.compose import compose_environment
from dune_rl.core.errors import ConfigError

# What the paper counts as ten minutes; 570 s at its 20 Hz.
DEFAULT_RUN_STEPS = 11_400
DEFAULT_RUNS = 10
# Run r has the episodes from r times this on; a run has fewer, as each has a step at least.
EPISODES_PER_RUN = MOST_RUN_STEPS

_DETERMINED = ("task.rewards", "task.terminations")
_ONE_ROBOT = ("agents", "robots")
_CODE = "dune_code"


def check_protocol_overrides(protocol: str, overrides: Sequence[str]) -> None:
    """Raise ConfigError if `overrides` (words of a command line) set what a protocol determines."""
    for word in overrides:
        key = word.partition("=")[0].lstrip("+~").replace("/", ".")
        determined = [name for name in _DETERMINED if key == name or key.startswith(f"{name}.")]
        if protocol == _CODE and (determined or key == "task"):
            raise ConfigError(
                f"protocol={protocol} determines the rewards and ends of episodes; leave {word} out"
            )
        if key.partition(".")[0] in _ONE_ROBOT:
            raise ConfigError(f"protocol={protocol} is for one robot; take robot=NAME in place of {word}")


def settings_of_protocol(conf: EvaluateConf) -> EvaluateConf:
    """`conf` with the number and length of runs, and with the terms that its protocol needs.

    The paper's protocol leaves the task as it was trained. That of the published code has the rewards and
    terminations of `task=dune_code` and the metrics of `metrics=dune_code` beside those of `conf`. Raises
    ConfigError where several agents are driven.
    """
    external = conf.external_groups
    if [(one.count, conf.agents[one.name].task) for one in external] != [(1, SHARED)]:
        raise ConfigError(
            f"protocol={conf.protocol} is for one robot, and these settings have several agents; evaluate "
            "them with episodes=N"
        )
    data = conf.model_dump(mode="json")
    data["runs"] = conf.runs or DEFAULT_RUNS
    data["run_steps"] = conf.run_steps or DEFAULT_RUN_STEPS
    terms = data["metrics"]["terms"]
    if "vort" in terms and terms["vort"]["term"] == "vort":
        # VORT of a run is a mean over the steps on such ground.
        tilt = terms["vort"]["uneven_tilt_deg"]
        terms["uneven_time"] = {"term": "time_on_uneven", "reduce": "sum", "uneven_tilt_deg": tilt}
    if conf.protocol == _CODE:
        code = compose_environment("flat", [f"task={_CODE}", f"metrics={_CODE}"]).model_dump(mode="json")
        for section in ("rewards", "terminations"):
            data["task"][section] = code["task"][section]
        own = {name: term for name, term in code["metrics"]["terms"].items() if name not in terms}
        terms.update(own)
    return validate(EvaluateConf, data)
