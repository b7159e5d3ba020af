"""What a stage is looked at by: a contact sheet, a film, a picture of the place."""

from pathlib import Path

from PIL import Image
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from dune_rl.files import write_atomically
from dune_rl.view.stage import Stage
from dune_rl.visualization.contact_sheet import contact_sheet
from dune_rl.visualization.film import film
from dune_rl.visualization.overlay import with_overlays


def write_orbit(stage: Stage, path: Path) -> Path:
    """A picture of the whole place (PNG)."""
    picture = stage.orbit()
    with write_atomically(path) as temporary:
        Image.fromarray(picture).save(temporary, format="png")
    return path


def write_sheet(stage: Stage, path: Path) -> Path:
    """What every sensor says at one instant of an episode (PNG)."""
    conf = stage.conf
    wanted = round(conf.after_s * conf.physics.control_hz)
    steps = 0
    for steps, _ in enumerate(stage.drive()):
        if steps >= wanted:
            break
    title = f"{conf.world.name}, seed {conf.seed}, {steps / conf.physics.control_hz:.1f} s into the episode"
    figure = contact_sheet(stage.readings(), conf.sensors, stage.behind(1280, 960), title)
    with write_atomically(path) as temporary:
        figure.savefig(temporary, format="png", dpi=110, facecolor=figure.get_facecolor())
    return path


def write_video(stage: Stage, path: Path, console: Console) -> Path:
    """A film of an episode (MP4)."""
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
            lines = stage.status(steps)
            frame = stage.behind(conf.width, conf.height)
            headline = stage.ending() if done else ""
            picture = with_overlays(frame, readings, conf.sensors.lidar, lines, headline)
            add(picture)
            bar.update(task, completed=steps, state=lines[0])
            if done or steps >= longest:
                # The last picture stands for a moment.
                for _ in range(round(1.5 * rate)):
                    add(picture)
                break
    return path
