"""`python -m dune_rl.forecast`: record tracks, fit a motion forecast, and show its errors."""

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from dune_rl.commands import command_line
from dune_rl.config.commands import ForecastConf
from dune_rl.config.compose import compose
from dune_rl.core.errors import ConfigError
from dune_rl.core.files import check_writable, write_atomically, write_csv
from dune_rl.core.paths import unused_folder
from dune_rl.sensors.perception.motion_forecast import FORECAST_FILE, LEAST_CHANCE, MotionForecast

CONFIG_FILE, ERRORS_FILE = "config.yaml", "errors.csv"


def run(words: Sequence[str]) -> None:
    """Learn a forecast, as the command line says."""
    parsed = command_line.parse_arguments(words)
    conf = compose(ForecastConf, parsed.overrides, command_line.config_folders(parsed))
    if parsed.cfg:
        command_line.print_settings(conf)
        return
    out = Path(conf.out) if conf.out else unused_folder(Path("forecasts"), datetime.now(), [conf.world.name])
    check_writable(out)
    if out.exists() and any(out.iterdir()):
        raise ConfigError(f"{out} is not empty; choose another out=FOLDER")
    weights, errors = _learn(conf)
    out.mkdir(parents=True, exist_ok=True)
    (out / CONFIG_FILE).write_text(yaml.safe_dump(conf.model_dump(mode="json"), sort_keys=False))
    write_csv(out / ERRORS_FILE, errors)
    with write_atomically(out / FORECAST_FILE) as path, path.open("wb") as file:
        np.savez(file, **weights)
    print(f"Forecast: {out / FORECAST_FILE}")


def _learn(conf: ForecastConf) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    # Only now, since loading PyTorch and the physics engine takes seconds.
    import torch

    from dune_rl.config.build import make_learning_env
    from dune_rl.env.torchrl.episode_metrics import simulation_in
    from dune_rl.learning.evaluation import evaluate
    from dune_rl.learning.forecast.fit import fit_forecast, forecast_errors
    from dune_rl.learning.forecast.recorder import TrackRecorder
    from dune_rl.learning.policies import built_in_policy
    from dune_rl.learning.run.progress import show_episodes

    torch.set_num_threads(1)
    console = command_line.make_console()
    env = make_learning_env(conf, min(conf.scenes, conf.episodes), conf.seed)
    recorder = TrackRecorder(simulation_in(env))
    policy = built_in_policy(conf.policy, env, conf.seed)
    with show_episodes(console, conf.policy, conf.episodes) as show:
        evaluate(policy, env, conf.episodes, conf.seed, observer=recorder, progress=show)
    env.close()
    samples = recorder.samples()
    fitted, held_out = samples.split(int(conf.episodes * (1.0 - conf.held_out)))
    with show_episodes(console, "fit", conf.updates, counted="updates") as show:
        weights = fit_forecast(fitted, conf.updates, conf.batch_size, conf.seed, show)
    weights["step_s"] = np.array(conf.physics.control_step_s, np.float32)
    told = MotionForecast(weights).predict(held_out.features)
    errors = forecast_errors(held_out, *told, LEAST_CHANCE)
    _show(console, errors, len(fitted.features))
    return weights, errors


def _show(console: Any, errors: Sequence[dict[str, Any]], fitted: int) -> None:
    from rich.markup import escape
    from rich.table import Table

    table = Table(
        title=f"Tracks of other episodes than the {fitted:,} that were fitted", title_justify="left"
    )
    table.add_column("")
    table.add_column("forecast", justify="right")
    table.add_column("constant velocity", justify="right")
    for row in errors:
        name, *numbers = row.values()
        table.add_row(escape(name), *("" if number is None else f"{number:,}" for number in numbers))
    console.print(table)
