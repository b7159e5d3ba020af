"""BenchMARL's own experiments on tasks of ours, with walkers as learning agents."""

import json
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import torch
from torchrl.envs import TransformedEnv

from dune_rl.core.errors import ConfigError

SHORT = {"terminations": {"time_limit": {"max_steps": 8}}}
WALKERS = {"actors": "external_walkers", "task": SHORT}
GROUPS = {"rover": ["rover_0"], "walker": ["walker_0", "walker_1"]}

# BenchMARL's and TorchRL's, which are errors of ours otherwise.
pytestmark = [
    pytest.mark.filterwarnings("ignore::UserWarning:benchmarl.*"),
    pytest.mark.filterwarnings("ignore::UserWarning:torchrl.*"),
]


@pytest.fixture
def tasks() -> ModuleType:
    """Our module for BenchMARL, which is imported before BenchMARL itself."""
    import dune_rl.clients.benchmarl

    return dune_rl.clients.benchmarl


def small_experiment(folder: Path, **changes) -> Any:
    from benchmarl.experiment import ExperimentConfig

    conf = ExperimentConfig.get_from_yaml()
    frames = {"collected_frames_per_batch": 64, "n_envs_per_worker": 4}
    chosen = {
        **{f"{kind}_policy_{name}": value for kind in ("on", "off") for name, value in frames.items()},
        **{"on_policy_minibatch_size": 32, "on_policy_n_minibatch_iters": 2},
        **{"off_policy_train_batch_size": 32, "off_policy_n_optimizer_steps": 2},
        **{"off_policy_memory_size": 1_000, "max_n_frames": None, "max_n_iters": 2},
        **{"evaluation_interval": 64, "evaluation_episodes": 3, "checkpoint_at_end": True},
        **{"loggers": ["csv"], "save_folder": str(folder), "render": False},
    }
    for name, value in {**chosen, **changes}.items():
        assert hasattr(conf, name)
        setattr(conf, name, value)
    return conf


def experiment(algorithm: str, folder: Path, tasks: ModuleType, **changes) -> Any:
    import benchmarl.algorithms
    from benchmarl.experiment import Experiment
    from benchmarl.models.mlp import MlpConfig

    model = MlpConfig.get_from_yaml()
    model.num_cells = [16]
    return Experiment(
        task=tasks.DuneTask.FLAT.get_task(WALKERS),
        algorithm_config=getattr(benchmarl.algorithms, f"{algorithm}Config").get_from_yaml(),
        model_config=model,
        seed=0,
        config=small_experiment(folder, **changes),
        callbacks=[tasks.EpisodeLog()],
    )


def weights_of(run: Any, group: str) -> torch.Tensor:
    return torch.cat([each.detach().flatten().clone() for each in run.group_policies[group].parameters()])


def logged(run: Any, name: str) -> list[float]:
    (path,) = run.folder_name.rglob(f"{name}.csv")
    return np.loadtxt(path, delimiter=",", ndmin=2)[:, 1].tolist()


@pytest.mark.client(
    "BenchMARL", "MAPPO, MASAC and ISAC train rover and walkers, and evaluate", "dune_rl.clients.benchmarl"
)
@pytest.mark.parametrize("algorithm", ["Mappo", "Masac", "Isac"])
def test_rover_and_walkers_learn(algorithm: str, tmp_path: Path, tasks: ModuleType) -> None:
    run = experiment(algorithm, tmp_path, tasks)
    assert run.group_map == GROUPS and run.max_steps == 8
    before = {group: weights_of(run, group) for group in GROUPS}
    run.run()
    assert run.total_frames == 128 and np.isfinite(run.mean_return)
    for group in GROUPS:
        assert (weights_of(run, group) != before[group]).sum() > 100
    # BenchMARL's evaluation: three whole episodes of both groups.
    (written,) = run.folder_name.rglob("*.json")
    steps = json.loads(written.read_text())["dune_rl"]["flat"][algorithm.lower()]["seed_0"]
    for group in GROUPS:
        assert len(steps["step_2"][f"{group}_return"]) == 3
    assert logged(run, "eval_rover_metrics_steps") == [8.0, 8.0]
    # Episodes 0, 1, 2 and then 3, 4, 5.
    assert logged(run, "eval_walker_metrics_episode") == [1.0, 4.0]
    # What BenchMARL adds up of the rewards is the metric that we log.
    returns = logged(run, "eval_rover_reward_episode_reward_mean")
    np.testing.assert_allclose(logged(run, "eval_rover_metrics_return"), returns, rtol=1e-4, atol=1e-5)
    assert logged(run, "collection_rover_metrics_timeout")[0] == 1.0


@pytest.mark.client("BenchMARL", "an `Experiment` goes on from its file", "dune_rl.clients.benchmarl")
def test_an_experiment_goes_on_from_its_file(tmp_path: Path, tasks: ModuleType) -> None:
    from benchmarl.experiment import Experiment

    run = experiment("Ippo", tmp_path, tasks, max_n_iters=1)
    run.run()
    (saved,) = run.folder_name.glob("checkpoints/*.pt")
    again = Experiment.reload_from_file(str(saved), {"max_n_iters": 2})
    assert again.total_frames == 64 and again.task == run.task
    again.run()
    assert again.total_frames == 128


@pytest.mark.client("BenchMARL", "evaluation on episodes of its own", "dune_rl.clients.benchmarl")
def test_evaluation_has_episodes_that_training_never_draws(tmp_path: Path, tasks: ModuleType) -> None:
    run = experiment("Ippo", tmp_path, tasks)
    trained, evaluated = run.collector.env.base_env.simulation, run.test_env.base_env.simulation
    assert evaluated.seed == 0 and trained.seed >= 2**30
    run.close()


@pytest.mark.client("BenchMARL", "specs, groups and pictures of the task", "dune_rl.clients.benchmarl")
def test_the_task(tasks: ModuleType) -> None:
    task = tasks.DuneTask.INSPECTION.get_task()
    assert task.config == {"actors": "external_walkers"} and task.name == "INSPECTION"
    assert task == tasks.DuneTask.INSPECTION.get_task({"actors": "external_walkers"})
    task = tasks.DuneTask.FLAT.get_task(WALKERS)
    env = task.get_env_fun(2, True, 3, "cpu")()
    env = TransformedEnv(env, *task.get_env_transforms(env))
    spec, seen = task.observation_spec(env), env.reset()
    for group, agents in GROUPS.items():
        assert list(spec[group].keys()) == ["observation"]
        assert seen[group, "observation"].shape == (2, *spec[group, "observation"].shape)
        assert task.action_spec(env)[group, "action"].shape == (len(agents), 2)
    picture = task.render_callback(None, env, seen)
    assert picture.shape == (480, 640, 3) and picture.dtype is torch.uint8 and picture.float().std() > 5.0
    env.close()


@pytest.mark.client("BenchMARL", "what it cannot have is named", "dune_rl.clients.benchmarl")
def test_what_benchmarl_cannot_have(tasks: ModuleType) -> None:
    task = tasks.DuneTask.FLAT.get_task(WALKERS)
    with pytest.raises(ConfigError, match="set sampling_device to cpu"):
        task.get_env_fun(2, True, 0, "cuda")
    endless = tasks.DuneTask.FLAT.get_task(
        {"actors": "external_walkers", "overrides": ["~task.terminations.time_limit"]}
    )
    with pytest.raises(ConfigError, match=r"set task\.terminations\.time_limit"):
        endless.max_steps(None)


@pytest.mark.client("BenchMARL", "tasks from YAML", "dune_rl.clients.benchmarl")
def test_settings_from_a_file(tmp_path: Path, tasks: ModuleType) -> None:
    (tmp_path / "two.yaml").write_text("robots: [rover_zero, rover_zero]\nactors: none\n")
    task = tasks.DuneTask.FLAT.get_from_yaml(str(tmp_path / "two.yaml"))
    env = task.get_env_fun(1, True, None, "cpu")()
    assert task.group_map(env) == {"rover": ["rover_0", "rover_1"]} and task.max_steps(env) == 2000
    env.close()


@pytest.mark.client("BenchMARL", "TorchRL is left as it was", "dune_rl.clients.benchmarl")
def test_torchrl_is_left_as_it_was() -> None:
    check = (
        "import torchrl.collectors as collectors; before = set(vars(collectors)); "
        "import dune_rl.clients.benchmarl, benchmarl; assert set(vars(collectors)) == before"
    )
    subprocess.run([sys.executable, "-W", "ignore", "-c", check], check=True, timeout=120)


class WithoutBenchmarl:
    """An importer that finds no BenchMARL."""

    def find_spec(self, name: str, *_: Any) -> None:
        if name == "benchmarl":
            raise ModuleNotFoundError("No module named 'benchmarl'", name=name)


def test_without_benchmarl_it_says_what_to_do(monkeypatch) -> None:
    for name in [*sys.modules]:
        if "benchmarl" in name.split("."):
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(sys, "meta_path", [WithoutBenchmarl(), *sys.meta_path])
    with pytest.raises(ImportError, match=r"pip install --no-deps benchmarl==1\.5\.2"):
        import dune_rl.clients.benchmarl  # noqa: F401
