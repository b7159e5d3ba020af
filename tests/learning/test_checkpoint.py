"""Checkpoints: whole or untouched, harmless to read, and refused in words that help."""

import os
import pickle
import zipfile
from pathlib import Path
from typing import Any

import pytest
import torch
from point_mass import PointMass, make_point_mass
from training import make_sac, trainer

from dune_rl.core.errors import CheckpointError
from dune_rl.core.files import write_atomically
from dune_rl.learning.checkpoint import find_checkpoint_file, read_checkpoint_file, write_checkpoint_file
from dune_rl.learning.group_policy import Deterministic, GroupPolicy
from dune_rl.learning.policy_spec import PolicySpec
from dune_rl.learning.saved_policies import load_group_policy, load_policy, policy_entry

EXPERIMENTS = Path(__file__).parents[2] / "experiments"
SPEC = PolicySpec.of(make_point_mass(1, 0), "rover")


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    path = tmp_path / "policy.pt"
    groups = {"rover": policy_entry(make_sac(SPEC, tmp_path, hidden=(8,)))}
    write_checkpoint_file(path, "policy", {"groups": groups, "config": {"seed": 1}, "frames": 0})
    return path


def test_policy_acts_the_same_after_a_round_trip(tmp_path: Path) -> None:
    sac = make_sac(SPEC, tmp_path, hidden=(8,))
    write_checkpoint_file(
        tmp_path / "policy.pt", "policy", {"groups": {"rover": policy_entry(sac)}, "config": {"seed": 1}}
    )
    env = make_point_mass(4, 0)
    policy, config = load_policy(tmp_path, env)
    now = env.reset()
    expected = Deterministic(sac.policy)(now.clone())["rover", "action"]
    assert torch.equal(policy(now.clone())["rover", "action"], expected)
    assert config == {"seed": 1}


def test_a_crash_while_writing_leaves_the_old_file(saved: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = saved.read_bytes()

    def dies(_content: object, path: Path) -> None:
        path.write_bytes(b"half of")
        raise KeyboardInterrupt

    monkeypatch.setattr(torch, "save", dies)
    with pytest.raises(KeyboardInterrupt):
        write_checkpoint_file(saved, "policy", {})
    assert saved.read_bytes() == before
    assert [path.name for path in saved.parent.iterdir()] == [saved.name]


def test_a_full_disk_is_a_message(saved: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_content: object, _path: Path) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(torch, "save", full)
    with pytest.raises(CheckpointError, match="No space left on device"):
        write_checkpoint_file(saved, "policy", {})
    assert read_checkpoint_file(saved, "policy")["kind"] == "policy"


def test_the_file_appears_only_when_whole(tmp_path: Path) -> None:
    path = tmp_path / "result"
    with write_atomically(path) as temporary:
        temporary.write_text("all")
        assert not path.exists()
    assert path.read_text() == "all"


@pytest.mark.parametrize("share", [0.0, 0.3, 0.99])
def test_truncated(saved: Path, share: float) -> None:
    data = saved.read_bytes()
    saved.write_bytes(data[: int(share * len(data))])
    with pytest.raises(CheckpointError, match="truncated"):
        load_policy(saved, make_point_mass(1, 0))


def test_damaged_inside(saved: Path) -> None:
    data = bytearray(saved.read_bytes())
    start = data.index(b"data.pkl") + 60
    data[start : start + 40] = bytes(40)
    saved.write_bytes(bytes(data))
    with pytest.raises(CheckpointError, match="damaged"):
        load_policy(saved, make_point_mass(1, 0))


def test_what_a_killed_process_left_is_removed(tmp_path: Path) -> None:
    path = tmp_path / "result"
    abandoned, strange = tmp_path / ".result.abc.tmp", tmp_path / ".other.abc.tmp"
    for file in (abandoned, strange):
        file.write_text("half")
        os.utime(file, (0, 0))
    with write_atomically(path) as first:
        first.write_text("first")
        os.utime(first, (0, 0))
        with write_atomically(path) as second:
            # The first is being written.
            assert first.exists() and not abandoned.exists()
            second.write_text("second")
    assert path.read_text() == "first" and sorted(tmp_path.iterdir()) == [strange, path]


def test_missing(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match="There is no"):
        load_policy(tmp_path / "nowhere.pt", make_point_mass(1, 0))
    with pytest.raises(CheckpointError, match=r"holds no policy\.pt or checkpoint\.pt"):
        find_checkpoint_file(tmp_path, "policy.pt", "checkpoint.pt")


class Bomb:
    """Runs code when unpickled."""

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return Path.touch, (Path("exploded"),)  # type: ignore[return-value]


@pytest.mark.parametrize("dump", [torch.save, lambda content, path: path.write_bytes(pickle.dumps(content))])
def test_nothing_in_a_file_is_executed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, dump: object) -> None:
    monkeypatch.chdir(tmp_path)
    dump({"format": "dune_rl", "bomb": Bomb()}, tmp_path / "policy.pt")  # type: ignore[operator]
    with pytest.raises(CheckpointError):
        read_checkpoint_file(tmp_path / "policy.pt", "policy")
    assert not (tmp_path / "exploded").exists()


@pytest.mark.parametrize("missing", ["version", "kind", "groups", "config"])
def test_what_a_file_lacks_is_no_traceback(saved: Path, missing: str) -> None:
    content = torch.load(saved, weights_only=True)
    del content[missing]
    torch.save(content, saved)
    with pytest.raises(CheckpointError) as caught:
        load_policy(saved, make_point_mass(1, 0))
    assert len(str(caught.value).splitlines()) <= 2


def test_an_archive_that_would_fill_the_memory_is_refused(saved: Path) -> None:
    with zipfile.ZipFile(saved) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(saved, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, body in members.items():
            archive.writestr(name, body)
    with pytest.raises(CheckpointError, match="its contents are compressed"):
        read_checkpoint_file(saved, "policy")


def test_not_ours(tmp_path: Path) -> None:
    torch.save({"weights": torch.zeros(1)}, tmp_path / "other.pt")
    with pytest.raises(CheckpointError, match="not written by dune_rl"):
        read_checkpoint_file(tmp_path / "other.pt", "policy")


@pytest.mark.parametrize("version", [1, 99])
def test_another_format(saved: Path, version: int) -> None:
    torch.save({**torch.load(saved, weights_only=True), "version": version}, saved)
    with pytest.raises(CheckpointError, match=f"format {version}"):
        read_checkpoint_file(saved, "policy")


def test_wrong_kind(saved: Path) -> None:
    with pytest.raises(CheckpointError, match="is a policy, but a checkpoint"):
        read_checkpoint_file(saved, "checkpoint")


def test_weights_that_are_not_finite_are_refused(saved: Path) -> None:
    content = torch.load(saved, weights_only=True)
    for values in content["groups"]["rover"]["policy"].values():
        values.fill_(torch.nan)
    torch.save(content, saved)
    with pytest.raises(CheckpointError, match=r"is damaged, .*weights that are not finite"):
        load_policy(saved, PointMass(1, 0))


def change(content: dict[str, Any], path: str, value: Any) -> None:
    """Set the entry at a dotted `path`; delete it where `value` is None."""
    *parents, last = path.split(".")
    for name in parents:
        content = content[name]
    if value is None:
        del content[last]
    else:
        content[last] = value


@pytest.mark.parametrize(
    ("path", "value"),
    [
        *(("random", None), ("random.numpy", None), ("random.torch", torch.zeros(3)), ("log", None)),
        *(("log.history", 3), ("collector.warming", "a"), ("counters.best_score", "a")),
        *(("counters.frames", 10**30), ("counters.frames", -5), ("groups.rover.learner.policy", {})),
    ],
)
def test_a_checkpoint_with_a_damaged_entry_is_refused_and_nothing_is_written(
    path: str, value: Any, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    trainer(run).train(stop_after_frames=64)
    content = torch.load(run / "checkpoint.pt", weights_only=True)
    change(content, path, value)
    torch.save(content, run / "checkpoint.pt")
    before = {file.name: file.read_bytes() for file in run.iterdir()}
    with pytest.raises(CheckpointError, match=r"checkpoint\.pt is damaged"):
        trainer(run, resume=run)
    assert {file.name: file.read_bytes() for file in run.iterdir()} == before


def test_another_observation_is_named(saved: Path) -> None:
    with pytest.raises(CheckpointError, match="lidar has 32 values there, 64 values here") as caught:
        load_policy(saved, PointMass(1, 0, beams=64))
    assert len(str(caught.value).splitlines()) == 2


def test_missing_parts_and_other_bounds_are_named() -> None:
    here = PolicySpec({"goal": 2, "camera": 9}, (-1.0, -1.0), (1.0, 1.0))
    with pytest.raises(CheckpointError) as caught:
        SPEC.require(here, "policy.pt")
    message = str(caught.value)
    assert "only the policy has imu (9 values)" in message
    assert "only this environment has camera (9 values)" in message
    assert "actions lie in [-0.8, 0.8], [-3.14159, 3.14159] there, in [-1, 1], [-1, 1] here" in message


@pytest.mark.parametrize("study", ["flat/seed1", "flat/seed2"])
def test_policies_of_the_studies_load(study: str) -> None:
    file = EXPERIMENTS / study / "policy.pt"
    saved = torch.load(file, weights_only=True)
    assert saved["version"] == 2
    spec = PolicySpec.from_plain(saved["layout"])
    policy, config = load_group_policy(file, "rover", spec)
    assert isinstance(policy, GroupPolicy) and config == saved["config"]
    state = policy.network.state_dict()
    assert all(torch.equal(state[key], value) for key, value in saved["policy"].items())
    assert read_checkpoint_file(file, "policy")["groups"].keys() == {"rover"}
