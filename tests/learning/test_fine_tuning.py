"""Trainings that start from what an earlier run learned."""

from pathlib import Path

import pytest
import torch
from point_mass import make_point_mass, make_two_groups
from training import small, trainer, weights

from dune_rl.commands.resuming import find_named_run
from dune_rl.config.compose import compose
from dune_rl.config.schema import Conf
from dune_rl.core.errors import CheckpointError, ConfigError, DuneWarning
from dune_rl.core.files import sha256_of
from dune_rl.learning.checkpoint import (
    BEST_POLICY_FILE,
    CHECKPOINT_FILE,
    LAST_POLICY_FILE,
    read_policy_file,
    write_checkpoint_file,
)
from dune_rl.learning.learners import start_learners
from dune_rl.learning.settings import EvaluationConf
from dune_rl.learning.trainer import Trainer

FEW = EvaluationConf(every_frames=10_000, episodes=2, scenes=2)
SHORT = small(hidden=(8,), learning_starts=128, evaluation=FEW)


@pytest.fixture(scope="module")
def source(tmp_path_factory) -> Path:
    """A short run of a point mass."""
    run = tmp_path_factory.mktemp("runs") / "source"
    trainer(run, SHORT, total_frames=384).train()
    return run


def begun(folder: Path, start_from: Path | str, **changes: object) -> Trainer:
    """A run that starts from another, before its first frame."""
    learning = SHORT.model_copy(update={"start_from": str(start_from), **changes})
    made = trainer(folder, learning, total_frames=384)
    made._log.close()
    made._folder.release()
    return made


def learned(made: Trainer) -> dict[str, torch.Tensor]:
    """The weights of a learner: those of its policy, and those of its critics and entropy coefficient."""
    state = made._learners["rover"].state_dict()
    return {**state["policy"], **state["loss"]}


@pytest.mark.slow
def test_a_run_starts_with_policy_and_critics_of_the_last_checkpoint(source: Path, tmp_path: Path) -> None:
    made = begun(tmp_path / "run", source)
    found, saved = learned(made), weights(source)
    assert found.keys() <= {key.removeprefix("rover.") for key in saved}
    assert all(torch.equal(value, saved[f"rover.{key}"]) for key, value in found.items())
    assert made.frames == 0 and made.updates == 0


def test_a_policys_file_leaves_the_critics_new(source: Path, tmp_path: Path) -> None:
    with pytest.warns(DuneWarning, match=r"learning\.start_from: .* has a policy alone; its critics"):
        tuned = begun(tmp_path / "a", source / LAST_POLICY_FILE)
    made = trainer(tmp_path / "b", SHORT)
    policy = made._learners["rover"].state_dict()["policy"]
    found, saved = learned(tuned), weights(source)
    different = {key for key, value in found.items() if not torch.equal(value, saved[f"rover.{key}"])}
    assert different and not different & policy.keys()
    made._log.close()
    made._folder.release()


def test_it_learns_on_and_is_resumed_without_its_source(source: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    copy = tmp_path / "copy"
    copy.mkdir()
    (copy / CHECKPOINT_FILE).write_bytes((source / CHECKPOINT_FILE).read_bytes())
    learning = SHORT.model_copy(update={"start_from": str(copy), "warm_up": "policy"})
    made = trainer(run, learning, total_frames=384)
    # Its own policy acts from the first frame on, and learns from frame 128 on.
    assert made._warmup.describe(0) is None
    first = made.train(256)
    assert first.frames == 256 and first.updates > 0
    began = {"rover": {"file": str(copy / CHECKPOINT_FILE), "sha256": sha256_of(source / CHECKPOINT_FILE)}}
    (copy / CHECKPOINT_FILE).unlink()
    second = trainer(run, learning, total_frames=384, resume=run).train()
    assert second.frames == 384 and second.updates > first.updates
    assert read_policy_file(run)[1]["started_from"] == began


def test_what_does_not_fit_is_named_with_its_setting(source: Path, tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match=r"learning\.start_from: There is no .*none\.pt"):
        begun(tmp_path / "a", tmp_path / "none.pt")
    shape = r"learning\.start_from: .*has other networks\. Set learning\.hidden=\[8\]"
    with pytest.raises(CheckpointError, match=shape):
        begun(tmp_path / "b", source, hidden=(4,))
    walker = {"walker": {"start_from": str(source), "hidden": [4]}}
    learning = type(SHORT).model_validate({**SHORT.model_dump(), "groups": walker})
    with pytest.raises(
        CheckpointError,
        match=r"learning\.groups\.walker\.start_from: .*learning\.groups\.walker\.hidden=\[8\]",
    ):
        trainer(tmp_path / "c", learning, make_env=make_two_groups)
    # The networks are the group's own, whoever says where it starts.
    with pytest.raises(CheckpointError, match=r"Set learning\.groups\.rover\.hidden=\[8\]"):
        begun(tmp_path / "d", source, groups={"rover": {"hidden": [4]}})


def two_groups(source: Path, run: Path, walker: dict[str, object]) -> Trainer:
    """A rover and walkers that begin with the point mass of `source`, with settings of the walkers."""
    learning = type(SHORT).model_validate(
        {**SHORT.model_dump(), "start_from": str(source), "groups": {"walker": walker}}
    )
    made = trainer(run, learning, make_env=make_two_groups)
    made._log.close()
    made._folder.release()
    return made


def test_a_group_that_was_not_there_begins_anew_where_it_says_so(source: Path, tmp_path: Path) -> None:
    what_to_do = r"no policy for the group walker.*\n.*learning\.groups\.walker\.start_from=null"
    with pytest.raises(CheckpointError, match=what_to_do):
        two_groups(source, tmp_path / "a", {"hidden": [8]})
    made = two_groups(source, tmp_path / "b", {"start_from": None})
    saved = weights(source)
    for group, same in (("rover", True), ("walker", False)):
        policy = made._learners[group].state_dict()["policy"]
        assert all(torch.equal(value, saved[f"rover.{key}"]) for key, value in policy.items()) == same
    # By its own setting it takes the only policy that there is.
    made = two_groups(source, tmp_path / "c", {"start_from": str(source)})
    policy = made._learners["walker"].state_dict()["policy"]
    assert all(torch.equal(value, saved[f"rover.{key}"]) for key, value in policy.items())


def test_a_frozen_group_starts_from_nothing(source: Path, tmp_path: Path) -> None:
    groups = {"rover": {"frozen": str(source / BEST_POLICY_FILE)}}
    learning = type(SHORT).model_validate(
        {**SHORT.model_dump(), "start_from": str(tmp_path / "none.pt"), "groups": groups}
    )
    made = trainer(tmp_path / "run", SHORT, make_env=make_point_mass)
    start_learners(made._learners, learning)
    made._log.close()
    made._folder.release()


@pytest.mark.slow
@pytest.mark.parametrize(
    "word", ["learning.start_from=runs/a", "learning.groups={rover: {start_from: runs/a}}"]
)
def test_a_resumed_run_starts_from_nothing_else(word: str, tmp_path: Path) -> None:
    conf = compose(Conf, ["+world=flat", "actors=none", "learning.start_from=runs/b"])
    counters = {"frames": 5, "evaluated_at": 5}
    content = {"groups": {}, "config": conf.model_dump(mode="json"), "counters": counters}
    write_checkpoint_file(tmp_path / CHECKPOINT_FILE, "checkpoint", content)
    with pytest.raises(ConfigError, match=r"start_from=runs/a: a resumed run goes on with its own weights"):
        find_named_run(str(tmp_path), [word], ())
    resumed = find_named_run(str(tmp_path), ["total_frames=7"], ()).conf
    assert resumed.total_frames == 7
    assert resumed.learning.start_from == "runs/b"
    # Nothing would be trained.
    with pytest.raises(
        ConfigError, match=r"finished run of 5 frames, and total_frames is 5: .*total_frames=10"
    ):
        find_named_run(str(tmp_path), ["total_frames=5"], ())
