"""`python -m dune_rl.doctor`: what is missing is named, and other versions and results are told."""

import json
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pytest

from dune_rl import doctor
from dune_rl.commands import doctor as checks
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
    assert f"{told}: pip install 'numba>=0.61'" in said.out and "1 to be mended" in said.out
    assert "here.json was not written: mend first" in said.err and not (folder / "here.json").exists()
    assert "control steps" not in said.out


def test_other_versions_than_tested_are_told_and_are_no_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    pretend(monkeypatch, "numba", "99.0+cpu")
    (found,) = [each for each in checks.check_packages({"numba": "0.68"}) if each.subject == "packages"]
    assert found.text == "other versions than tested: numba 99.0+cpu (0.68)" and not found.is_fault
    (found,) = [each for each in checks.check_packages({"numba": "99.0"}) if each.subject == "packages"]
    assert found.text == "as tested"


def test_an_absent_extra_is_told_with_what_it_is_for(monkeypatch: pytest.MonkeyPatch) -> None:
    pretend(monkeypatch, "onnxruntime", None)
    (found,) = [each for each in checks.check_packages({}) if each.subject == "extra"]
    assert "policies in ONNX files" in found.text and "dune-rl[onnx]" in found.text and not found.is_fault


def test_drives_that_differ_are_named() -> None:
    reference = {"digests": {"bullet flat": "a", "dart flat": "b"}, "processor": "Pentium"}
    assert "2 drives are byte for byte" in checks.compare_digests(reference["digests"], reference).text
    found = checks.compare_digests({"bullet flat": "x"}, reference)
    assert "1 of 1 drives differ from the reference (bullet flat)" in found.text and "Pentium" in found.text
    assert not found.is_fault


def test_a_cache_that_cannot_be_written_is_a_fault(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "file").write_text("")
    monkeypatch.setenv("DUNE_RL_CACHE", str(folder / "file" / "cache"))
    assert checks._check_cache().is_fault
    monkeypatch.setenv("DUNE_RL_CACHE", str(folder / "new" / "cache"))
    assert not checks._check_cache().is_fault


@pytest.mark.parametrize("text", ["", "[]", '{"versions": {}}'])
def test_a_file_of_something_else_is_refused(
    text: str, folder: Path, call: Call, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "other.json").write_text(text)
    assert call(doctor.main, "reference=other.json") == 2
    assert "other.json" in capsys.readouterr().err


@pytest.mark.parametrize("word", ["word", "outt=x", "out="])
def test_other_words_are_refused(word: str, call: Call, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(doctor.main, word) == 2
    assert "usage: python -m dune_rl.doctor" in capsys.readouterr().err


@pytest.mark.slow
def test_a_machine_agrees_with_itself(folder: Path, call: Call, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(doctor.main, "out=here.json") == 0
    assert len(json.loads((folder / "here.json").read_text())["digests"]) == 10
    capsys.readouterr()
    assert call(doctor.main, "reference=here.json") == 0
    said = capsys.readouterr().out
    assert "10 drives are byte for byte those of the reference" in said and "as tested" in said
