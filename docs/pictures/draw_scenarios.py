"""Draws a still and a film of each scenario: `python docs/pictures/draw_scenarios.py`.

It writes `scenario_NAME.jpg` and `scenario_NAME.mp4` beside itself: of all scenarios, or of those that are
named, with `--stills` or `--films` the one kind alone.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from dune_rl.config.commands import ViewConf
from dune_rl.config.compose import compose
from dune_rl.env.pictures import Pictures
from dune_rl.rendering.renderer import Viewpoint
from dune_rl.reporting.views.episode import EpisodeView
from dune_rl.visualization.video import open_video

FOLDER = Path(__file__).parent
STILL_PX, FILM_PX = (960, 540), (480, 270)
FRAMES_PER_S = 7.0
# The robot gets goal after goal, so that a film does not end with the first.
ROAMING = ("task.terminations.goal_reached.renew=true", "task.terminations.stuck=null")


@dataclass(frozen=True)
class Shot:
    """An episode, what of it is filmed, and from where: `eye` and `target` are x, y and height [m]."""

    seed: int
    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    begin_s: float
    end_s: float
    still_s: float
    fov_rad: float = 0.85


SHOTS = {
    "crossing": Shot(3, (-27.4, -25.3, 4.4), (-20.6, -21.2, 0.5), 0.0, 5.3, 3.0),
    "crowd": Shot(1, (-12.5, -6.0, 4.6), (0.3, -0.5, 0.5), 0.0, 9.0, 5.0),
    "farm": Shot(1, (-18.0, 1.0, 5.0), (0.0, -2.4, 0.4), 0.0, 9.0, 8.0),
    "site_traffic": Shot(2, (-11.0, -17.0, 7.0), (4.0, -6.5, 0.8), 0.0, 9.0, 4.0),
}


def draw(name: str, shot: Shot, *, with_still: bool, with_film: bool) -> None:
    """Write the still and the film of a scenario."""
    words = [f"scenario={name}", f"seed={shot.seed}", "sensors=[goal]", "policy=planner", *ROAMING]
    view = EpisodeView(compose(ViewConf, words))
    pictures = Pictures(view.simulation)
    ground = view.simulation.worlds.worlds[0].terrain
    eye, target = (
        (x, y, above + float(ground.height(np.array([x, y])))) for x, y, above in (shot.eye, shot.target)
    )
    camera = Viewpoint(eye, target, shot.fov_rad)
    rate = view.conf.physics.control_hz
    every = round(rate / FRAMES_PER_S)
    still, begin, end = (round(time * rate) for time in (shot.still_s, shot.begin_s, shot.end_s))
    frames = []
    for step, _ in enumerate(view.run()):
        if with_still and step == still:
            picture = pictures.seen(camera, 0, *STILL_PX, samples=3)
            Image.fromarray(picture).save(FOLDER / f"scenario_{name}.jpg", quality=85, optimize=True)
        if with_film and step >= begin and step % every == 0:
            frames.append(pictures.seen(camera, 0, *FILM_PX, samples=2))
        if step >= (end if with_film else still):
            break
    if frames:
        with open_video(FOLDER / f"scenario_{name}.mp4", rate / every, *FILM_PX) as add_frame:
            for frame in frames:
                add_frame(frame)
    view.close()


def main() -> None:
    """Write the pictures of all scenarios, or of those that are named."""
    flags = {"--stills", "--films"}.intersection(sys.argv)
    names = [word for word in sys.argv[1:] if word not in flags]
    for name in names or SHOTS:
        with_still, with_film = "--films" not in flags, "--stills" not in flags
        draw(name, SHOTS[name], with_still=with_still, with_film=with_film)


if __name__ == "__main__":
    main()
