"""Robots of boxes, spheres and wheels, as URDF files in a test's folder."""

from pathlib import Path

import numpy as np

from dune_rl.physics.motors import Motor
from dune_rl.physics.robot_body import RobotBody

MASS_KG = 2.0


def link(name: str, mass_kg: float, size: str, shape: str, origin: str = "0 0 0") -> str:
    """A link of a box or a sphere of even density about its origin, its collision shape at `origin`."""
    numbers = [float(number) for number in size.split()]
    if shape == "sphere":
        (radius,) = numbers
        moments, what = np.full(3, 0.4 * mass_kg * radius**2), f'<sphere radius="{radius}"/>'
    else:
        squares = np.square(numbers)
        moments, what = mass_kg / 12 * (squares.sum() - squares), f'<box size="{size}"/>'
    ixx, iyy, izz = moments
    return (
        f'<link name="{name}"><inertial><mass value="{mass_kg}"/>'
        f'<inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial>'
        f'<collision><origin xyz="{origin}"/><geometry>{what}</geometry></collision></link>'
    )


def joint(name: str, parent: str, child: str, xyz: str, kind: str = "continuous", rpy: str = "0 0 0") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="0 1 0"/></joint>'
    )


def body(folder: Path, *elements: str, **settings) -> RobotBody:
    urdf = folder / "body.urdf"
    urdf.write_text(f'<robot name="body">{"".join(elements)}</robot>')
    return RobotBody(
        urdf, **{"motors": (), "ground_links": (), "ground_friction": 1.0, "hull_friction": 1.0} | settings
    )


def block(folder: Path, friction: float = 1.0, size: str = "0.4 0.3 0.2") -> RobotBody:
    return body(folder, link("block", MASS_KG, size, "box"), hull_friction=friction)


def sled(folder: Path, friction: float, half_track_m: float, centre_m: float) -> RobotBody:
    """A mass on four feet that slide, its centre `centre_m` above the ground: no edges."""
    across = [half_track_m, -half_track_m]
    feet = [(f"foot{x:+}{y:+}", x, y) for x in across for y in across]
    return body(
        folder,
        # Its collision shape is out of the way.
        link("mass", MASS_KG, "0.1 0.1 0.1", "box", origin="0 0 0.5"),
        *(link(name, 0.001, "0.02", "sphere") for name, _, _ in feet),
        *(joint(f"to_{name}", "mass", name, f"{x} {y} {0.02 - centre_m}", "fixed") for name, x, y in feet),
        ground_links=tuple(name for name, _, _ in feet),
        ground_friction=friction,
    )


def cart(
    folder: Path, friction: float, half_track_m: float, centre_m: float, shape: str = "sphere", **settings
) -> RobotBody:
    """10 kg, `centre_m` above the ground, on four braked wheels of 0.5 kg."""
    across, radius = [half_track_m, -half_track_m], 0.05
    wheels = [(f"wheel{x:+}{y:+}", x, y) for x in across for y in across]
    links = [link(name, 0.5, str(radius), "sphere") for name, _, _ in wheels]
    if shape == "cylinder":
        ball, drum = f'<sphere radius="{radius}"/>', f'<cylinder radius="{radius}" length="0.04"/>'
        links = [text.replace(ball, drum) for text in links]
        links = [
            text.replace('"0 0 0"/><geometry>', f'"0 0 0" rpy="{np.pi / 2} 0 0"/><geometry>')
            for text in links
        ]
    return body(
        folder,
        link("mass", 10.0, "0.1 0.1 0.1", "box", origin="0 0 0.5"),
        *links,
        *(joint(f"to_{name}", "mass", name, f"{x} {y} {radius - centre_m}") for name, x, y in wheels),
        motors=tuple(Motor(f"to_{name}", 50.0) for name, _, _ in wheels),
        ground_links=tuple(name for name, _, _ in wheels),
        ground_friction=friction,
        **settings,
    )


def ball(folder: Path, radius_m: float) -> RobotBody:
    return body(folder, link("ball", MASS_KG, str(radius_m), "sphere"), ground_links=("ball",))
