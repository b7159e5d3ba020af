"""The environment of a dataset, as Gymnasium makes it again from the settings that the dataset holds."""

from collections.abc import Mapping
from typing import Any, Literal

from gymnasium.envs.registration import EnvSpec

from dune_rl.config.build import make_gymnasium_env
from dune_rl.config.checks import validate
from dune_rl.config.commands import EvaluateConf
from dune_rl.config.schema import EnvConf, SingleAgentConf
from dune_rl.core.errors import ConfigError
from dune_rl.env.gymnasium import GymnasiumEnv
from dune_rl.env.registration import RENDER_METADATA
from dune_rl.evaluation.episode_sets.apply import plan_of_set
from dune_rl.evaluation.episode_sets.files import EpisodeSet, read_episode_set

ENV_ID = "dune_rl/Recorded-v0"


def environment_settings(conf: EvaluateConf) -> dict[str, Any]:
    """The settings of the environment of an evaluation alone, as plain data."""
    return conf.model_dump(mode="json", include=set(EnvConf.model_fields))


def environment_spec(conf: EvaluateConf, episode_set: EpisodeSet | None) -> EnvSpec:
    """What `gymnasium.make` needs to make the environment of an evaluation; it can be written as JSON."""
    used = None if episode_set is None else {"name": conf.set, "sha256": episode_set.header.sha256}
    settings = {"settings": environment_settings(conf), "seed": conf.seed, "episode_set": used}
    return EnvSpec(ENV_ID, entry_point=f"{__name__}:make_recorded_env", kwargs=settings)


def make_recorded_env(
    settings: Mapping[str, Any],
    seed: int,
    episode_set: Mapping[str, str] | None = None,
    *,
    render_mode: Literal["human", "rgb_array"] | None = None,
    flatten: bool = False,
) -> GymnasiumEnv:
    """A Gymnasium environment with the `settings`, episodes and seed of a dataset.

    `reset(seed=seed, options={"episode": k})` starts its episode k. Raises ConfigError where the settings do
    not fit this version, or the episode set is another one.
    """
    conf, plan = validate(SingleAgentConf, settings), None
    if episode_set is not None:
        used = read_episode_set(episode_set["name"])
        if used.header.sha256 != episode_set["sha256"]:
            raise ConfigError(
                f"the dataset was made with another set {used.name}: its checksum was "
                f"{episode_set['sha256'][:12]}, and is {used.header.sha256[:12]} now; get the set of then"
            )
        plan = plan_of_set(conf, used)
    return make_gymnasium_env(conf, seed, render_mode, flatten, plan)


make_recorded_env.metadata = RENDER_METADATA  # type: ignore[attr-defined]
