"""`python -m dune_rl.view`: compose the settings and write the pictures."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from dune_rl.commands import command_line
from dune_rl.config.commands import ViewConf
from dune_rl.config.compose import compose, override_value
from dune_rl.config.saved import upgrade_saved
from dune_rl.core.files import check_writable, removing_empty
from dune_rl.learning.checkpoint import read_policy_file

if TYPE_CHECKING:
    from dune_rl.env.requests import EpisodePlan
    from dune_rl.reporting.views.episode import EpisodeView


def run(words: Sequence[str]) -> None:
    parsed = command_line.parse_arguments(words)
    checkpoint = override_value(parsed.overrides, "checkpoint")
    saved = None if checkpoint is None else read_policy_file(Path(str(checkpoint)))[1]["config"]
    view = override_value(parsed.overrides, "view")
    # A map shows no readings, so it needs no sensors beside the policy's.
    if saved is not None and view != "map":
        saved = _with_sensors(saved, "[camera,lidar]" if view == "video" else "all")
    from dune_rl.evaluation.episode_sets.apply import (
        compose_on_set,
        plan_of_set,
        settings_of_episode,
    )

    conf, episode_set = compose_on_set(ViewConf, parsed.overrides, command_line.config_folders(parsed), saved)
    if parsed.cfg:
        command_line.print_settings(conf)
        return
    if conf.view != "live":
        check_writable(Path(conf.out))
    plan = None
    if episode_set is not None:
        conf = settings_of_episode(conf, episode_set, conf.episode)
        plan = plan_of_set(conf, episode_set)
    if override_value(parsed.overrides, "sensors") is None:
        conf = _drop_odometry_of_legs(conf)
    with removing_empty(Path(conf.out)):
        _view(conf, plan)


def _with_sensors(saved: Mapping[str, Any], added: str) -> dict[str, Any]:
    """Settings of a run with other sensors enabled, too; its policy reads only its own."""
    upgraded = upgrade_saved(saved)
    own = upgraded["sensors"]
    every = compose(ViewConf, ["+world=flat", f"sensors={added}"]).model_dump(mode="json")["sensors"]
    outputs = {name: {"outputs": entry["outputs"]} for name, entry in every.items() if "outputs" in entry}
    more = {
        name: {**entry, **own.get(name, {}), **outputs.get(name, {}), "observed": True}
        for name, entry in every.items()
        if not own.get(name, {}).get("observed")
    }
    return {**upgraded, "sensors": {**own, **more}}


def _drop_odometry_of_legs(conf: ViewConf) -> ViewConf:
    """`conf` without odometry if a robot with these sensors has no wheels."""
    from dune_rl.config.build import build_robot
    from dune_rl.robots.settings import RobotSettings

    robots = [
        build_robot(group.body, 1)
        for group in conf.groups
        if group.sensors == conf.sensors and isinstance(group.body, RobotSettings)
    ]
    if all(robot.description.wheels is not None for robot in robots):
        return conf
    sensors = {name: each for name, each in conf.sensors.items() if each.sensor != "odometry"}
    return conf.model_copy(update={"sensors": sensors})


def _stem(conf: ViewConf) -> str:
    """What the files are called: the set's and the episode's name, the world's, or that of its file."""
    if conf.set is not None:
        return f"{Path(conf.set).stem}_{conf.episode}"
    path = getattr(conf.world, "path", None)
    return conf.world.name if path is None else f"{conf.world.name}_{Path(path).stem}"


def _film_stem(conf: ViewConf) -> str:
    """Also the seed, the episode if it is not the first, and the policy; a set has one seed."""
    parts = [_stem(conf)]
    if conf.set is None:
        parts += [f"seed{conf.seed}", *([f"episode{conf.episode}"] if conf.episode else [])]
    if conf.checkpoint is None:
        return "_".join([*parts, conf.policy or "go_to_goal"])
    path = Path(conf.checkpoint).resolve()
    return "_".join([*parts, path.name if path.is_dir() else f"{path.parent.name}_{path.stem}"])


def _view(conf: ViewConf, plan: "EpisodePlan | None") -> None:
    folder = Path(conf.out)
    console = command_line.make_console()
    if conf.view == "map":
        from dune_rl.reporting.views.maps import write_map

        folder.mkdir(parents=True, exist_ok=True)
        command_line.print_world_notes(console, conf)
        _print_path(console, write_map(conf, folder / f"{_stem(conf)}_map.png", console, plan))
        return
    if conf.view in ("live", "html"):
        from dune_rl.rendering.web.server import check_address, require_viser

        # Before the world is built, and PyTorch is loaded, which may take a while.
        require_viser(f"view={conf.view}")
        if conf.view == "live":
            check_address(conf.host, conf.port)
    from dune_rl.reporting.views.episode import EpisodeView, write_orbit, write_sheet
    from dune_rl.reporting.views.film import write_video

    episode = EpisodeView(conf, plan)
    try:
        if conf.view == "live":
            _watch(episode, console)
            return
        # Only now, when nothing is wrong with the settings.
        folder.mkdir(parents=True, exist_ok=True)
        command_line.print_world_notes(console, conf)
        if conf.view == "orbit":
            command_line.print_line(console, "Drawing the world.")
            _print_path(console, write_orbit(episode, folder / f"{_stem(conf)}_orbit.png"))
        if conf.view in ("sheet", "both"):
            command_line.print_line(console, f"Drawing all readings, {conf.after_s:g} s into the episode.")
            _print_path(console, write_sheet(episode, folder / f"{_stem(conf)}_sheet.png"))
        if conf.view in ("video", "both"):
            path = folder / f"{_film_stem(conf)}.mp4"
            _print_path(console, write_video(episode, path, console))
        if conf.view in ("html", "gltf"):
            from dune_rl.reporting.views.scene_files import SCENE_WRITERS

            suffix, write_scene = SCENE_WRITERS[conf.view]
            command_line.print_line(console, f"Recording an episode of at most {conf.longest_s:g} s.")
            _print_path(console, write_scene(episode, folder / f"{_film_stem(conf)}.{suffix}"))
    finally:
        episode.close()


def _watch(episode: "EpisodeView", console: Console) -> None:
    """Run episodes on a live page until Ctrl-C."""
    from dune_rl.reporting.views.live import LiveSession

    session = LiveSession(episode)
    try:
        command_line.print_world_notes(console, episode.conf)
        command_line.print_line(console, f"Open {session.url} in a browser. Ctrl-C ends.")
        session.run()
    finally:
        session.close()


def _print_path(console: Console, path: Path) -> None:
    command_line.print_line(console, f"Written: {path}")
