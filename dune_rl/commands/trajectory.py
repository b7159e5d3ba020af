"""`python -m dune_rl.trajectory`: plan, check, write the file, and draw the picture."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dune_rl.commands import command_line
from dune_rl.core.files import check_free, write_atomically
from dune_rl.trajectories.files import write_trajectory
from dune_rl.trajectories.picture import draw_trajectory
from dune_rl.trajectories.settings import choose_world, parse_words

_DPI = 120


def run(words: Sequence[str]) -> None:
    """Write the trajectory that the command line asks for, and its picture."""
    parsed = command_line.parse_arguments(words)
    world_name, world_words, conf = parse_words(parsed.overrides)
    out, picture = Path(conf.out), conf.picture_path
    for path in (out, picture):
        check_free(path, overwrite=conf.overwrite)
    world = choose_world(world_name, world_words, command_line.config_folders(parsed))
    actor = conf.plan(world)
    title = f"{conf.name} in {Path(world_name).name}"
    figure = draw_trajectory(world, actor, np.array(conf.waypoints), title, conf.max_slope_deg, _DPI)
    for path in (out, picture):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_trajectory(out, actor, conf.appearance)
    with write_atomically(picture) as temporary:
        # Without the drawing library's version, the file stays the same when that changes.
        figure.savefig(temporary, format="png", dpi=_DPI, metadata={"Software": None})
    length_m = float(np.linalg.norm(np.diff(actor.poses[:, :3], axis=0), axis=1).sum())
    command_line.print_line(
        command_line.make_console(),
        f"{out}: {len(actor.times):,} poses, {length_m:.1f} m in {actor.duration_s:.1f} s, "
        f"{'repeated' if actor.loop else 'once'}\n{picture}: the way on the map",
    )
