"""What installed packages of users bring, by entry point; nothing is imported to list it."""

import re
from importlib.metadata import EntryPoint, entry_points

WORLDS = "dune_rl.worlds"
VALID_NAME = re.compile(r"[A-Za-z][\w.-]*")


def worlds() -> dict[str, list[EntryPoint]]:
    """The entry points of the group `dune_rl.worlds` by name: more than one where packages clash."""
    found: dict[str, list[EntryPoint]] = {}
    for point in entry_points(group=WORLDS):
        if VALID_NAME.fullmatch(point.name):
            found.setdefault(point.name, []).append(point)
    return found


def package(point: EntryPoint) -> str:
    """The package that an entry point belongs to, as `pip` calls it."""
    return point.dist.name if point.dist is not None else point.module
