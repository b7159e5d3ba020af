"""URDFs as PyBullet loads them fastest."""

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from weakref import WeakValueDictionary
from xml.etree.ElementTree import SubElement, tostring

from defusedxml.ElementTree import fromstring

from dune_rl.physics.bullet.tyres import add_tyre_links
from dune_rl.physics.robot_body import RobotBody
from dune_rl.physics.varied_body import BodyVariation, collision_urdf, varied_urdf


class RobotUrdfs:
    """The URDFs of a robot, as it is or varied, with any of its tyres."""

    def __init__(self, spec: RobotBody, variation: BodyVariation | None = None) -> None:
        # `load_shared_urdfs` finds URDFs by the id of this, which must not be reused.
        self._spec, self._variation = spec, variation
        self._texts: dict[frozenset[int], str] = {}

    def text(self, tyres: frozenset[int]) -> str:
        """The URDF with the tyres that have these indices."""
        text = self._texts.get(tyres)
        if text is None:
            urdf, variation = self._spec.urdf, self._variation
            text = collision_urdf(urdf) if variation is None else varied_urdf(urdf, variation)
            if tyres:
                text = add_tyre_links(text, [self._spec.tyres[index] for index in sorted(tyres)])
            self._texts[tyres] = text = add_visual_stubs(text)
        return text


@contextmanager
def named_file(text: str) -> Iterator[str]:
    """Name of a file with `text` that exists during the block: in memory, where the system has such files.

    On a disk that is busy a file can take longer than PyBullet takes to load it.
    """
    if sys.platform == "linux" and Path("/proc/self/fd").is_dir():
        with open(os.memfd_create("dune_rl.urdf"), "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            yield f"/proc/self/fd/{file.fileno()}"
        return
    handle, name = tempfile.mkstemp(prefix="dune_rl_", suffix=".urdf")
    try:
        with open(handle, "w", encoding="utf-8") as file:
            file.write(text)
        yield name
    finally:
        Path(name).unlink()


_urdfs_by_spec: WeakValueDictionary[int, RobotUrdfs] = WeakValueDictionary()


def load_shared_urdfs(spec: RobotBody) -> RobotUrdfs:
    """The URDFs of a robot as it is, which all scenes with the same `spec` share."""
    found = _urdfs_by_spec.get(id(spec))
    if found is None:
        _urdfs_by_spec[id(spec)] = found = RobotUrdfs(spec)
    return found


def add_visual_stubs(urdf: str) -> str:
    """The text of a URDF without visual shapes, with a small box as the visual shape of each link.

    PyBullet draws a link's collision shapes where it has no visual ones, and for that computes the convex
    hull of each sphere and cylinder at every load: four fifths of the time that a rover's takes.
    """
    root = fromstring(urdf)
    for link in root.findall("link"):
        geometry = SubElement(SubElement(link, "visual"), "geometry")
        SubElement(geometry, "box", size="0.001 0.001 0.001")
    return tostring(root, encoding="unicode")
