"""The entry points that installed packages declare for us; nothing is imported to list them."""

import re
from importlib.metadata import EntryPoint, entry_points

VALID_NAME = re.compile(r"[A-Za-z][\w.-]*")


def entry_points_by_name(group: str) -> dict[str, list[EntryPoint]]:
    """The entry points of a group such as `dune_rl.worlds`: more than one for a name where packages clash."""
    by_name: dict[str, list[EntryPoint]] = {}
    for point in entry_points(group=group):
        if VALID_NAME.fullmatch(point.name):
            by_name.setdefault(point.name, []).append(point)
    return by_name


def package_name(point: EntryPoint) -> str:
    """The package that declares an entry point, as `pip` calls it."""
    return point.dist.name if point.dist is not None else point.module
