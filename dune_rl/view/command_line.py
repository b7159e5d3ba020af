"""The command line of `python -m dune_rl.view`."""

from argparse import Namespace
from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_args

from rich.console import Console

from dune_rl import command
from dune_rl.command import HelpPage
from dune_rl.config.compose import compose_view, override_value
from dune_rl.config.schema import ViewConf
from dune_rl.sensors.camera import Output
from dune_rl.sensors.conf import ROBOT_SENSORS
from dune_rl.sensors.lidar_3d import Lidar3dOutput

USAGE = (
    ("python -m dune_rl.view +world=inspection", "a contact sheet and a video"),
    ("python -m dune_rl.view +world=inspection view=orbit", "the place, seen from above"),
    ("python -m dune_rl.view +world=inspection view=map", "its map"),
    ("python -m dune_rl.view checkpoint=runs/NAME view=video", "a trained policy drives"),
    ("python -m dune_rl.view checkpoint=runs/NAME view=map", "where it drives, on the map"),
)
CLOSING = "No display and no GPU is needed: the pictures are traced on the processor."
SETTINGS = (
    ("view=NAME", "sheet, video, both, orbit or map"),
    ("checkpoint=PATH", "a run's folder, or a file of weights, to drive by"),
    ("policy=NAME", "go_to_goal or random, instead of a checkpoint"),
    ("seed=N", "of the episode"),
    ("longest_s=S", "length of the video at most"),
    ("width=N height=N", "size of the video"),
    ("episodes=N", "on the map: how many are driven, or shown as examples"),
    ("out=FOLDER", "where the files go"),
)


def main() -> None:
    """Run the command line; ends the process."""
    command.run_command(
        HelpPage("Look at a world, its rover and its sensors.", USAGE, SETTINGS, CLOSING), _main
    )


def _main(parsed: Namespace) -> None:
    # Nothing is shown on a map of what the other sensors would sense.
    on_map = override_value(parsed.overrides, "view") == "map"
    conf = command.compose_with_checkpoint(
        parsed, compose_view, (lambda saved: saved) if on_map else _with_all_sensors
    )
    if conf is None:
        return
    if override_value(parsed.overrides, "sensors") is None:
        conf = _without_odometry_on_legs(conf)
    _view(conf)


def _with_all_sensors(saved: Mapping[str, Any]) -> dict[str, Any]:
    """A run's settings, and beside its own sensors all others, which its policy does not look at."""
    own = saved["sensors"]
    sensors = {
        **own,
        "enabled": [*own["enabled"], *(name for name in ROBOT_SENSORS if name not in own["enabled"])],
    }
    for name, outputs in (("camera", get_args(Output)), ("lidar_3d", get_args(Lidar3dOutput))):
        if name not in own["enabled"]:
            sensors[name] = {**own.get(name, {}), "outputs": list(outputs)}
    return {**saved, "sensors": sensors}


def _without_odometry_on_legs(conf: ViewConf) -> ViewConf:
    """The settings with the sensors that the robot can have: all, but odometry only where it has wheels."""
    from dune_rl.config.build import build_robot

    if build_robot(conf.robot, 1).wheels is not None:
        return conf
    enabled = tuple(name for name in conf.sensors.enabled if name != "odometry")
    return conf.model_copy(update={"sensors": conf.sensors.model_copy(update={"enabled": enabled})})


def _view(conf: ViewConf) -> None:
    folder = Path(conf.out)
    folder.mkdir(parents=True, exist_ok=True)
    console = command.make_console()
    if conf.view == "map":
        from dune_rl.view.maps import write_map

        _show(console, write_map(conf, folder / f"{conf.world.name}_map.png", console))
        return
    from dune_rl.view.looks import write_orbit, write_sheet, write_video
    from dune_rl.view.stage import Stage

    stage = Stage(conf)
    try:
        if conf.view == "orbit":
            _show(console, write_orbit(stage, folder / f"{conf.world.name}_orbit.png"))
        if conf.view in ("sheet", "both"):
            _show(console, write_sheet(stage, folder / f"{conf.world.name}_sheet.png"))
        if conf.view in ("video", "both"):
            _show(console, write_video(stage, folder / f"{conf.world.name}_seed{conf.seed}.mp4", console))
    finally:
        stage.close()


def _show(console: Console, path: Path) -> None:
    console.print(f"Written: {path}", highlight=False, soft_wrap=True)
