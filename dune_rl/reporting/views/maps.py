"""Maps of a world, with the starts and goals of episodes and the tracks of all agents."""

from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import Progress
from torch import no_grad

from dune_rl.config.build import build_world, group_setups, make_torchrl_env
from dune_rl.config.commands import ViewConf
from dune_rl.config.controllers import reads_sensors
from dune_rl.core.files import write_atomically
from dune_rl.env.agent_group import AgentGroup
from dune_rl.env.assembly import build_groups
from dune_rl.env.domain_randomizer import DomainRandomizer
from dune_rl.env.requests import EpisodePlan
from dune_rl.env.scene_manager import SceneManager
from dune_rl.env.starts.episode_start import EpisodeStarter
from dune_rl.env.starts.placement import draw_starts
from dune_rl.evaluation.policies import checkpoint_name
from dune_rl.geometry.arrays import Array
from dune_rl.physics.interface import scene_maker
from dune_rl.reporting.views.episode import SENSORS_OF_POLICIES, find_agent, policy_factory
from dune_rl.reporting.views.tracks import TrackRecorder
from dune_rl.sensors.conf import parse_sensors
from dune_rl.tasks.spawn import Placement, SpawnConf
from dune_rl.visualization.site_map.colours import OBSTACLES, PATHS
from dune_rl.visualization.site_map.figure import draw_site_map
from dune_rl.visualization.site_map.layers import choose_spread_episodes, prop_footprints
from dune_rl.visualization.site_map.panel import MapContent, Track

_MOST_SCENES = 16
# Distance between the ends of example episodes, relative to the region's side.
_APART = 0.15


def write_map(conf: ViewConf, path: Path, console: Console, plan: EpisodePlan | None = None) -> Path:
    """A map of the world of `conf` (PNG); with a checkpoint or policy, also the tracks of its episodes.

    With a `plan`, its episode `conf.episode` is the only one.
    """
    tracks = drive_episodes(conf, console, plan) if conf.checkpoint or conf.policy else []
    content = map_content(conf, tracks, plan)
    figure = draw_site_map(content, title(conf), subtitle(conf), conf.dpi)
    with write_atomically(path) as temporary:
        # Without the drawing library's version, the file stays the same when that changes.
        figure.savefig(temporary, format="png", dpi=conf.dpi, metadata={"Software": None})
    return path


def map_content(conf: ViewConf, tracks: list[Track], plan: EpisodePlan | None = None) -> MapContent:
    """Content of the map: an episode of a `plan`, those of `tracks`, or examples with distant goals."""
    setups = group_setups(conf)
    world = build_world(conf.world)
    nothing_drawn, engine = DomainRandomizer.none(world, conf.weather), scene_maker(conf.physics.backend)
    scenes = SceneManager(world, conf.weather, nothing_drawn, engine, conf.physics, num_scenes=1)
    groups = build_groups(setups, scenes)
    EpisodeStarter(groups, scenes).check(conf.seed, world, sets_starts=True)
    # The group whose region and free space the map shows: by default the first external one.
    viewed, _ = find_agent(groups, conf.agent)
    spawner = viewed.spawners.of(world)

    def place_robots(episode: int) -> list[Placement]:
        return draw_starts(groups, world, conf.seed, episode)

    if plan is not None:
        episodes = {conf.episode: _planned(plan, conf.episode)}
    elif tracks:
        episodes = {number: place_robots(number) for number in sorted({track.episode for track in tracks})}
    else:
        xmin, xmax, ymin, ymax = spawner.region
        apart_m = _APART * max(xmax - xmin, ymax - ymin)
        episodes = choose_spread_episodes(place_robots, conf.episodes, apart_m)
    spawn = SpawnConf() if viewed.setup.task is None else viewed.setup.task.spawn
    return MapContent(
        world=world,
        spawner=spawner,
        max_slope_deg=spawn.max_slope_deg,
        goal_distance_m=(0.0 if viewed.setup.task is None else viewed.setup.task.goal_reached_m) or 0.0,
        footprints=prop_footprints(world, len(OBSTACLES)),
        paths=_example_paths(groups),
        episodes=episodes,
        tracks=tracks,
    )


def _planned(plan: EpisodePlan, episode: int) -> list[Placement]:
    ways = [(one.start, one.goal) for one in plan.of(episode).request.values()]
    return [Placement(start[0], start[1], start[2] or 0.0, *goal) for start, goal in ways if start and goal]


def _example_paths(groups: tuple[AgentGroup, ...]) -> list[Array]:
    """Some of the paths (P, 2) [m] of each agent that starts on a path."""
    agents = [group.starts.example_paths(agent) for group in groups for agent in range(group.count)]
    on_paths = [paths for paths in agents if paths]
    each = max(1, len(PATHS) // max(1, len(on_paths)))
    return [path for paths in on_paths for path in paths[:each]]


@no_grad()
def drive_episodes(conf: ViewConf, console: Console, plan: EpisodePlan | None = None) -> list[Track]:
    """Run episodes of the seed, or of a `plan`, from `conf.episode` on; returns the tracks of all agents."""
    last = conf.episode + (conf.episodes if plan is None else 1)
    scenes = min(last - conf.episode, _MOST_SCENES)
    env = make_torchrl_env(_with_needed_sensors(conf), scenes, conf.seed, plan=plan)
    simulation = env.simulation
    tracks: dict[int, list[Track]] = {}
    try:
        policy = policy_factory(conf, env)()
        with Progress(console=console, disable=not console.is_terminal, transient=True) as bar:
            task = bar.add_task("driving", total=last - conf.episode)
            env.start_at(conf.seed, conf.episode)
            observation = env.reset()
            recorder = TrackRecorder(simulation)
            while True:
                after = env.step(policy(observation))
                recorder.update()
                done = np.flatnonzero(after["next", "done"].reshape(-1).numpy()).tolist()
                for scene in done:
                    episode = int(simulation.episodes[scene])
                    if episode < last:
                        tracks[episode] = recorder.tracks(scene)
                bar.update(task, completed=len(tracks))
                if len(tracks) == last - conf.episode:
                    break
                observation = env.maybe_reset(env.step_mdp(after))
                for scene in done:
                    recorder.reset(scene)
    finally:
        env.close()
    return [track for episode in sorted(tracks) for track in tracks[episode]]


def _with_needed_sensors(conf: ViewConf) -> ViewConf:
    """`conf` with only the sensors that a built-in policy reads, where nothing else reads any."""
    if conf.checkpoint is not None or any(reads_sensors(group.controller) for group in conf.groups):
        return conf
    needed = SENSORS_OF_POLICIES.get(conf.policy or "", ("goal",))
    if needed is None:
        return conf
    return conf.model_copy(update={"sensors": parse_sensors({**conf.sensors, "enabled": needed})})


def title(conf: ViewConf) -> str:
    """The world's name, with the name of its file if it is read from one."""
    path = getattr(conf.world, "path", None)
    return conf.world.name if path is None else f"{conf.world.name}: {Path(path).name}"


def subtitle(conf: ViewConf) -> str:
    """The policy, the seed or the set of the episodes, and the settings of the world: of a set, its seed."""
    shown_alone = {"seed"} if conf.set else None
    chosen = conf.world.model_dump(include=shown_alone, exclude={"name", "path"}, exclude_none=True)
    settings = ", ".join(f"{name} {_plain(value)}" for name, value in chosen.items() if value not in ((), []))
    policy: str | None = conf.policy
    if conf.checkpoint is not None:
        policy = f"policy of {checkpoint_name(Path(conf.checkpoint))}"
    head = f"{policy}, " if policy else ""
    shown = f"episode {conf.episode} of {conf.set}" if conf.set else f"episodes of seed {conf.seed}"
    return head + shown + (f"; world: {settings}" if settings else "")


def _plain(value: object) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_plain(each) for each in value) + "]"
    return str(value)
