"""Files of a view: a contact sheet, a video, a picture of the world."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from dune_rl.core.files import write_atomically
from dune_rl.reporting.views.episode import EpisodeView
from dune_rl.visualization.contact_sheet import contact_sheet
from dune_rl.visualization.overlay import draw_overlays
from dune_rl.visualization.video import open_video

# The last picture of a video stays this long.
_LAST_PICTURE_S = 1.5


def write_orbit(view: EpisodeView, path: Path) -> Path:
    """A picture of the whole world (PNG)."""
    picture = view.render_world()
    with write_atomically(path) as temporary:
        Image.fromarray(picture).save(temporary, format="png")
    return path


def write_sheet(view: EpisodeView, path: Path) -> Path:
    """The readings of all sensors at one instant of an episode (PNG)."""
    conf = view.conf
    last = round(conf.after_s * conf.physics.control_hz)
    steps = 0
    for steps, _ in enumerate(view.run()):
        if steps >= last:
            break
    title = f"{conf.world.name}, seed {conf.seed}, {steps / conf.physics.control_hz:.1f} s into the episode"
    if len(view.simulation.agents) > 1:
        title += f", {view.agent}"
    picture = view.render_from_behind(1280, 960, turns_for_agents=True)
    figure = contact_sheet(view.readings(), view.sensors, picture, title)
    with write_atomically(path) as temporary:
        figure.savefig(temporary, format="png", dpi=110, facecolor=figure.get_facecolor())
    return path


def write_video(
    view: EpisodeView,
    path: Path,
    console: Console,
    also: Callable[[NDArray[np.uint8]], None] = lambda picture: None,
) -> Path:
    """A video of an episode (MP4); `also` is called with each of its pictures, RGB (height, width, 3)."""
    conf = view.conf
    every = max(1, round(conf.physics.control_hz / conf.frames_per_s))
    rate = conf.physics.control_hz / every
    longest = round(conf.longest_s * conf.physics.control_hz)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[state]}  at most"),
        TimeRemainingColumn(),
    )
    bar = Progress(*columns, console=console, disable=not console.is_terminal, transient=True)
    with open_video(path, rate, conf.width, conf.height) as add_frame, bar:
        task = bar.add_task("rendering", total=longest, state="")
        for steps, done in enumerate(view.run()):
            if steps % every and not done:
                continue
            lines = view.status(steps)
            frame = view.render_from_behind(conf.width, conf.height)
            picture = draw_overlays(frame, view.readings(), view.sensors.get("lidar"), lines, view.ending())
            add_frame(picture)
            also(picture)
            bar.update(task, completed=steps, state=lines[0])
            if done or steps >= longest:
                for _ in range(round(_LAST_PICTURE_S * rate)):
                    add_frame(picture)
                break
    return path
