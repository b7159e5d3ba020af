"""Files of earlier releases are read; those of a later one are refused with the version that they need."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

import dune_rl
from dune_rl import evaluate, train
from dune_rl.config.compose import compose
from dune_rl.config.schema import Conf
from dune_rl.core.errors import CheckpointError, ConfigError
from dune_rl.evaluation.episode_sets.files import FORMAT_VERSION, read_episode_set
from dune_rl.learning.checkpoint import VERSION, read_checkpoint_file

# Made by `tests/helpers/make_release_files.py`, each by its own version.
RELEASES = sorted((Path(__file__).parents[1] / "data").glob("release_*"))
every_release = pytest.mark.parametrize("release", RELEASES, ids=lambda path: path.name)


@every_release
def test_a_releases_files_are_read(release: Path) -> None:
    checkpoint = read_checkpoint_file(release / "run" / "checkpoint.pt", "checkpoint")
    assert f"release_{checkpoint['written_by']}" == release.name
    compose(Conf, [], [], checkpoint["config"])
    for name in ("policy_best.pt", "policy_last.pt"):
        policy = read_checkpoint_file(release / "run" / name, "policy")
        assert policy["groups"].keys() == checkpoint["groups"].keys() == {"rover", "walker"}
    assert [len(kept) for kept in checkpoint["population"]["snapshots"].values()] == [2, 2]
    assert len(read_episode_set(str(release / "tiny-v1.json")).episodes) == 4


@pytest.mark.slow
@every_release
def test_a_releases_run_is_evaluated_and_goes_on(
    release: Path, call: Callable[..., int], folder: Path
) -> None:
    shutil.copytree(release / "run", folder / "run")
    assert call(evaluate.main, "checkpoint=run", "episodes=2", "scenes=2", "out=one") == 0
    named = f"set={release / 'tiny-v1.json'}"
    assert call(evaluate.main, "policy=go_to_goal", named, "episodes=2", "scenes=2", "out=two") == 0
    crossed = ["cross_play=true", "checkpoint=run", "populations=[walkers,run]"]
    assert call(evaluate.main, *crossed, "episodes=1", "scenes=1", "out=three") == 0
    assert call(train.main, "resume=run", "total_frames=160") == 0
    now = read_checkpoint_file(folder / "run" / "checkpoint.pt", "checkpoint")
    assert now["counters"]["frames"] == 160
    assert now["written_by"] == dune_rl.__version__
    assert now["population"]["taken"] > 2


def test_a_checkpoint_of_a_later_version_is_refused_with_that_version(tmp_path: Path) -> None:
    file = tmp_path / "checkpoint.pt"
    later = {"format": "dune_rl", "version": VERSION + 1, "written_by": "7.1.0", "kind": "checkpoint"}
    torch.save(later, file)
    with pytest.raises(CheckpointError) as caught:
        read_checkpoint_file(file, "checkpoint")
    assert str(caught.value).splitlines() == [
        f"{file} has format {VERSION + 1}, of dune_rl 7.1.0; this is dune_rl {dune_rl.__version__}, "
        f"which reads format {VERSION}.",
        "Install the version that wrote it, or a later one.",
    ]


def test_an_episode_set_of_a_later_version_is_refused_with_that_version(tmp_path: Path) -> None:
    file = tmp_path / "set-v1.json"
    header = {"format": "dune_rl episode set", "format_version": FORMAT_VERSION + 1, "written_by": "7.1.0"}
    file.write_text(json.dumps({**header, "unknown": 1}))
    file.with_suffix(".csv").write_text("")
    with pytest.raises(ConfigError, match=r"has format 2, of dune_rl 7\.1\.0; this is dune_rl"):
        read_episode_set(str(file))
