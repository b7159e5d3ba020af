"""The entry points that installed packages declare for us; nothing is imported to list them."""

import os
import re
import sys
from functools import lru_cache
from importlib.metadata import EntryPoint, EntryPoints, entry_points

VALID_NAME = re.compile(r"[A-Za-z][\w.-]*")


def entry_points_by_name(group: str) -> dict[str, list[EntryPoint]]:
    """The entry points of a group such as `dune_rl.worlds`: more than one for a name where packages clash."""
    by_name: dict[str, list[EntryPoint]] = {}
    for point in _entry_points(group, _search_state()):
        if VALID_NAME.fullmatch(point.name):
            by_name.setdefault(point.name, []).append(point)
    return by_name


@lru_cache(maxsize=32)
def _entry_points(group: str, _state: object) -> EntryPoints:
    # Reading those of all packages takes milliseconds, and settings are checked against many groups.
    return entry_points(group=group)


def _search_state() -> tuple[tuple[str, int], ...]:
    """The folders that Python searches, with the times at which packages were added or removed last."""
    state = []
    for path in sys.path:
        folder = path or os.getcwd()
        try:
            changed = os.stat(folder).st_mtime_ns
        except OSError:
            changed = -1
        state.append((folder, changed))
    return tuple(state)


def package_name(point: EntryPoint) -> str:
    """The package that declares an entry point, as `pip` calls it."""
    return point.dist.name if point.dist is not None else point.module
