"""Timing of repeated calls, ratios of times taken in turn, and memory."""

import os
import resource
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np


def time_calls(action: Callable[[], object], count: int) -> float:
    """Time [s] of `count` calls of `action`."""
    start = time.perf_counter()
    for _ in range(count):
        action()
    return time.perf_counter() - start


def time_in_turns(
    actions: Mapping[str, tuple[Callable[[], object], int]], rounds: int
) -> dict[str, list[float]]:
    """Times [s] per call of each action by name, one per round.

    Each round calls every action in turn, as often as its count says, so that
    a noisy machine disturbs all of them alike.
    """
    times: dict[str, list[float]] = {name: [] for name in actions}
    for _ in range(rounds):
        for name, (action, count) in actions.items():
            times[name].append(time_calls(action, count) / count)
    return times


def median_ratio(numerators: list[float], denominators: list[float]) -> float:
    """Median of the ratios of times taken in turn."""
    return float(np.median(np.array(numerators) / np.array(denominators)))


def peak_memory_mib() -> float:
    """Largest resident memory of this process so far [MiB]."""
    # On Linux, getrusage gives a spawned process its parent's peak; its status file has its own.
    status = Path("/proc/self/status")
    if status.exists():
        lines = dict(line.split(":", 1) for line in status.read_text().splitlines() if ":" in line)
        return int(lines["VmHWM"].split()[0]) / 1024
    scale = 1024 if sys.platform != "darwin" else 1024**2
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / scale


def resident_memory_mib() -> float:
    """Resident memory of this process now [MiB]; its largest so far where the system tells no more."""
    statm = Path("/proc/self/statm")
    if not statm.exists():
        return peak_memory_mib()
    return int(statm.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20
