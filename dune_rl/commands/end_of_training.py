"""The end of a training: a film of the best policy, and what to do next."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from dune_rl.commands import command_line
from dune_rl.config.commands import ViewConf
from dune_rl.config.schema import Conf, EnvConf
from dune_rl.core.suggestions import quote_text, text_word
from dune_rl.robots.settings import RobotSettings

if TYPE_CHECKING:
    from dune_rl.learning.trainer import TrainingResult

FILM_FILE = "film.mp4"


def choose_episode(rows: Sequence[Mapping[str, float]]) -> int:
    """Number of the longest evaluation episode with success or, without any, of the longest one.

    `rows` are those of the agents; the first agent of an episode counts, as it is the one in the film.
    """
    firsts = [row for row in rows if row["agent"] == 0.0]
    longest = max(firsts, key=lambda row: (row.get("success") == 1.0, row["steps"]), default={"episode": 0.0})
    return int(longest["episode"])


def film_run(console: Console, conf: Conf, result: "TrainingResult") -> None:
    """Write the film of the best policy in one episode of its evaluation, by `choose_episode`.

    `conf` has the settings of the evaluations.
    """
    from dune_rl.learning.run.tensorboard import log_film, reduce_picture
    from dune_rl.reporting.views.episode import EpisodeView
    from dune_rl.reporting.views.film import write_video

    environment = {name: getattr(conf, name) for name in EnvConf.model_fields}
    view = ViewConf(
        **environment,
        checkpoint=str(result.run_dir),
        seed=conf.seed + conf.learning.evaluation.seed_offset,
        episode=choose_episode(result.best_evaluation.get(conf.driven_group.name, [])),
        width=960,
        height=540,
        samples=1,
    )
    console.print("Filming an episode of the trained policy", highlight=False)
    episode = EpisodeView(view)
    # A minute of whole pictures would be a gigabyte.
    pictures: list[NDArray[np.uint8]] = []
    try:
        write_video(
            episode,
            result.run_dir / FILM_FILE,
            console,
            lambda picture: pictures.append(reduce_picture(picture)),
        )
    finally:
        episode.close()
    log_film(result.run_dir, pictures, view.frames_per_s, result.frames)


def show_end(console: Console, conf: Conf, result: "TrainingResult") -> None:
    """Print the last evaluation, the files in the run's folder, and commands to go on with."""
    from dune_rl.evaluation.tables import metric_notes, results_table
    from dune_rl.learning.checkpoint import BEST_POLICY_FILE, CHECKPOINT_FILE, CONFIG_FILE, LAST_POLICY_FILE
    from dune_rl.learning.policies import go_to_goal_fault
    from dune_rl.learning.run.log import CURVE_FILE, METRICS_FILE
    from dune_rl.statistics.measures import estimate_metrics

    for group, rows in result.evaluation.items():
        name = f"{conf.world.name}, {group}" if len(result.evaluation) > 1 else conf.world.name
        episodes = conf.learning.evaluation.episodes
        title = f"{name}: {episodes} unseen episodes after {result.frames:,} frames"
        estimates = estimate_metrics(rows)
        notes = metric_notes(conf.metrics, estimates)
        table = results_table({"trained": estimates}, title, num_agents=len(rows) // episodes, notes=notes)
        console.print(table)
    folder = command_line.shown_path(result.run_dir)
    contents = {
        FILM_FILE: "an episode of the best policy",
        CURVE_FILE: "the evaluations so far",
        METRICS_FILE: "a row for each of them",
        BEST_POLICY_FILE: "the policy with the best evaluation",
        LAST_POLICY_FILE: "the latest policy",
        CHECKPOINT_FILE: "the state of training, to go on with",
        CONFIG_FILE: "all settings",
    }
    lines = [f"Files in {folder}:"]
    lines += [f"  {name}: {text}" for name, text in contents.items() if (result.run_dir / name).exists()]
    can_go = all(go_to_goal_fault(spec) is None for spec in result.specs.values())
    reference = "go_to_goal" if can_go else "random"
    further = 2 * max(conf.total_frames, result.frames)
    checkpoint, numbers = text_word("checkpoint", folder), ("episodes=100", "seed=1")
    commands: list[tuple[str, ...]] = [
        ("dune_rl.view", checkpoint),
        ("dune_rl.evaluate", checkpoint, *numbers),
        ("dune_rl.evaluate", checkpoint, f"against={reference}", *numbers),
        ("tensorboard.main", "--logdir", command_line.shown_path(result.run_dir.parent)),
        ("dune_rl.train", text_word("resume", folder), f"total_frames={further}"),
    ]
    if any(not isinstance(group.body, RobotSettings) for group in conf.external_groups):
        populations = f"populations=[walkers,{quote_text(folder)}]"
        commands.append(("dune_rl.evaluate", "cross_play=true", checkpoint, populations, *numbers))
    lines += ["Try next:"]
    lines += [f"  {command_line.shell_command(*words)}" for words in commands]
    command_line.print_line(console, "\n".join(lines))
