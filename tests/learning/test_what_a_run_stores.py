"""What a run's files say of it: the precision that it used, and which policy each holds."""

import csv
import warnings
from pathlib import Path

import pytest
import torch
from training import small, trainer

from dune_rl.core.errors import DuneWarning
from dune_rl.learning.checkpoint import (
    BEST_POLICY_FILE,
    CHECKPOINT_FILE,
    LAST_POLICY_FILE,
    POLICY_SOURCES,
    find_checkpoint_file,
    read_checkpoint_file,
)
from dune_rl.learning.sac import settings
from dune_rl.learning.sac.settings import SacConf
from dune_rl.learning.saved_policies import describe_selection

EXPERIMENTS = Path(__file__).parents[2] / "experiments"
PUBLISHED = sorted(EXPERIMENTS.rglob("policy.pt"))


@pytest.fixture(params=[True, False], ids=["with bfloat16", "without"])
def has_fast_bfloat16(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> bool:
    """Whether this processor says that it is fast at bfloat16."""
    monkeypatch.setattr(settings, "has_fast_bfloat16", lambda device: request.param)
    return bool(request.param)


@pytest.mark.slow(all_but=["without"])
def test_automatic_precision_is_stored_as_what_was_used(has_fast_bfloat16: bool, tmp_path: Path) -> None:
    used = "bfloat16" if has_fast_bfloat16 else "float32"
    run = trainer(tmp_path / "run", small(precision="auto", hidden=(8,)), total_frames=256)
    assert run.config["learning"]["precision"] == used
    run.train()
    for name, kind in ((CHECKPOINT_FILE, "checkpoint"), (BEST_POLICY_FILE, "policy")):
        saved = read_checkpoint_file(tmp_path / "run" / name, kind)
        assert saved["config"]["learning"]["precision"] == used


@pytest.mark.parametrize(
    ("instructions", "fast"), [(["avx512_f"], False), (["avx512_bf16"], True), (["amx_bf16"], True)]
)
def test_processors_with_instructions_for_it_are_fast_at_bfloat16(
    instructions: list[str], fast: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: dict.fromkeys(instructions, True))
    assert settings.has_fast_bfloat16("cpu") == fast


def test_a_choice_of_the_user_stays(has_fast_bfloat16: bool) -> None:
    for chosen in ("float32", "bfloat16"):
        assert SacConf(precision=chosen).resolved("cpu").precision == chosen


@pytest.mark.slow
def test_going_on_with_another_precision_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    learning = small(precision="auto", hidden=(8,))
    monkeypatch.setattr(settings, "has_fast_bfloat16", lambda device: True)
    trainer(tmp_path / "run", learning, total_frames=256).train()
    resume = {"resume": tmp_path / "run", "total_frames": 384}

    monkeypatch.setattr(settings, "has_fast_bfloat16", lambda device: False)
    with pytest.warns(DuneWarning, match="goes on with learning.precision=float32; before, it was bfloat16"):
        trainer(tmp_path / "run", learning, **resume)._folder.release()
    with pytest.warns(DuneWarning, match="bfloat16, at which this processor is slower"):
        trainer(tmp_path / "run", small(precision="bfloat16", hidden=(8,)), **resume)._folder.release()
    monkeypatch.setattr(settings, "has_fast_bfloat16", lambda device: True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        trainer(tmp_path / "run", learning, **resume)._folder.release()


@pytest.mark.slow
def test_policies_say_how_they_were_chosen(tmp_path: Path) -> None:
    run = trainer(tmp_path / "run")
    result = run.train()
    evaluations = [row for row in result.history if row["kind"] == "eval"]
    best = read_checkpoint_file(tmp_path / "run" / BEST_POLICY_FILE, "policy")
    chosen = max(evaluations, key=lambda row: (row["SR"], row["frames"]))
    assert best["frames"] == chosen["frames"]
    assert best["selection"] == {
        "by": "best evaluation",
        "measure": "SR",
        "score": pytest.approx(chosen["SR"]),
        "episodes": 10,
        "seed": 3 + 1_000_003,
    }
    last = read_checkpoint_file(tmp_path / "run" / LAST_POLICY_FILE, "policy")
    assert last["selection"] == {"by": "latest"} and last["frames"] == result.frames
    assert describe_selection(last) == "latest of its run, after 2,048 frames"
    assert describe_selection(best).startswith(f"best evaluation of its run (SR {chosen['SR']:.3g} of 10 ")
    checkpoint = read_checkpoint_file(tmp_path / "run" / CHECKPOINT_FILE, "checkpoint")
    assert describe_selection(checkpoint) == "latest, after 2,048 frames"


def test_a_folder_stands_for_its_best_policy_or_the_published_one(tmp_path: Path) -> None:
    for name in (CHECKPOINT_FILE, LAST_POLICY_FILE, "policy.pt", BEST_POLICY_FILE):
        (tmp_path / name).touch()
    for name in (BEST_POLICY_FILE, "policy.pt", CHECKPOINT_FILE):
        assert find_checkpoint_file(tmp_path, *POLICY_SOURCES).name == name
        (tmp_path / name).unlink()


@pytest.mark.parametrize("file", PUBLISHED, ids=lambda file: str(file.parent.relative_to(EXPERIMENTS)))
def test_published_policies_are_what_their_study_says(file: Path) -> None:
    """The policy at the end of its run, as the file says, or the page of its study."""
    content = read_checkpoint_file(file, "policy")
    with (file.parent / "metrics.csv").open() as rows:
        last = max(int(row["frames"]) for row in csv.DictReader(rows))
    assert content["frames"] == last >= content["config"]["total_frames"]
    if "selection" in content:
        # The best evaluation may be the one at the end.
        assert content["selection"]["by"] in ("latest", "best evaluation")
    else:
        folders = (file.parent, file.parents[1])
        page = next(folder / "README.md" for folder in folders if (folder / "README.md").exists())
        assert "`policy.pt` is the policy at the end of" in page.read_text()
    assert "after" in describe_selection(content)
