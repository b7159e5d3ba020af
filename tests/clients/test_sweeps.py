"""Sweeps by other people's launchers and sweepers: joblib, submitit, Ray and Optuna."""

import subprocess
import sys
from pathlib import Path

import pytest
import yaml

# With the default collector, which starts a process of its own.
SMALL = [
    "+world=flat",
    "actors=none",
    "total_frames=128",
    "learning.learning_starts=64",
    "learning.batch_size=8",
    "learning.hidden=[8]",
    "learning.replay.capacity=1000",
    "learning.threads=1",
    "learning.collector.scenes=2",
    "learning.collector.steps=16",
    "learning.evaluation.episodes=2",
    "learning.evaluation.scenes=2",
    "task.terminations.time_limit.max_steps=10",
]


def train(folder: Path, *words: str) -> str:
    """Output of a sweep in a process of its own, as a user runs it."""
    command = [sys.executable, "-m", "dune_rl.train", "-m", *SMALL, "hydra.sweep.dir=sweep", *words]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr[-3000:] + done.stdout[-1000:]
    return done.stdout


@pytest.mark.parametrize(
    "launcher",
    [
        pytest.param(
            ["hydra/launcher=joblib", "hydra.launcher.n_jobs=2"],
            marks=pytest.mark.client("Hydra: joblib", "a sweep of two runs side by side", "dune_rl.train -m"),
        ),
        pytest.param(
            ["hydra/launcher=submitit_local"],
            marks=pytest.mark.client("Hydra: submitit", "a sweep of two jobs", "dune_rl.train -m"),
        ),
        pytest.param(
            [
                "hydra/launcher=ray",
                "+hydra.launcher.ray.init.address=local",
                "+hydra.launcher.ray.init.num_cpus=2",
                "+hydra.launcher.ray.init.include_dashboard=false",
            ],
            marks=pytest.mark.client("Hydra: Ray", "a sweep of two tasks", "dune_rl.train -m"),
        ),
    ],
    ids=["joblib", "submitit", "ray"],
)
def test_launchers_run_the_jobs(launcher: list[str], tmp_path: Path) -> None:
    if launcher[0].endswith("=ray"):
        # Its imports need what `--no-deps` left out only on Amazon's machines.
        pytest.importorskip("hydra_plugins.hydra_ray_launcher.ray_launcher", reason="no Ray launcher")
        pytest.importorskip("ray", reason="Ray is not installed")
    train(tmp_path, "seed=1,2", *launcher)
    for number, seed in enumerate((1, 2)):
        folder = tmp_path / "sweep" / f"{number}_flat_seed{seed}"
        assert (folder / "policy_best.pt").exists()
        assert yaml.safe_load((folder / "config.yaml").read_text())["seed"] == seed


@pytest.mark.client("Hydra: Optuna", "a search for the best `objective`", "dune_rl.train -m")
def test_optuna_optimises_the_objective(tmp_path: Path) -> None:
    train(
        tmp_path,
        "hydra/sweeper=optuna",
        "hydra.sweeper.direction=minimize",
        "hydra.sweeper.n_trials=2",
        "hydra.sweeper.n_jobs=1",
        "learning.gamma=interval(0.9,0.99)",
        "objective=min_clearance",
    )
    found = yaml.safe_load((tmp_path / "sweep" / "optimization_results.yaml").read_text())
    assert 0.9 <= found["best_params"]["learning.gamma"] <= 0.99
    # Nothing is near on flat ground without actors.
    assert found["best_value"] == pytest.approx(12.0)
