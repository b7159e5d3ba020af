"""Evaluations as Minari datasets: what Minari reads is what the environment gave."""

import csv
import hashlib
import importlib
import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from documents import DOCS, ROOT, code_blocks

import dune_rl
from dune_rl import evaluate
from dune_rl.commands import evaluate as command
from dune_rl.evaluation.datasets import transitions
from dune_rl.evaluation.folder import ResultsFolder

Call = Callable[..., int]
NAME = "dune_rl/flat/go_to_goal-v0"
# Six steps: the first two episodes reach their goals no sooner.
TASK = {"name": "paper", "terminations": {"time_limit": {"max_steps": 6}}}
WORDS = ("+world=flat", "actors=none", "policy=go_to_goal", "task.terminations.time_limit.max_steps=6")


@pytest.fixture(scope="module")
def minari() -> Any:
    pytest.importorskip("h5py")
    return pytest.importorskip("minari")


@pytest.fixture(scope="module")
def dataset(minari: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """Three episodes of seed 5, by two scenes side by side."""
    folder = tmp_path_factory.mktemp("dataset")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setenv("MINARI_DATASETS_PATH", str(folder / "minari"))
        # So that arrays must grow.
        patch.setattr(transitions, "_FIRST_CAPACITY", 2)
        command.run([*WORDS, "seed=5", "episodes=3", "scenes=2", f"dataset={NAME}", "out=results"])
        yield minari.load_dataset(NAME)


@pytest.fixture
def local(minari: Any, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The empty folder of Minari's datasets, in the working folder."""
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(folder / "minari"))
    return folder / "minari"


def assert_equal(episode: Any, other: Any) -> None:
    for part in ("observations", "infos"):
        ours, theirs = getattr(episode, part), getattr(other, part)
        assert ours.keys() == theirs.keys()
        for key, values in ours.items():
            np.testing.assert_array_equal(values, theirs[key], strict=True)
    for part in ("actions", "rewards", "terminations", "truncations"):
        np.testing.assert_array_equal(getattr(episode, part), getattr(other, part), strict=True)


def assert_repeats(episode: Any, env: Any, seed: int, number: int, *, but_last: bool = False) -> None:
    """The environment gives what the `episode` has, where its actions are repeated.

    With `but_last`, the last observation alone may be another one.
    """
    observation, info = env.reset(seed=seed, options={"episode": number})
    for step in range(len(episode) + 1):
        assert observation.keys() == episode.observations.keys()
        for key, value in observation.items():
            if step < len(episode) or not but_last:
                np.testing.assert_array_equal(value, episode.observations[key][step], strict=True)
        assert {"success", "collisions", "return"} <= episode.infos.keys()
        assert {key: info[key] for key in episode.infos} == {
            key: values[step] for key, values in episode.infos.items()
        }
        if step == len(episode):
            return
        observation, reward, terminated, truncated, info = env.step(episode.actions[step])
        assert reward == episode.rewards[step]
        assert (terminated, truncated) == (episode.terminations[step], episode.truncations[step])


def test_minari_reads_what_the_gymnasium_environment_gives(dataset: Any) -> None:
    env = dune_rl.gym_env("flat", actors="none", task=TASK)
    assert dataset.observation_space == env.observation_space and dataset.action_space == env.action_space
    assert dataset.total_episodes == 3 and dataset.total_steps == 18
    for number, episode in enumerate(dataset):
        assert len(episode) == 6 and episode.truncations.tolist() == [False] * 5 + [True]
        assert dataset.observation_space.contains(
            {key: each[3] for key, each in episode.observations.items()}
        )
        assert dataset.action_space.contains(episode.actions[3])
        assert_repeats(episode, env, 5, number)
    first, second = dataset[0].observations["goal"], dataset[1].observations["goal"]
    assert (first != second).all()
    env.close()


def test_the_environment_is_made_again_from_the_dataset(dataset: Any) -> None:
    env = dataset.recover_environment()
    metadata = list(dataset.storage.get_episode_metadata(range(3)))
    for episode, known in zip(dataset, metadata, strict=True):
        assert known["options"] == {"episode": known["episode"]}
        assert_repeats(episode, env.unwrapped, known["seed"], int(known["episode"]))
    env.close()


def test_metadata_and_datasheet_say_what_made_it(dataset: Any) -> None:
    content = dataset.storage.metadata
    origin, sheet = content["dune_rl"], content["description"]
    assert content["algorithm_name"] == origin["policy"]["name"] == "go_to_goal"
    assert "author" not in content and origin["version"] == dune_rl.__version__
    assert origin["settings"]["task"]["terminations"]["time_limit"]["max_steps"] == 6
    assert "checkpoint" not in origin["settings"] and json.dumps(origin)
    assert "3 episodes, 18 transitions of `go_to_goal` in the world `flat`" in sheet
    assert "numbers 0 to 2 of seed 5, on one site" in sheet and "Successful episodes: 0 of 3" in sheet
    for key in dataset.observation_space:
        assert f"| observations/{key} | " in sheet
    assert (dataset.storage.data_path.parent / "DATASHEET.md").read_text() == sheet
    returns = [known["return"] for known in dataset.storage.get_episode_metadata(range(3))]
    assert returns == pytest.approx([episode.rewards.sum() for episode in dataset], abs=1e-4)


def test_the_code_of_the_page_reads_it(dataset: Any, capsys: pytest.CaptureFixture[str]) -> None:
    (text,) = [
        text for language, text in code_blocks(DOCS / "how_to" / "datasets.md") if language == "python"
    ]
    exec(compile(text, "datasets.md", "exec"), {"__name__": "__main__"})
    assert capsys.readouterr().out.startswith("3 18 Dict(")


@pytest.mark.slow(all_but=["scenes"])
@pytest.mark.parametrize(
    "words", [("scenes=3",), ("scenes=1", "processes=2")], ids=["scenes", "scenes and processes"]
)
def test_scenes_and_processes_change_no_number(
    words: tuple[str, ...], dataset: Any, minari: Any, call: Call, local: Path
) -> None:
    own = ("dataset=other-v3", "seed=5", "episodes=3", "out=results")
    assert call(evaluate.main, *WORDS, *own, *words) == 0
    other = minari.load_dataset("other-v3")
    assert len(other) == len(dataset)
    for ours, theirs in zip(dataset, other, strict=True):
        assert_equal(ours, theirs)


def test_an_evaluation_that_was_cut_off_goes_on_to_the_same_dataset(
    dataset: Any, minari: Any, call: Call, local: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = ("seed=5", "episodes=3", "scenes=1", f"dataset={NAME}", "out=results")
    with monkeypatch.context() as patch:
        add = ResultsFolder.add

        def add_two(self: ResultsFolder, episode: Any) -> None:
            if len(self.finished) == 2:
                raise KeyboardInterrupt
            add(self, episode)

        patch.setattr(ResultsFolder, "add", add_two)
        assert call(evaluate.main, *WORDS, *own) != 0
    assert not (local / NAME).exists() and len(list(Path("results/transitions.part").iterdir())) == 3
    Path("results/transitions.part/episode_2.npz").unlink()
    assert call(evaluate.main, "resume=results") == 0
    assert not Path("results/transitions.part").exists()
    for ours, theirs in zip(dataset, minari.load_dataset(NAME), strict=True):
        assert_equal(ours, theirs)


def test_a_dataset_is_replaced_by_overwrite_alone(
    minari: Any, call: Call, local: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = ("episodes=1", "dataset=mine-v0")
    assert call(evaluate.main, *WORDS, *own, "out=first") == 0
    assert call(evaluate.main, *WORDS, "episodes=1", "out=without") == 0
    assert Path("first/episodes.csv").read_text() == Path("without/episodes.csv").read_text()
    assert call(evaluate.main, *WORDS, *own, "out=second", "seed=1") == 2
    assert f"dataset=mine-v0 is there already, in {local / 'mine-v0'}; choose" in capsys.readouterr().err
    assert not Path("second").exists()
    assert call(evaluate.main, *WORDS, *own, "out=second", "seed=1", "overwrite=true") == 0
    assert next(iter(minari.load_dataset("mine-v0").storage.get_episode_metadata([0])))["seed"] == 1
    # Nothing half written stays behind.
    assert [path.name for path in local.iterdir()] == ["mine-v0"]
    # "mine-v0/planner-v0" is a dataset, too.
    (local / "mine-v0" / "planner-v0").mkdir()
    assert call(evaluate.main, *WORDS, *own, "out=third", "overwrite=true") == 2
    assert f"dataset=mine-v0: {local / 'mine-v0'} holds other files (planner-v0)" in capsys.readouterr().err
    assert (local / "mine-v0" / "planner-v0").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("dataset=mine",), "dataset: NAMESPACE/NAME-vN names a dataset"),
        (("dataset=../mine-v0",), "dataset: NAMESPACE/NAME-vN names a dataset"),
        (("dataset=/tmp/mine-v0",), "dataset: NAMESPACE/NAME-vN names a dataset"),
        (("against=random",), "is of one policy; evaluate each"),
        (("protocol=paper",), "does not go with protocol"),
        (("part=1/2",), "does not go with part"),
        (("cross_play=true", "populations=none"), "does not go with cross_play"),
        (("processes=ray",), "does not go with processes=ray"),
        (("robots=[rover_zero,rover_zero]",), "here are rover_0, rover_1"),
    ],
)
def test_what_cannot_be_a_dataset_is_named(
    words: tuple[str, ...], message: str, call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = () if words[0].startswith("dataset") else ("dataset=mine-v0",)
    assert call(evaluate.main, *WORDS, *own, *words, "out=results") == 2
    error = capsys.readouterr().err
    assert message in error and "Traceback" not in error and error.count("\n") <= 2
    assert not (folder / "results").exists()


@pytest.mark.parametrize("package", ["minari", "h5py"])
def test_the_extra_is_named_where_it_is_missing(
    package: str,
    call: Call,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    for name in [each for each in sys.modules if each.partition(".")[0] == "minari"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    assert call(evaluate.main, *WORDS, "episodes=1", "dataset=mine-v0", "out=results") == 2
    assert "dataset=mine-v0 needs Minari: pip install 'dune_rl[datasets]'" in capsys.readouterr().err
    assert not (folder / "results").exists()
    assert call(evaluate.main, *WORDS, "episodes=1", "out=results") == 0
    assert not any(path.is_dir() for path in (folder / "results").iterdir())


@pytest.mark.slow
@pytest.mark.parametrize("repeat", [1, 2])
def test_episodes_of_all_lengths_among_walkers(repeat: int, minari: Any, call: Call, local: Path) -> None:
    words = ("+world=flat", "policy=planner", "seed=3", "episodes=5", "scenes=3")
    more = ("task.terminations.time_limit.max_steps=120", f"physics.action_repeat={repeat}")
    assert call(evaluate.main, *words, *more, "dataset=mine-v0", "out=results") == 0
    dataset = minari.load_dataset("mine-v0")
    assert len({len(episode) for episode in dataset}) > 2
    assert {True, False} == {bool(episode.terminations[-1]) for episode in dataset}
    rows = list(csv.DictReader(Path("results/episodes.csv").read_text().splitlines()))
    env = dataset.recover_environment()
    for number, (episode, row) in enumerate(zip(dataset, rows, strict=True)):
        assert episode.infos["steps"][-1] == float(row["steps"])
        assert len(episode) == -(-float(row["steps"]) // repeat)
        # Some episodes end between two control steps of one action.
        assert_repeats(episode, env.unwrapped, 3, number, but_last=repeat > 1)
    assert any(float(row["steps"]) % repeat for row in rows) == (repeat > 1)
    env.close()


@pytest.mark.slow
def test_the_episodes_of_a_set_are_made_again(minari: Any, call: Call, local: Path) -> None:
    words = ("set=inspection-v1", "policy=go_to_goal", "episodes=2", "scenes=2")
    assert call(evaluate.main, *words, "dataset=mine-v0", "out=results") == 0
    dataset = minari.load_dataset("mine-v0")
    known = list(dataset.storage.get_episode_metadata([0, 1]))
    origin = dataset.storage.metadata["dune_rl"]
    assert origin["episode_set"]["name"] == "inspection-v1" and len(origin["episode_set"]["sha256"]) == 64
    assert known[1]["world_seed"] == 500 and known[1]["goal_x_m"] != known[0]["goal_x_m"]
    env = dataset.recover_environment()
    assert_repeats(dataset[1], env.unwrapped, known[1]["seed"], 1)
    env.close()


@pytest.mark.slow
def test_weights_of_a_checkpoint_are_known_by_their_checksum(minari: Any, call: Call, local: Path) -> None:
    file = ROOT / "experiments" / "inspection" / "policy.pt"
    words = (f"checkpoint={file}", "episodes=1", "task.terminations.time_limit.max_steps=4")
    assert call(evaluate.main, *words, "dataset=mine-v0", "out=results") == 0
    content = minari.load_dataset("mine-v0").storage.metadata
    checksum = hashlib.sha256(file.read_bytes()).hexdigest()
    assert (
        content["algorithm_name"] == "sac: inspection" and content["dune_rl"]["policy"]["sha256"] == checksum
    )
    assert f"SHA-256 `{checksum}`" in content["description"]
    # The settings are the environment's: no path of this machine is among them.
    assert str(ROOT) not in json.dumps(content["dune_rl"]) + content["description"]


@pytest.mark.slow
def test_pictures_are_kept_as_they_were(minari: Any, call: Call, local: Path) -> None:
    words = (*WORDS, "sensors=[camera,goal]", "episodes=1")
    assert call(evaluate.main, *words, "dataset=mine-v0", "out=results") == 0
    dataset = minari.load_dataset("mine-v0")
    # Of a kind and size that Minari would compress.
    space = dataset.observation_space["camera_rgb"]
    assert space.dtype == np.uint8 and min(space.shape[:2]) >= 32
    assert f"| observations/camera_rgb | {space.shape} | uint8 |" in dataset.storage.metadata["description"]
    env = dataset.recover_environment()
    assert_repeats(dataset[0], env.unwrapped, 0, 0)
    env.close()


def _successes(path: Path) -> list[float]:
    return [float(row["success"]) for row in csv.DictReader((path / "episodes.csv").read_text().splitlines())]


@pytest.mark.slow
def test_a_clone_of_a_driver_reaches_goals_in_new_episodes(
    minari: Any, call: Call, local: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(ROOT / "examples")
    example = importlib.import_module("behaviour_cloning")
    words = ("+world=flat", "actors=none", "scenes=20")
    own = ("policy=go_to_goal", "episodes=30", f"dataset={NAME}", "out=driver")
    assert call(evaluate.main, *words, *own) == 0
    drive = (*words, "policy=behaviour_cloning:Clone", "episodes=20")
    found = []
    for seed in (1, 2, 3):
        example.main([NAME, "--updates", "1500", "--seed", str(seed)])
        assert call(evaluate.main, *drive, f"seed={seed}", f"out=clone_{seed}") == 0
        found += _successes(Path(f"clone_{seed}"))
    assert np.mean(found) > 0.8, found
    # Hardly trained, it does not.
    example.main([NAME, "--updates", "1"])
    assert call(evaluate.main, *drive, "out=novice", "task.terminations.time_limit.max_steps=200") == 0
    assert np.mean(_successes(Path("novice"))) < 0.5


def test_a_clone_learns_nothing_from_failures(
    dataset: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(ROOT / "examples")
    example = importlib.import_module("behaviour_cloning")
    with pytest.raises(SystemExit, match=f"no episode of {NAME} succeeded; add --all-episodes"):
        example.main([NAME])
    example.main([NAME, "--updates", "2", "--all-episodes"])
    assert "18 transitions" in capsys.readouterr().out
    observation = {key: each[:4] for key, each in dataset[0].observations.items()}
    actions = example.Clone()(observation)
    assert actions.shape == (4, 2) and np.isfinite(actions).all()
