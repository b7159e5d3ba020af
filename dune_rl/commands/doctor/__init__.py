"""Does this machine have what is needed, and does it compute what others do? `python -m dune_rl.doctor`."""

import platform
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

from dune_rl.commands.command_line import ReportedError, make_console
from dune_rl.commands.doctor.checks import Finding, check_cache, check_compiled, check_imports, check_packages
from dune_rl.commands.doctor.reference import REFERENCE, Reference, check_place, compare_drives
from dune_rl.core.errors import ConfigError
from dune_rl.core.machine import available_cores, git_commit, memory_gib, package_versions, processor_name
from dune_rl.core.suggestions import split_word

_USAGE = "usage: python -m dune_rl.doctor [out=FILE.json] [reference=FILE.json]"


def parse(words: Sequence[str]) -> dict[str, str]:
    """The words by their keys; raises ConfigError for others than `out` and `reference`."""
    given = {key: value for key, _, value in map(split_word, words)}
    if not {*given} <= {"out", "reference"} or not all(given.values()):
        raise ConfigError(_USAGE)
    return given


def run(words: Sequence[str]) -> None:
    """Print a report on this machine; raises `ReportedError` if anything is to be mended.

    `out=FILE` also writes what was found, with which `reference=FILE` compares another machine. Without a
    reference that is the file of the package.
    """
    given = parse(words)
    out = Path(given["out"]) if "out" in given else None
    if out is not None:
        check_place(out)
    reference = Reference.read(Path(given.get("reference", REFERENCE)))
    measured: list[Reference] = []
    faults = 0
    console = make_console()
    for finding in _examine(reference, "reference" in given, measured):
        faults += finding.is_fault
        finding.show(console)
    console.print(f"{faults} to be mended" if faults else "All that is needed is there.", highlight=False)
    if out is not None and measured:
        measured[0].write(out)
    elif out is not None:
        raise ConfigError(f"{out} was not written: mend first what is named above")
    if faults:
        raise ReportedError


def _examine(reference: Reference, is_given: bool, measured: list[Reference]) -> Iterator[Finding]:
    """What is found, as it is found; what this machine computes is added to `measured`."""
    memory = memory_gib()
    yield Finding(
        "machine",
        f"{processor_name()}, {available_cores()} cores"
        + (f", {memory} GiB" if memory is not None else "")
        + f"; {platform.system()} {platform.machine()}, Python {platform.python_version()}",
    )
    for check in (partial(check_packages, reference.versions), check_imports):
        packages = check()
        yield from packages
        if any(finding.is_fault for finding in packages):
            return
    yield from _compute(reference, is_given, measured)


def _compute(reference: Reference, is_given: bool, measured: list[Reference]) -> Iterator[Finding]:
    # These load numba and the engines, which a package that is missing or too old would end.
    from llvmlite.binding import get_host_cpu_name

    from dune_rl.commands.doctor.computed import digest_drives, measure_speed

    yield check_cache()
    yield check_compiled()
    yield Finding("", "driving in every world ...")
    here = Reference(
        processor=f"{processor_name()} ({get_host_cpu_name()})",
        versions=package_versions(),
        git=git_commit(),
        digests=digest_drives(),
        steps_per_s=round(measure_speed()),
    )
    measured.append(here)
    yield compare_drives(here, reference, is_given)
    yield Finding(
        "speed",
        f"{here.steps_per_s:,} control steps/s on one core (inspection, two walkers), "
        f"{here.steps_per_s / reference.steps_per_s:.2f} of the reference's; on a busy machine it is less",
    )
