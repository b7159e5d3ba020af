"""Tyres of a robot in PyBullet: links of their own, because PyBullet filters collisions by link."""

from collections.abc import Sequence
from xml.etree.ElementTree import SubElement, tostring

from defusedxml.ElementTree import fromstring
from scipy.spatial.transform import Rotation

from dune_rl.physics.robot_body import Tyre

# Axis of a tyre in the frame of its link.
TYRE_AXIS = (0.0, 0.0, 1.0)
_ENDING = "/tyre"


def tyre_link_name(tyre: Tyre) -> str:
    """Name of the link that `add_tyre_links` adds for a tyre."""
    return f"{tyre.link}{_ENDING}"


def add_tyre_links(urdf: str, tyres: Sequence[Tyre]) -> str:
    """The text of a URDF with a link for each of the tyres, a cylinder without mass fixed to the wheel."""
    root = fromstring(urdf)
    for tyre in tyres:
        name = tyre_link_name(tyre)
        link = SubElement(root, "link", name=name)
        # PyBullet gives a link without these 1 kg.
        inertial = SubElement(link, "inertial")
        SubElement(inertial, "mass", value="0")
        SubElement(inertial, "inertia", dict.fromkeys(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), "0"))
        geometry = SubElement(SubElement(link, "collision"), "geometry")
        SubElement(geometry, "cylinder", radius=repr(tyre.radius_m), length=repr(tyre.width_m))
        joint = SubElement(root, "joint", name=name, type="fixed")
        SubElement(joint, "parent", link=tyre.link)
        SubElement(joint, "child", link=name)
        # The link's frame is turned, and not the shape's in it: that would make a slower compound shape.
        turn, _ = Rotation.align_vectors([tyre.axis], [TYRE_AXIS])
        xyz, rpy = (
            " ".join(repr(float(part)) for part in parts) for parts in (tyre.centre, turn.as_euler("xyz"))
        )
        SubElement(joint, "origin", xyz=xyz, rpy=rpy)
    return tostring(root, encoding="unicode")
