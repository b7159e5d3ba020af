"""Films: what a film of an episode costs, in the sizes of a training's film and of the command `view`."""

import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console

from dune_rl.config.commands import BenchmarkConf, ViewConf
from dune_rl.config.compose import compose
from dune_rl.reporting.views.episode import EpisodeView
from dune_rl.reporting.views.film import write_video

# Width, height [px] and samples: small, that of a training, and that of `python -m dune_rl.view`.
_SIZES = ((640, 360, 1), (960, 540, 1), (1920, 1080, 2))
# The robot gets goal after goal, so that the film is as long as it was asked for.
_ROAMING = ("task.terminations.goal_reached.renew=true", "task.terminations.stuck=null")


def measure_films(conf: BenchmarkConf) -> Mapping[str, Any]:
    """Processor time [s] of films of `conf.film_s` in the world, among five people, by size.

    A robot that drives straight to its goals is filmed with its camera, its LiDAR and a map beside it. The
    time is that of all threads, for the episode, the pictures and their encoding; environments are made
    before.
    """
    world = f"+world={conf.world.name}"
    words = [world, "actors=pedestrians", "sensors=[camera,lidar,goal]", "policy=go_to_goal", *_ROAMING]
    words += [f"seed={conf.seed}", f"longest_s={conf.film_s}"]
    words += ["task.terminations.time_limit.max_steps=1000000"]
    cpu_s = {}
    for width, height, samples in _SIZES:
        view = EpisodeView(
            compose(ViewConf, [*words, f"width={width}", f"height={height}", f"samples={samples}"])
        )
        try:
            with tempfile.TemporaryDirectory() as folder:
                start = time.process_time()
                write_video(view, Path(folder) / "film.mp4", Console(quiet=True))
                cpu_s[f"{width}x{height}"] = time.process_time() - start
        finally:
            view.close()
    return {"film_s": conf.film_s, "film_cpu_s": cpu_s}
