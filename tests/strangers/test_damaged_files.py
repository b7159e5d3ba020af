"""Damaged and hostile files: they are read, or refused in a few words; they never do anything else.

`experiments/reliability/strangers.py` reads many more of them.
"""

from pathlib import Path

import pytest
from strangers.samples import REAL_WORLDS, SAMPLES
from strangers.watch import ACCEPTED, DEFECT, REFUSED, Sample, run_damaged

from dune_rl.config.compose import compose
from dune_rl.config.schema import Conf
from dune_rl.core.errors import ConfigError
from dune_rl.core.untrusted_files import parse_yaml

# Formats that are read in milliseconds.
FAST = ("heights_npy", "actors_csv", "actors_json", "page")
# Formats of which some hundred files have been read without a fault that is left.
CHECKED = (
    *FAST,
    *("obj", "stl", "ply", "glb", "dae", "textured_obj", "textured_glb", "textured_dae", "sdf", "urdf"),
    *("heights_tif", "heights_png", "surfaces", "actors_sdf", "cache", "yaml", "command_line"),
    *("forecast", "episode_set", "evaluation", "runs", "policy", "results"),
)


def faults_of(kind: str, numbers: range, folder: Path) -> list[str]:
    found = list(run_damaged(SAMPLES[kind], numbers, folder))
    assert [one.number for one in found] == list(numbers)
    # Both happen, or the damage is too little or too much to try anything.
    assert {ACCEPTED, REFUSED} & {one.result for one in found}
    return [f"{kind} {one.number}: {one.detail}" for one in found if one.result == DEFECT]


@pytest.mark.parametrize("kind", FAST)
def test_some_damaged_files_do_no_harm(kind: str, tmp_path: Path) -> None:
    # The last of these are damaged at random, the others are attacks.
    assert faults_of(kind, range(0, 120, 3), tmp_path) == []


@pytest.mark.slow
@pytest.mark.parametrize("kind", CHECKED)
def test_damaged_files_do_no_harm(kind: str, tmp_path: Path) -> None:
    assert faults_of(kind, range(100), tmp_path) == []


@pytest.mark.slow
@pytest.mark.parametrize("kind", REAL_WORLDS)
def test_damaged_worlds_of_others_do_no_harm(kind: str, tmp_path: Path) -> None:
    if kind not in SAMPLES:
        pytest.skip("the worlds of others are not here")
    assert faults_of(kind, range(100, 140), tmp_path) == []


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("a: &a [b]\nc: *a\nd: {<<: {e: 1}}", None),
        ("&a [*a]", "more than"),
        ("a: &a0 [x]\n" + "".join(f"b{n}: &a{n + 1} [{f'*a{n},' * 9}]\n" for n in range(9)), "more than"),
        ("{" * 1000, "nested more than 200 deep"),
        ("- " * 5000, "nested too deeply"),
        ("!!python/object/apply:os.system [x]", "could not determine a constructor"),
        ("a: " + "9" * 5000, "4300 digits"),
    ],
)
def test_yaml_is_plain_and_of_limited_size(text: str, reason: str | None) -> None:
    if reason is None:
        assert parse_yaml(text) == {"a": ["b"], "c": ["b"], "d": {"e": 1}}
    else:
        with pytest.raises(ValueError, match=reason):
            parse_yaml(text)


def _reads_outside(folder: Path) -> None:
    Path("/etc/hostname").read_bytes()


def _runs_a_command(folder: Path) -> None:
    import subprocess

    subprocess.run(["true"], check=True)


def _opens_a_socket(folder: Path) -> None:
    import socket

    with socket.socket() as one:
        one.settimeout(0.1)
        one.connect(("127.0.0.1", 9))


def _imports_from_the_folder(folder: Path) -> None:
    import runpy

    runpy.run_path(str(folder / "code.py"))


def _takes_memory(folder: Path) -> None:
    assert len(b"x" * (3 * 2**30))


def _crashes(folder: Path) -> None:
    import os
    import signal

    os.kill(os.getpid(), signal.SIGKILL)


def _fails(folder: Path) -> None:
    raise KeyError("a fault of ours")


@pytest.mark.parametrize(
    ("harm", "detail"),
    [
        (_reads_outside, "reads '/etc/hostname'"),
        (_runs_a_command, "subprocess.Popen"),
        (_opens_a_socket, "socket.connect"),
        (_imports_from_the_folder, "code of "),
        (_crashes, "crash: exit code -9"),
        (_fails, "KeyError at "),
        pytest.param(_takes_memory, "memory: 3", marks=pytest.mark.slow),
    ],
)
def test_harm_is_noticed(harm, detail: str, tmp_path: Path) -> None:
    def make(folder: Path) -> Sample:
        (folder / "code.py").write_text("a = 1\n")
        path = folder / "sample.txt"
        path.write_text("whole sample")

        def read() -> None:
            if path.read_text(errors="replace") != "whole sample":
                harm(folder)

        return Sample({path: "text"}, read)

    (found,) = run_damaged(make, [3], tmp_path)
    assert found.result == DEFECT and found.detail.startswith(detail)


def test_an_option_that_hydra_would_read_for_ever_is_refused(tmp_path: Path) -> None:
    (tmp_path / "experiment").mkdir()
    file = tmp_path / "experiment" / "mine.yaml"
    laughs = [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]" for n in range(1, 10)]
    file.write_text("\n".join(["a0: &a0 [x, x]", *laughs]))
    with pytest.raises(ConfigError, match=r"mine\.yaml cannot be read: it has more than"):
        compose(Conf, ["+world=flat", "+experiment=mine"], [str(tmp_path)])
