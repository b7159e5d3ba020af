"""XML elements of SDF and URDF files: numbers, poses, and documents."""

from collections.abc import Iterable
from xml.etree.ElementTree import Element, SubElement, indent, register_namespace, tostring

import numpy as np

from dune_rl.core.paths import file_stem
from dune_rl.geometry.arrays import Array
from dune_rl.geometry.frames import roll_pitch_yaw
from dune_rl.worlds.importing.sdf.elements import ROLES

SDF_VERSION = "1.9"
register_namespace("dune_rl", ROLES)


def add(parent: Element, tag: str, text: object = None, **attributes: str) -> Element:
    """A new child of `parent` with a text, such as a number or a truth value, if one is given."""
    child = SubElement(parent, tag, attributes)
    if text is not None:
        child.text = str(text).lower() if isinstance(text, bool) else str(text)
    return child


def words(numbers: Iterable[float]) -> str:
    """Numbers with nine digits, as text."""
    # Adding zero turns a negative zero into a positive one.
    return " ".join(f"{float(number) + 0.0:.9g}" for number in numbers)


def add_pose(parent: Element, position: Iterable[float], rotation: Array | None = None) -> None:
    """Add a <pose> of a `position` (3,) [m] and a `rotation` (3, 3), by default none."""
    angles = np.zeros(3) if rotation is None else roll_pitch_yaw(rotation)
    add(parent, "pose", words([*position, *np.where(np.abs(angles) < 1e-12, 0.0, angles)]))


def make_system(name: str, library: str) -> Element:
    """The <plugin> of a system of Gazebo, such as `Physics` of the library `physics`."""
    return Element("plugin", filename=f"gz-sim-{library}-system", name=f"gz::sim::systems::{name}")


def make_sdf() -> Element:
    """The root element of an SDF file."""
    return Element("sdf", version=SDF_VERSION)


def document_text(root: Element) -> str:
    """An indented XML document, a way-point of an actor in one line."""
    indent(root)
    for way_point in root.iter("waypoint"):
        way_point.text = None
        for child in way_point:
            child.tail = None
    return f'<?xml version="1.0"?>\n{tostring(root, encoding="unicode")}\n'


class UniqueNames:
    """Names of letters, digits, -, _ and ., in the order in which they are asked for; none is given twice."""

    def __init__(self) -> None:
        # SDF reserves the name of the outermost frame.
        self._taken: set[tuple[str, str]] = {("world", "")}

    def make(self, text: str, suffix: str = "") -> str:
        """`text` as a name that is new with a `suffix`, with a number behind it if need be."""
        stem = name = file_stem(text)
        number = 1
        while (name.lower(), suffix) in self._taken:
            number += 1
            name = f"{stem}_{number}"
        self._taken.add((name.lower(), suffix))
        return name
