"""Off-road navigation among moving actors: one batched environment, three interfaces.

`parallel_env` gives a PettingZoo environment, `gym_env` a Gymnasium one, `make` a
batched TorchRL one. Each takes every setting that the command lines take.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from dune_rl.core.decorators import RegisterDecorator
from dune_rl.core.errors import (
    CheckpointError,
    ConfigError,
    DuneError,
    PhysicsError,
    RegistryError,
    RobotError,
    WorldError,
)
from dune_rl.core.version import VERSION
from dune_rl.env.registration import RENDER_METADATA, register_env, register_envs

if TYPE_CHECKING:
    from dune_rl.env.gymnasium import GymnasiumEnv
    from dune_rl.env.gymnasium_vector import GymnasiumVectorEnv
    from dune_rl.env.pettingzoo import ParallelDuneEnv
    from dune_rl.env.torchrl import DuneEnv
    from dune_rl.worlds.actor_trajectory import ActorTrajectory

Function = TypeVar("Function", bound=Callable[..., Any])

__all__ = [
    "CheckpointError",
    "ConfigError",
    "DuneError",
    "PhysicsError",
    "RegistryError",
    "RobotError",
    "WorldError",
    "gym_env",
    "gym_vector_env",
    "make",
    "parallel_env",
    "plan_trajectory",
    "register_algorithm",
    "register_behaviour",
    "register_body",
    "register_curriculum",
    "register_encoder",
    "register_engine",
    "register_metric",
    "register_motion_model",
    "register_randomisation",
    "register_reward",
    "register_robot",
    "register_sensor",
    "register_start_source",
    "register_termination",
    "register_world",
    "sensor_bounds",
]
__version__ = VERSION

# Gymnasium 1 reads no entry points: an id is known once the package that registers it is imported, which
# `gymnasium.make("dune_rl:dune_rl/Inspection-v0")` does by itself.
register_envs()

# The functions import what they need when called: torch and the physics engine take seconds to load.


def parallel_env(
    world: str | None = None,
    seed: int = 0,
    *,
    render_mode: Literal["human", "rgb_array"] | None = None,
    flatten: bool = False,
    overrides: Iterable[str] = (),
    config_dirs: Sequence[str] = (),
    **settings: Any,
) -> "ParallelDuneEnv":
    """A PettingZoo `ParallelEnv` of all agents whose group is external: by default `rover_0` alone.

    `agents={"rover": {"body": "rover_zero", "count": 2}, ...}` names the groups
    of a scene. `robot="leo_rover"`, `robots=["rover_zero", {"name": "leo_rover",
    "wheel_friction": 0.8}]` and `actors="external_walkers"` are shorter forms.

    `world` defaults to inspection, or to the world of a `scenario` ("crossing", "crowd", "farm" or
    "site_traffic"). All episodes follow from `seed` and their numbers. `settings` are sections of the
    configuration: a name chooses an option (`task="paper"`), a mapping changes values (`world={"name":
    "flat", "friction": 0.5}`). `overrides` are command-line words (`["world.friction=0.5"]`). `config_dirs`
    are further folders of options, as `--config-dir` has them. With `render_mode="rgb_array"`, `render()`
    gives a picture of the first agent; with "human" a page in a browser shows the scene. With `flatten=True`
    an observation is one vector in place of a dict. Raises `ConfigError` naming every fault.
    """
    from dune_rl.config.build import make_parallel_env
    from dune_rl.config.compose import compose_environment

    conf = compose_environment(world, overrides, settings, config_dirs=config_dirs)
    return make_parallel_env(conf, seed, render_mode, flatten)


def gym_env(
    world: str | None = None,
    seed: int | None = None,
    *,
    render_mode: Literal["human", "rgb_array"] | None = None,
    flatten: bool = False,
    overrides: Iterable[str] = (),
    config_dirs: Sequence[str] = (),
    **settings: Any,
) -> "GymnasiumEnv":
    """A Gymnasium `Env` of the one external agent; arguments as for `parallel_env`.

    Without a `seed`, here or at `reset`, its episodes differ from those of others, as Gymnasium has it.
    """
    if "frameskip" in settings:
        # TorchRL's GymEnv tries it, and repeats actions by itself after this very error.
        raise TypeError(
            "gym_env() got an unexpected keyword argument 'frameskip'; physics.control_hz sets how long an "
            "action lasts"
        )
    from dune_rl.config.build import make_gymnasium_env
    from dune_rl.config.compose import compose_environment
    from dune_rl.config.schema import SingleAgentConf
    from dune_rl.env.arguments import random_seed

    conf = compose_environment(world, overrides, settings, SingleAgentConf, config_dirs=config_dirs)
    return make_gymnasium_env(conf, random_seed() if seed is None else seed, render_mode, flatten)


gym_env.metadata = RENDER_METADATA  # type: ignore[attr-defined]


def gym_vector_env(
    world: str | None = None,
    num_envs: int = 16,
    seed: int | None = None,
    *,
    autoreset_mode: Any = "next_step",
    render_mode: Literal["rgb_array"] | None = None,
    flatten: bool = False,
    max_episode_steps: int | None = None,
    overrides: Iterable[str] = (),
    config_dirs: Sequence[str] = (),
    **settings: Any,
) -> "GymnasiumVectorEnv":
    """A Gymnasium `VectorEnv` of `num_envs` scenes in one process; the other arguments as for `gym_env`.

    `gymnasium.make_vec("dune_rl:dune_rl/Inspection-v0", num_envs=16)` makes one, too. `autoreset_mode` is
    "next_step", "same_step" or "disabled". `max_episode_steps` cuts episodes off as Gymnasium's `TimeLimit`.
    """
    from dune_rl.config.build import make_gymnasium_vector_env
    from dune_rl.config.compose import compose_environment
    from dune_rl.config.schema import SingleAgentConf
    from dune_rl.env.arguments import random_seed

    conf = compose_environment(world, overrides, settings, SingleAgentConf, config_dirs=config_dirs)
    seed = random_seed() if seed is None else seed
    return make_gymnasium_vector_env(
        conf, num_envs, seed, render_mode, autoreset_mode, flatten, max_episode_steps
    )


def make(
    world: str | None = None,
    num_scenes: int = 16,
    seed: int = 0,
    *,
    flatten: bool = False,
    overrides: Iterable[str] = (),
    config_dirs: Sequence[str] = (),
    **settings: Any,
) -> "DuneEnv":
    """A TorchRL environment of batch size (num_scenes,); the other arguments as for `parallel_env`."""
    from dune_rl.config.build import make_torchrl_env
    from dune_rl.config.compose import compose_environment

    conf = compose_environment(world, overrides, settings, config_dirs=config_dirs)
    return make_torchrl_env(conf, num_scenes, seed, flatten)


def plan_trajectory(
    waypoints: Sequence[Sequence[float]],
    world: str = "inspection",
    *,
    overrides: Sequence[str] = (),
    config_dirs: Sequence[str] = (),
    **settings: Any,
) -> "ActorTrajectory":
    """The trajectory of an actor through `waypoints` (n, 2) [m] of a world: its `times` and `poses`.

    `times` (T,) are in s; `poses` (T, 4) are x, y, z [m] and yaw [rad], with z on the ground. `world` is an
    option's name, whose settings are among the `overrides` (`["world.seed=3"]`), or a file. `settings` are
    those of `python -m dune_rl.trajectory`: `velocity`, `mode`, `pauses_s`, `delay_s`, `spacing_m`,
    `radius_m`, `max_slope_deg`, `max_water_m` and `name`. Raises `ConfigError` for settings, and `WorldError`
    that names way-points and stretches between them that cannot be walked.
    """
    from dune_rl.trajectories.settings import plan_in_world

    return plan_in_world(world, waypoints, overrides, config_dirs, settings)


def sensor_bounds(
    *, low: float | tuple[float, ...], high: float | tuple[float, ...], size: int = 1
) -> Callable[[Function], Function]:
    """Decorates a function of (state, group) as a sensor: what it returns, (N, size), lies in [low, high].

    Both may have a number for each entry. Values beyond them are clipped.
    """

    def decorate(function: Function) -> Function:
        # Only now: `dune_rl` itself must import fast.
        from dune_rl.sensors.registry import ReadingBounds

        function.sensor_bounds = ReadingBounds(low, high, size)  # type: ignore[attr-defined]
        return function

    return decorate


register_world = RegisterDecorator("dune_rl.worlds.registry:WORLDS", then=register_env)
register_robot = RegisterDecorator("dune_rl.robots.registry:ROBOTS")
register_engine = RegisterDecorator("dune_rl.physics.interface:ENGINES")
register_body = RegisterDecorator("dune_rl.bodies.registry:BODIES")
register_sensor = RegisterDecorator("dune_rl.sensors.registry:SENSORS")
register_behaviour = RegisterDecorator("dune_rl.behaviours.registry:BEHAVIOURS")
register_reward = RegisterDecorator("dune_rl.tasks.registry:REWARDS")
register_termination = RegisterDecorator("dune_rl.tasks.registry:TERMINATIONS")
register_start_source = RegisterDecorator("dune_rl.tasks.registry:START_SOURCES")
register_motion_model = RegisterDecorator("dune_rl.bodies.motion:MOTION_MODELS")
register_metric = RegisterDecorator("dune_rl.metrics.registry:METRICS")
register_curriculum = RegisterDecorator("dune_rl.env.curriculum:CURRICULA")
register_randomisation = RegisterDecorator("dune_rl.env.randomisation:RANDOMISATIONS")
register_encoder = RegisterDecorator("dune_rl.learning.networks.registry:ENCODERS")
register_algorithm = RegisterDecorator("dune_rl.learning.registry:ALGORITHMS")
