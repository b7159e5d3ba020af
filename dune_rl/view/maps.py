"""Maps of a site, and of where a policy drives on it."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import Progress
from torch import no_grad

from dune_rl.actors.actor import Actors
from dune_rl.config.build import build_robot, build_world, make_torchrl_env
from dune_rl.config.schema import ViewConf
from dune_rl.files import write_atomically
from dune_rl.seeding import stream
from dune_rl.tasks.spawn import Spawner
from dune_rl.view.drivers import driver, ending
from dune_rl.visualization.site_map.colours import OBSTACLES, PATHS
from dune_rl.visualization.site_map.figure import site_map
from dune_rl.visualization.site_map.layers import example_episodes, placements, things
from dune_rl.visualization.site_map.panel import Drive, Site

_MOST_SCENES = 16
# Of the region's side: markers of examples are that far apart.
_APART = 0.15


def write_map(conf: ViewConf, path: Path, console: Console) -> Path:
    """A map of the world of `conf` (PNG); where it names a driver, of its episodes too."""
    site = site_of(conf, drives(conf, console) if conf.checkpoint or conf.policy else [])
    figure = site_map(site, title(conf), subtitle(conf), conf.dpi)
    with write_atomically(path) as temporary:
        # The library's version would make the file another with every one.
        figure.savefig(temporary, format="png", dpi=conf.dpi, metadata={"Software": None})
    return path


def site_of(conf: ViewConf, driven: list[Drive]) -> Site:
    """What the map shows: `driven` episodes, or where there are none, some that lie apart."""
    world = build_world(conf.world)
    spawner = Spawner(world, conf.task.spawn, build_robot(conf.robot, 1).footprint_radius_m)
    xmin, xmax, ymin, ymax = spawner.region
    apart_m = _APART * max(xmax - xmin, ymax - ymin)
    if driven:
        first = placements(spawner, conf.seed, len(driven))
        episodes = {each.episode: first[each.episode] for each in driven}
    else:
        episodes = example_episodes(spawner, conf.seed, conf.episodes, apart_m)
    return Site(
        world=world,
        spawner=spawner,
        max_slope_deg=conf.task.spawn.max_slope_deg,
        goal_distance_m=conf.task.termination.goal_distance_m,
        things=things(world, len(OBSTACLES)),
        paths=_paths(conf, spawner),
        episodes=episodes,
        drives=driven,
    )


def _paths(conf: ViewConf, spawner: Spawner) -> list[NDArray[np.float64]]:
    """Some of the paths of each actor, as those of episodes of this seed are drawn from."""
    if not conf.actors:
        return []
    world = build_world(conf.world)
    actors = Actors(conf.actors, world, spawner.sample_points, stream(conf.seed, "paths"), 1)
    each = max(1, len(PATHS) // len(conf.actors))
    return [path for index in range(len(conf.actors)) for path in actors.paths(index)[:each]]


@no_grad()
def drives(conf: ViewConf, console: Console) -> list[Drive]:
    """The first episodes of the seed, driven to their ends."""
    if conf.checkpoint is None:
        # All that a built-in policy looks at; others take time.
        conf = conf.model_copy(update={"sensors": conf.sensors.model_copy(update={"enabled": ("goal",)})})
    env = make_torchrl_env(conf, min(conf.episodes, _MOST_SCENES), conf.seed)
    batch = env.batch
    found: dict[int, Drive] = {}
    try:
        policy = driver(conf, env)()
        with Progress(console=console, disable=not console.is_terminal, transient=True) as bar:
            task = bar.add_task("driving", total=conf.episodes)
            env.set_seed(conf.seed)
            now = env.reset()
            tracks = [[batch.motion.position_w[scene, :2].copy()] for scene in range(batch.num_scenes)]
            while len(found) < conf.episodes:
                after = env.step(policy(now))
                for scene, track in enumerate(tracks):
                    track.append(batch.motion.position_w[scene, :2].copy())
                done = after["next", "done"].reshape(-1).numpy()
                for scene in np.flatnonzero(done).tolist():
                    episode = int(batch.episodes[scene])
                    metrics = dict(zip(batch.metric_names, batch.metrics()[scene].tolist(), strict=True))
                    if episode < conf.episodes:
                        found[episode] = Drive(episode, _finite(tracks[scene]), ending(metrics))
                now = env.maybe_reset(env.step_mdp(after))
                for scene in np.flatnonzero(done).tolist():
                    tracks[scene] = [batch.motion.position_w[scene, :2].copy()]
                bar.update(task, completed=len(found))
    finally:
        env.close()
    return [found[episode] for episode in sorted(found)]


def _finite(track: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    points = np.array(track)
    # Where physics diverged, a track ends before its episode does.
    return points[np.isfinite(points).all(axis=1)]


def title(conf: ViewConf) -> str:
    """The world's name, and where it is read from a file, that one's."""
    path = getattr(conf.world, "path", None)
    return conf.world.name if path is None else f"{conf.world.name}: {Path(path).name}"


def subtitle(conf: ViewConf) -> str:
    """Who drives, the seed of the episodes, and the settings of the world."""
    chosen = conf.world.model_dump(exclude={"name", "path"}, exclude_none=True)
    settings = ", ".join(f"{name} {_plain(value)}" for name, value in chosen.items() if value not in ((), []))
    who: str | None = conf.policy
    if conf.checkpoint is not None:
        path = Path(conf.checkpoint)
        who = f"policy of {path.name if path.suffix == '' else path.parent.name or path.stem}"
    head = f"{who}, " if who else ""
    return f"{head}episodes of seed {conf.seed}" + (f"; world: {settings}" if settings else "")


def _plain(value: object) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_plain(each) for each in value) + "]"
    return str(value)
