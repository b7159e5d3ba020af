"""Look at a world, its rover and its sensors: `python -m dune_rl.view +world=inspection`."""

from argparse import Namespace
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, get_args

import numpy as np
import yaml
from numpy.typing import NDArray
from PIL import Image
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from tensordict import TensorDictBase

from dune_rl import command
from dune_rl.command import Page
from dune_rl.config.compose import compose_view, given
from dune_rl.config.schema import ViewConf
from dune_rl.files import replaced
from dune_rl.learning.checkpoint import BEST_POLICY_FILE, CHECKPOINT_FILE, find, read
from dune_rl.sensors.camera import Output
from dune_rl.sensors.lidar_3d import Lidar3dOutput
from dune_rl.sensors.suite import SensorName

USAGE = (
    ("python -m dune_rl.view +world=inspection", "a contact sheet and a video"),
    ("python -m dune_rl.view +world=inspection view=orbit", "the place, seen from above"),
    ("python -m dune_rl.view checkpoint=runs/NAME view=video", "a trained policy drives"),
)
CLOSING = "No display and no GPU is needed: the pictures are traced on the processor."
SETTINGS = (
    ("view=NAME", "sheet, video, both or orbit"),
    ("checkpoint=PATH", "a run's folder, or a file of weights, to drive by"),
    ("policy=NAME", "go_to_goal or random, instead of a checkpoint"),
    ("seed=N", "of the episode"),
    ("longest_s=S", "length of the video at most"),
    ("width=N height=N", "size of the video"),
    ("out=FOLDER", "where the files go"),
)

Picture = NDArray[np.uint8]


def main() -> None:
    """Run the command line; ends the process."""
    command.run(Page("Look at a world, its rover and its sensors.", USAGE, SETTINGS, CLOSING), _main)


def _main(parsed: Namespace) -> None:
    checkpoint = given(parsed.overrides, "checkpoint")
    saved = None
    if checkpoint is not None:
        file = find(Path(str(checkpoint)), BEST_POLICY_FILE, CHECKPOINT_FILE)
        saved = _with_all_sensors(read(file, "policy", "checkpoint")["config"])
    conf = compose_view(parsed.overrides, command.config_dirs(parsed), saved)
    if parsed.cfg:
        print(yaml.safe_dump(conf.model_dump(mode="json"), sort_keys=False), end="")
        return
    if given(parsed.overrides, "sensors") is None and saved is None:
        conf = _without_odometry_on_legs(conf)
    _view(conf)


def _with_all_sensors(saved: Mapping[str, Any]) -> dict[str, Any]:
    """A run's settings, and beside its own sensors all others, which its policy does not look at."""
    own = saved["sensors"]
    names = get_args(SensorName)
    sensors = {**own, "enabled": [*own["enabled"], *(name for name in names if name not in own["enabled"])]}
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
    console = command.console()
    stage = _Stage(conf)
    try:
        if conf.view == "orbit":
            _show(console, _save(folder / f"{conf.world.name}_orbit.png", stage.orbit()))
        if conf.view in ("sheet", "both"):
            _show(console, _sheet(stage, folder / f"{conf.world.name}_sheet.png"))
        if conf.view in ("video", "both"):
            _show(console, _video(stage, folder / f"{conf.world.name}_seed{conf.seed}.mp4", console))
    finally:
        stage.close()


class _Stage:
    """One scene, driven by a policy."""

    def __init__(self, conf: ViewConf) -> None:
        # Only now, since loading the physics engine takes a second.
        from dune_rl.config.build import make_torchrl_env
        from dune_rl.env.pictures import Pictures
        from dune_rl.learning.layout import Layout
        from dune_rl.learning.policies import GoToGoal, UniformRandom, load_policy

        self.conf = conf
        self._env = make_torchrl_env(conf, 1, conf.seed)
        self.batch = self._env.batch
        self.pictures = Pictures(self.batch)
        layout = Layout.of(self._env)
        if conf.checkpoint is not None:
            trained: Any = load_policy(Path(conf.checkpoint), layout, more=True)[0]
            self._make_policy = lambda: trained
        elif conf.policy == "random":
            # Anew for each drive, or one would depend on those before it.
            self._make_policy = lambda: UniformRandom(layout, conf.seed)
        else:
            self._make_policy = lambda: GoToGoal(layout)

    def drive(self) -> Iterator[TensorDictBase]:
        """What is observed at the start of an episode and after each step, to its end."""
        self._env.batch.reseed(self.conf.seed)
        policy = self._make_policy()
        now = self._env.reset()
        yield now
        while True:
            now = self._env.step(policy(now))["next"]
            yield now
            if bool(now["done"]):
                return

    def readings(self) -> dict[str, NDArray[Any]]:
        """The rover's readings by name, without the axis of scenes."""
        return {name: value[0] for name, value in self.batch.observe().items()}

    def behind(self, width: int, height: int) -> Picture:
        """The rover from behind."""
        return self.pictures.from_behind(0, width, height, self.conf.samples)

    def orbit(self) -> Picture:
        """The whole place."""
        next(self.drive())
        return self.pictures.of_the_place(0, self.conf.width, self.conf.height, max(2, self.conf.samples))

    def close(self) -> None:
        self._env.close()


def _sheet(stage: _Stage, path: Path) -> Path:
    from dune_rl.viewing.contact_sheet import contact_sheet

    conf = stage.conf
    wanted = round(conf.after_s * conf.physics.control_hz)
    steps = 0
    for steps, _ in enumerate(stage.drive()):
        if steps >= wanted:
            break
    title = f"{conf.world.name}, seed {conf.seed}, {steps / conf.physics.control_hz:.1f} s into the episode"
    figure = contact_sheet(stage.readings(), conf.sensors, stage.behind(1280, 960), title)
    with replaced(path) as temporary:
        figure.savefig(temporary, format="png", dpi=110, facecolor=figure.get_facecolor())
    return path


def _video(stage: _Stage, path: Path, console: Console) -> Path:
    from dune_rl.viewing.film import film
    from dune_rl.viewing.overlay import with_overlays

    conf = stage.conf
    every = max(1, round(conf.physics.control_hz / conf.frames_per_s))
    rate = conf.physics.control_hz / every
    longest = round(conf.longest_s * conf.physics.control_hz)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[state]}"),
        TimeRemainingColumn(),
    )
    bar = Progress(*columns, console=console, disable=not console.is_terminal, transient=True)
    with film(path, rate, conf.width, conf.height) as add, bar:
        task = bar.add_task("filming", total=longest, state="")
        for steps, now in enumerate(stage.drive()):
            done = bool(now["done"])
            if steps % every and not done:
                continue
            readings = stage.readings()
            lines = _status(stage, steps)
            frame = stage.behind(conf.width, conf.height)
            headline = _ending(stage) if done else ""
            picture = with_overlays(frame, readings, conf.sensors.lidar, lines, headline)
            add(picture)
            bar.update(task, completed=steps, state=lines[0])
            if done or steps >= longest:
                # The last picture stands for a moment.
                for _ in range(round(1.5 * rate)):
                    add(picture)
                break
    return path


def _status(stage: _Stage, steps: int) -> list[str]:
    batch = stage.batch
    metrics = dict(zip(batch.metric_names, batch.metrics()[0].tolist(), strict=True))
    goal = float(np.hypot(*(batch.goals_w[0] - batch.motion.position_w[0, :2])))
    return [
        f"{steps / stage.conf.physics.control_hz:5.1f} s",
        f"speed {batch.motion.velocity_b[0, 0]:5.2f} m/s",
        f"goal {goal:6.2f} m",
        f"slope {np.rad2deg(batch.motion.tilt()[0]):4.0f}°",
        f"collisions {metrics['collisions']:.0f}",
    ]


def _ending(stage: _Stage) -> str:
    batch = stage.batch
    metrics = dict(zip(batch.metric_names, batch.metrics()[0].tolist(), strict=True))
    endings = {
        "success": "goal reached",
        "reached": "goal reached, after a collision",
        "stuck": "stuck",
        "flipped": "turned over",
        "out_of_world": "left the world",
        "diverged": "physics diverged",
    }
    return next((text for name, text in endings.items() if metrics[name] > 0), "out of time")


def _save(path: Path, picture: Picture) -> Path:
    with replaced(path) as temporary:
        Image.fromarray(picture).save(temporary, format="png")
    return path


def _show(console: Console, path: Path) -> None:
    console.print(f"Written: {path}", highlight=False, soft_wrap=True)


if __name__ == "__main__":
    main()
