"""`python -m dune_rl.doctor`: what is missing is named, and other versions and results are told."""

import json
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from documents import ROOT

from dune_rl import doctor
from dune_rl.commands.doctor import checks
from dune_rl.commands.doctor.reference import REFERENCE, Reference, compare_drives
from dune_rl.core import machine

Call = Callable[..., int]


def pretend(monkeypatch: pytest.MonkeyPatch, name: str, found: str | None) -> None:
    def version_of(package: str) -> str:
        if package == name and found is None:
            raise PackageNotFoundError(package)
        return str(found) if package == name else version(package)

    monkeypatch.setattr(machine, "version", version_of)


@pytest.mark.parametrize(
    ("found", "told"),
    [("0.1", "numba 0.1, but >=0.61 is needed"), (None, "no numba, but >=0.61 is needed")],
)
def test_a_package_that_does_not_do_is_named_with_its_remedy(
    found: str | None, told: str, folder: Path, monkeypatch: pytest.MonkeyPatch, call: Call,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    pretend(monkeypatch, "numba", found)
    assert call(doctor.main, "out=here.json") == 2
    said = capsys.readouterr()
    words = " ".join(said.out.split())
    assert f"{told}: pip install 'numba==" in words and "1 to be mended" in words
    assert "here.json was not written: mend first" in said.err and not (folder / "here.json").exists()
    assert "control steps" not in words


HIDE = """
import sys
class Hidden:
    def find_spec(self, name, *rest):
        if name.partition(".")[0] == "{name}":
            raise {error}
sys.meta_path.insert(0, Hidden())
sys.argv[1:] = {words}
from dune_rl.{command} import main
main()
"""


def run_without(name: str, error: str, command: str, *words: str) -> "subprocess.CompletedProcess[str]":
    """A command where importing the module `name` raises `error`."""
    code = HIDE.format(name=name, error=error, command=command, words=words)
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=240, check=False
    )


@pytest.mark.parametrize("name", ["numba", "gymnasium", "torchrl"])
def test_a_package_that_cannot_be_imported_is_named(name: str) -> None:
    done = run_without(name, f"ModuleNotFoundError('{name} is broken', name='{name}')", "doctor")
    assert done.returncode == 2, done.stderr
    words = " ".join(done.stdout.split())
    assert f"{name} cannot be imported: {name} is broken. Install the tested versions" in words
    assert "to be mended" in words and "control steps" not in words and not done.stderr


@pytest.mark.parametrize("command", ["doctor", "evaluate"])
@pytest.mark.parametrize(("name", "package"), [("pydantic", "pydantic>=2.10"), ("packaging", "packaging")])
def test_a_command_names_the_missing_package_that_ends_it(name: str, package: str, command: str) -> None:
    words = ["+world=flat", "policy=random"] if command == "evaluate" else []
    done = run_without(name, f"ModuleNotFoundError(name='{name}')", command, *words)
    assert done.returncode == 2
    (told,) = done.stderr.splitlines()
    assert told.startswith(f"dune_rl needs {package}, which is not installed; pip install '{package}', ")
    assert "dune_rl.doctor names all that is missing" in told


def test_all_that_is_needed_is_imported_by_its_name() -> None:
    for package in machine.required_packages():
        assert find_spec(machine.module_name(package.name)), package


def test_where_the_package_is_not_installed_nothing_is_said_to_be_well(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(checks, "required_packages", lambda extra="": [])
    (found,) = checks.check_packages({})
    assert found.is_fault and "not installed" in found.text


def test_other_versions_than_the_reference_s_are_told_and_are_no_fault(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pretend(monkeypatch, "numba", "99.0+cpu")
    for tested, told in (("0.68", "other than in the reference: numba 99.0+cpu (0.68)"), ("99.0", "as in")):
        (found,) = [each for each in checks.check_packages({"numba": tested}) if each.subject == "versions"]
        assert found.text.startswith(told) and not found.is_fault


def test_an_absent_extra_is_told_with_what_it_is_for(monkeypatch: pytest.MonkeyPatch) -> None:
    pretend(monkeypatch, "onnxruntime", None)
    (found,) = [each for each in checks.check_packages({}) if each.subject == "extra"]
    assert "policies in ONNX files" in found.text and "dune_rl[onnx]" in found.text and not found.is_fault


HERE = Reference(
    processor="Pentium",
    versions={"numba": "1"},
    digests={"bullet flat": "a", "dart flat": "b"},
    steps_per_s=1,
)


@pytest.mark.parametrize(
    ("there", "given", "told", "is_fault"),
    [
        ({}, False, "2 of 2 drives have the reference's bytes", False),
        ({"digests": {"bullet flat": "x"}}, False, "(bullet flat): though processor and versions", True),
        ({"digests": {"bullet flat": "x"}}, False, "not compared: dart flat", True),
        ({"digests": {"bullet flat": "x"}, "processor": "Z80"}, False, "its processor is Z80", False),
        ({"digests": {"bullet flat": "x"}, "versions": {"numba": "2"}}, False, "its versions are", False),
        ({"digests": {"bullet flat": "x"}, "git": {"commit": "c"}}, True, "its code may be other", False),
        ({"digests": {"bullet flat": "x"}, "git": {"commit": "c"}}, False, "should not be", True),
        ({"digests": {}}, False, "the reference has none of the drives", True),
    ],
)
def test_drives_that_differ_are_named_with_the_reason(
    there: dict[str, Any], given: bool, told: str, is_fault: bool
) -> None:
    found = compare_drives(HERE, HERE.model_copy(update=there), given)
    assert told in found.text and found.is_fault == is_fault


def test_changed_code_is_a_reason_to_differ() -> None:
    here = HERE.model_copy(update={"git": {"commit": "c", "changed": True}, "digests": {"bullet flat": "x"}})
    found = compare_drives(here, HERE, is_given=False)
    assert "the code here has changes" in found.text and not found.is_fault


def test_a_folder_that_cannot_be_written_is_a_fault(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "file").write_text("")
    for place in (folder / "file" / "cache", folder / ("x" * 300)):
        monkeypatch.setenv("DUNE_RL_CACHE", str(place))
        assert checks.check_cache().is_fault
    monkeypatch.setenv("DUNE_RL_CACHE", str(folder / "new" / "cache"))
    assert not checks.check_cache().is_fault


@pytest.mark.parametrize("change", [{"versions": {"numba": 3}}, {"steps_per_s": 0}, {"digests": None}])
def test_a_file_of_something_else_is_refused(
    change: dict[str, Any], folder: Path, call: Call, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "other.json").write_text(json.dumps({**HERE.model_dump(), **change}))
    assert call(doctor.main, "reference=other.json") == 2
    assert "reference=other.json: is not a file that doctor wrote" in capsys.readouterr().err
    assert call(doctor.main, "reference=none.json") == 2
    assert "reference=none.json: No such file" in capsys.readouterr().err


@pytest.mark.parametrize("place", [".", "none/here.json", "/dev/null", "x" * 300])
def test_a_place_that_takes_no_file_is_told_before_anything_else(
    place: str, folder: Path, call: Call, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(doctor.main, f"out={place}") == 2
    said = capsys.readouterr()
    assert f"out={place}: no file can be written there" in said.err and not said.out


@pytest.mark.parametrize("word", ["word", "outt=x", "out="])
def test_other_words_are_refused(word: str, call: Call, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(doctor.main, word) == 2
    assert "usage: python -m dune_rl.doctor" in capsys.readouterr().err


def test_the_reference_has_the_versions_of_the_constraints() -> None:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pinned = dict(line.split("==") for line in lines if "==" in line)
    # A local build, such as 2.13.0+cpu, is one of the pinned version.
    versions = {name: text.partition("+")[0] for name, text in Reference.read(REFERENCE).versions.items()}
    both = versions.keys() & pinned.keys()
    assert len(both) > 15
    assert {name: versions[name] for name in both} == {name: pinned[name] for name in both}


@pytest.mark.slow
def test_a_machine_agrees_with_itself_and_with_the_package_s_reference(
    folder: Path, call: Call, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(doctor.main, "out=here.json") == 0
    here, ours = Reference.read(folder / "here.json"), Reference.read(REFERENCE)
    assert len(here.digests) == 12
    capsys.readouterr()
    assert call(doctor.main, "reference=here.json") == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "12 of 12 drives have the reference's bytes" in said and "as in the reference" in said
    if here.processor == ours.processor and not checks.other_versions(here.versions, ours.versions):
        assert here.digests == ours.digests, "write assets/doctor/reference.json anew with out="
