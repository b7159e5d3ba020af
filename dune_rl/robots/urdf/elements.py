"""Elements of URDF files: poses, inertias, shapes and joints."""

from collections.abc import Iterable
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from trimesh.transformations import euler_from_matrix

from dune_rl.geometry.arrays import Array
from dune_rl.robots.urdf.model import Geometry, Inertial, Joint


def words(numbers: Iterable[float]) -> str:
    """Numbers with all their digits, as text."""
    return " ".join(repr(float(number)) for number in numbers)


def write_origin(element: Element, pose: Array) -> None:
    """Add the <origin> of a `pose` (4, 4)."""
    SubElement(element, "origin", xyz=words(pose[:3, 3]), rpy=words(euler_from_matrix(pose, axes="sxyz")))


def write_inertial(link: Element, inertial: Inertial) -> None:
    """Add the <inertial> of a link."""
    element = SubElement(link, "inertial")
    pose = np.eye(4)
    pose[:3, 3] = inertial.centre
    write_origin(element, pose)
    SubElement(element, "mass", value=repr(float(inertial.mass)))
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertial.inertia.tolist()
    values = {"ixx": xx, "iyy": yy, "izz": zz, "ixy": xy, "ixz": xz, "iyz": yz}
    SubElement(element, "inertia", {name: repr(value) for name, value in values.items()})


def write_shape(link: Element, tag: str, geometry: Geometry) -> Element:
    """The <geometry> element of a shape; the caller adds the <mesh> of a mesh."""
    element = SubElement(link, tag)
    write_origin(element, geometry.pose)
    if tag == "visual" and geometry.colour is not None:
        rgba = words((*geometry.colour, 1.0))
        SubElement(SubElement(element, "material", name=rgba), "color", rgba=rgba)
    holder = SubElement(element, "geometry")
    if geometry.kind == "box":
        SubElement(holder, "box", size=words(geometry.size))
    elif geometry.kind != "mesh":
        names = ("radius", "length")
        SubElement(
            holder, geometry.kind, {name: repr(x) for name, x in zip(names, geometry.size, strict=False)}
        )
    return holder


def write_joint(root: Element, joint: Joint) -> Element:
    """Add a <joint> with its limits of position, and return it."""
    element = SubElement(root, "joint", name=joint.name, type=joint.kind)
    SubElement(element, "parent", link=joint.parent)
    SubElement(element, "child", link=joint.child)
    write_origin(element, joint.pose)
    SubElement(element, "axis", xyz=words(joint.axis))
    if joint.is_limited:
        lower, upper = joint.limits
        SubElement(element, "limit", lower=repr(lower), upper=repr(upper), effort="1e6", velocity="1e6")
    return element
