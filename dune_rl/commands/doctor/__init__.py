"""Does this machine have what is needed, and does it compute what others do? `python -m dune_rl.doctor`."""

import json
import os
import platform
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from packaging.version import Version

from dune_rl.commands.command_line import ReportedError, make_console
from dune_rl.core.errors import ConfigError
from dune_rl.core.files import write_atomically
from dune_rl.core.machine import (
    available_cores,
    git_commit,
    memory_gib,
    package_versions,
    processor_name,
    required_packages,
)
from dune_rl.core.paths import assets_folder, cache_folder
from dune_rl.physics.interface import OWN_ENGINES

REFERENCE = assets_folder() / "doctor" / "reference.json"
_USAGE = "usage: python -m dune_rl.doctor [out=FILE.json] [reference=FILE.json]"
# What extras of the package are for.
_EXTRAS = {"onnx": "policies in ONNX files"}
_MODULES = {"dart": "dartpy"}


class Finding(NamedTuple):
    """A line of the report: what was looked at, what was found, and whether that is to be mended."""

    subject: str
    text: str
    is_fault: bool = False


def run(words: Sequence[str]) -> None:
    """Print a report on this machine; raises `ReportedError` if anything is to be mended.

    `out=FILE` also writes what was found, which `reference=FILE` compares with on another machine, in place
    of the file of the package.
    """
    given = dict(word.partition("=")[::2] for word in words)
    if not {*given} <= {"out", "reference"} or not all(given.values()):
        raise ConfigError(_USAGE)
    reference = _read_reference(Path(given.get("reference", REFERENCE)))
    findings = [
        _describe_machine(),
        *check_packages(reference["versions"]),
        _check_cache(),
        _check_compiled(),
    ]
    measured: dict[str, Any] = {}
    if not any(finding.is_fault for finding in findings):
        # What is missing would end these with a traceback.
        from dune_rl.commands.doctor.computed import digest_drives, measure_speed

        engines = [name for name in OWN_ENGINES if find_spec(_MODULES.get(name, "pybullet"))]
        measured = {"digests": digest_drives(engines), "steps_per_s": round(measure_speed())}
        findings += [compare_digests(measured["digests"], reference), _compare_speed(measured, reference)]
    _print(findings)
    if "out" in given:
        _write(Path(given["out"]), measured)
    if any(finding.is_fault for finding in findings):
        raise ReportedError("something is to be mended")


def _read_reference(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path} cannot be read: {error}; write one with out=FILE.json") from None
    wanted = {"versions": dict, "digests": dict, "processor": str, "steps_per_s": int}
    if not isinstance(found, dict) or not all(isinstance(found.get(k), v) for k, v in wanted.items()):
        raise ConfigError(f"{path} is not a file that doctor wrote; write one with out=FILE.json")
    return found


def _describe_machine() -> Finding:
    memory = memory_gib()
    return Finding(
        "machine",
        f"{processor_name()}, {available_cores()} cores"
        + (f", {memory} GiB" if memory is not None else "")
        + f"; {platform.system()} {platform.machine()}, Python {platform.python_version()}",
    )


def check_packages(tested: Mapping[str, str]) -> list[Finding]:
    """What is missing or too old, what differs from the versions `tested`, and which extras are absent."""
    here, faults, absent = package_versions(), [], []
    for extra in ("", *_EXTRAS):
        for package in required_packages(extra):
            found = here.get(package.name)
            if found is not None and package.specifier.contains(found, prereleases=True):
                continue
            told = f"{package.name} {found}" if found else f"no {package.name}"
            if extra:
                absent.append(f'{told}: {_EXTRAS[extra]} need it (pip install "dune-rl[{extra}]")')
            else:
                wanted = f"{package.name}{package.specifier}"
                faults.append(f"{told}, but {package.specifier} is needed: pip install '{wanted}'")
    others = [
        f"{name} {here[name]} ({version})"
        for name, version in tested.items()
        if name in here and Version(here[name]).public != Version(version).public
    ]
    return [
        *(Finding("package", fault, is_fault=True) for fault in faults),
        Finding("packages", "other versions than tested: " + ", ".join(others) if others else "as tested"),
        *(Finding("extra", line) for line in absent),
    ]


def _check_cache() -> Finding:
    folder = cache_folder()
    if folder is None:
        return Finding("cache", "off: every process builds its worlds anew")
    if _can_be_written(folder):
        return Finding("cache", f"worlds are kept in {folder}")
    return Finding("cache", f"{folder} cannot be written; set DUNE_RL_CACHE to a folder", is_fault=True)


def _can_be_written(folder: Path) -> bool:
    there = next(path for path in (folder, *folder.parents) if path.exists())
    return there.is_dir() and os.access(there, os.W_OK)


def _check_compiled() -> Finding:
    from dune_rl.geometry.frames import find_angles

    kept = getattr(find_angles._cache, "cache_path", None)  # type: ignore[attr-defined]
    if kept and _can_be_written(Path(kept)):
        return Finding("compiled", f"code is kept, for one in {kept}")
    text = "code cannot be kept, so that every process compiles for a minute; set NUMBA_CACHE_DIR to a folder"
    return Finding("compiled", text, is_fault=True)


def compare_digests(found: Mapping[str, str], reference: Mapping[str, Any]) -> Finding:
    """Whether short drives gave the bytes of the reference; that others differ is no fault."""
    known = {name: digest for name, digest in reference["digests"].items() if name in found}
    differ = [name for name, digest in known.items() if found[name] != digest]
    if not differ:
        return Finding("results", f"{len(known)} drives are byte for byte those of the reference")
    return Finding(
        "results",
        f"{len(differ)} of {len(known)} drives differ from the reference ({', '.join(differ)}), which is of "
        f"{reference['processor']} and the versions in brackets above: expected on other processors and "
        "versions, and then results agree in the mean alone",
    )


def _compare_speed(measured: Mapping[str, Any], reference: Mapping[str, Any]) -> Finding:
    here, there = measured["steps_per_s"], reference["steps_per_s"]
    return Finding(
        "speed",
        f"{here:,} control steps/s on one core (inspection, two walkers); {there:,} by the reference, whose "
        f"times of training are to be multiplied by {there / here:.1f}",
    )


def _print(findings: Sequence[Finding]) -> None:
    from rich.markup import escape
    from rich.table import Table

    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for finding in findings:
        style = "red" if finding.is_fault else "cyan"
        table.add_row(f"[{style}]{finding.subject}[/{style}]", escape(finding.text))
    faults = sum(finding.is_fault for finding in findings)
    console = make_console()
    console.print(table)
    console.print(f"{faults} to be mended" if faults else "All that is needed is there.", highlight=False)


def _write(path: Path, measured: Mapping[str, Any]) -> None:
    if not measured:
        raise ConfigError(f"{path} was not written: mend first what is named above")
    data = {"processor": processor_name(), "versions": package_versions(), "git": git_commit(), **measured}
    with write_atomically(path) as temporary:
        temporary.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
