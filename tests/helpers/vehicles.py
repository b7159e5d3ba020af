"""URDFs of vehicles in the shape of well-known ones: cars, rocker-bogies, and robots with casters."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

HALF_PI = "1.5707963267948966"


def box_link(name: str, mass_kg: float, size: Sequence[float], xyz: str = "0 0 0", extra: str = "") -> str:
    """A box of even density whose centre is at `xyz`; it collides."""
    a, b, c = np.square(size)
    ixx, iyy, izz = mass_kg / 12 * np.array([b + c, a + c, a + b])
    shape = f'<origin xyz="{xyz}"/><geometry><box size="{size[0]} {size[1]} {size[2]}"/></geometry>'
    return (
        f'<link name="{name}"><inertial><origin xyz="{xyz}"/><mass value="{mass_kg}"/>'
        f'<inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial>'
        f"<collision>{shape}</collision><visual>{shape}</visual>{extra}</link>"
    )


def small_link(name: str, mass_kg: float = 0.2) -> str:
    """A link without shape, such as a steering knuckle."""
    inertia = 1e-3 * mass_kg
    return (
        f'<link name="{name}"><inertial><mass value="{mass_kg}"/><inertia ixx="{inertia}" iyy="{inertia}" '
        f'izz="{inertia}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


def wheel_link(name: str, mass_kg: float, radius_m: float, width_m: float) -> str:
    """A wheel about y."""
    across, along = mass_kg * radius_m**2 / 2, mass_kg * (3 * radius_m**2 + width_m**2) / 12
    cylinder = f'<cylinder radius="{radius_m}" length="{width_m}"/>'
    shape = f'<origin rpy="{HALF_PI} 0 0"/><geometry>{cylinder}</geometry>'
    return (
        f'<link name="{name}"><inertial><mass value="{mass_kg}"/><inertia ixx="{along}" iyy="{across}" '
        f'izz="{along}" ixy="0" ixz="0" iyz="0"/></inertial>'
        f"<collision>{shape}</collision><visual>{shape}</visual></link>"
    )


def joint(
    name: str, parent: str, child: str, xyz: Sequence[float], kind: str, axis: str, limit: str = ""
) -> str:
    place = " ".join(str(part) for part in xyz)
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{place}"/><axis xyz="{axis}"/>{limit}</joint>'
    )


def rolling(name: str, parent: str, xyz: Sequence[float], limit: str = "") -> str:
    return joint(f"{name}_joint", parent, name, xyz, "continuous", "0 1 0", limit)


def steering(name: str, parent: str, xyz: Sequence[float], most: float, axis: str = "0 0 1") -> str:
    limit = f'<limit lower="{-most}" upper="{most}" effort="0" velocity="0"/>'
    return joint(f"{name}_joint", parent, name, xyz, "revolute", axis, limit)


def transmission(name: str) -> str:
    return f'<transmission name="{name}_trans"><joint name="{name}"/></transmission>'


def write(folder: Path, name: str, *elements: str) -> Path:
    path = folder / f"{name}.urdf"
    path.write_text(f'<robot name="{name}">{"".join(elements)}</robot>')
    return path


CAR_WHEELBASE_M, CAR_TRACK_M, CAR_RADIUS_M, CAR_LIMIT_RAD = 0.55, 0.5, 0.12, 0.6
CAR_KINGPIN_M = 0.03
_SIDES = (("left", 1.0), ("right", -1.0))


def car_elements(limit_rad: float = CAR_LIMIT_RAD, axis: str = "0 0 1") -> list[str]:
    """A car whose front wheels steer about kingpins `CAR_KINGPIN_M` inward of them; base at the rear axle."""
    radius, elements = CAR_RADIUS_M, [box_link("base_link", 20.0, (0.7, 0.36, 0.12), "0.275 0 0.08")]
    for side, sign in _SIDES:
        pivot = (CAR_WHEELBASE_M, sign * (CAR_TRACK_M / 2 - CAR_KINGPIN_M), 0.0)
        elements += [
            wheel_link(f"rear_{side}_wheel", 1.0, radius, 0.06),
            rolling(f"rear_{side}_wheel", "base_link", (0.0, sign * CAR_TRACK_M / 2, 0.0)),
            small_link(f"{side}_knuckle"),
            steering(f"{side}_knuckle", "base_link", pivot, limit_rad, axis),
            wheel_link(f"front_{side}_wheel", 1.0, radius, 0.06),
            rolling(f"front_{side}_wheel", f"{side}_knuckle", (0.0, sign * CAR_KINGPIN_M, 0.0)),
        ]
    return elements


def write_car(folder: Path, *extra: str, **settings: object) -> Path:
    return write(folder, "car", *car_elements(**settings), *extra)


ROCKER_WHEELS_X, ROCKER_TRACK_M, ROCKER_RADIUS_M = (0.35, 0.0, -0.35), 0.6, 0.1


def write_rocker_bogie(
    folder: Path, *extra: str, corners_steer: bool, mass_kg: float = 20.0, pivot_m: float = 0.15
) -> Path:
    """Six wheels: on each side a rocker with the rear wheel, and on it a bogie with the other two.

    The rockers' axis is `pivot_m` above the wheels', and the bogies' a third less. High ones tip over when
    wheels without steering push with all their grip, as real ones do.
    """
    bogie_m = 2 * pivot_m / 3
    elements = [box_link("body", mass_kg, (0.5, 0.3, 0.15), f"0 0 {pivot_m + 0.1}")]
    swing = '<limit lower="-0.6" upper="0.6" effort="0" velocity="0"/>'
    for side, sign in _SIDES:
        rocker, bogie = f"{side}_rocker", f"{side}_bogie"
        elements += [
            small_link(rocker, 1.0),
            joint(f"{rocker}_joint", "body", rocker, (0, sign * 0.25, pivot_m), "revolute", "0 1 0", swing),
            small_link(bogie, 0.5),
            joint(f"{bogie}_joint", rocker, bogie, (0.175, 0, bogie_m - pivot_m), "revolute", "0 1 0", swing),
        ]
        # The rocker's and the bogie's origins.
        mounts = {"front": (bogie, 0.175, bogie_m), "middle": (bogie, 0.175, bogie_m)}
        mounts["rear"] = (rocker, 0.0, pivot_m)
        for end, x in zip(("front", "middle", "rear"), ROCKER_WHEELS_X, strict=True):
            parent, from_x, height = mounts[end]
            name, place = f"{side}_{end}_wheel", (x - from_x, sign * 0.05, -height)
            elements.append(wheel_link(name, 0.8, ROCKER_RADIUS_M, 0.08))
            if corners_steer and end != "middle":
                corner = f"{side}_{end}_corner"
                elements += [small_link(corner, 0.4), steering(corner, parent, place, 0.7)]
                parent, place = corner, (0.0, 0.0, 0.0)
            elements.append(rolling(name, parent, place))
    return write(folder, "rocker_bogie", *elements, *extra)


def write_four_wheeler(
    folder: Path,
    *extra: str,
    name: str = "husky",
    mass_kg: float = 46.0,
    x_m: float = 0.256,
    y_m: float = 0.2854,
    radius_m: float = 0.1651,
    wheel: str = "{end}_{side}_wheel",
) -> Path:
    """Four wheels without limits of effort, in the size of a Husky by default."""
    elements = [box_link("base_link", mass_kg, (0.98, 0.4, 0.25), "0 0 0.12")]
    for end, along in (("front", x_m), ("rear", -x_m)):
        for side, sign in _SIDES:
            link = wheel.format(end=end, side=side)
            elements += [
                wheel_link(link, 2.6, radius_m, 0.11),
                rolling(link, "base_link", (along, sign * y_m, 0.033)),
            ]
    return write(folder, name, *elements, *extra)


CASTER_X_M, CASTER_WHEEL_X_M, CASTER_WHEEL_RADIUS_M = -0.2, 0.1, 0.1


def write_caster_robot(
    folder: Path,
    depth_m: float,
    *,
    shape: str = "sphere",
    radius_m: float = 0.03,
    body_x_m: float = 0.0,
    fixed: bool = True,
) -> Path:
    """Two driven wheels, and a caster behind them that reaches `depth_m` below them."""
    geometry = {
        "sphere": f'<geometry><sphere radius="{radius_m}"/></geometry>',
        "cylinder": f'<origin rpy="{HALF_PI} 0 0"/>'
        f'<geometry><cylinder radius="{radius_m}" length="0.02"/></geometry>',
    }[shape]
    inertia = 'ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"'
    height = radius_m - depth_m - CASTER_WHEEL_RADIUS_M
    return write(
        folder,
        "caster_robot",
        box_link("base_link", 6.0, (0.4, 0.3, 0.08), f"{body_x_m} 0 0.08"),
        wheel_link("left_wheel", 0.5, CASTER_WHEEL_RADIUS_M, 0.04),
        rolling("left_wheel", "base_link", (CASTER_WHEEL_X_M, 0.18, 0.0)),
        wheel_link("right_wheel", 0.5, CASTER_WHEEL_RADIUS_M, 0.04),
        rolling("right_wheel", "base_link", (CASTER_WHEEL_X_M, -0.18, 0.0)),
        f'<link name="caster"><inertial><mass value="0.1"/><inertia {inertia}/></inertial>'
        f"<collision>{geometry}</collision></link>",
        joint(
            "caster_joint",
            "base_link",
            "caster",
            (CASTER_X_M, 0.0, height),
            "fixed" if fixed else "continuous",
            "0 1 0",
        ),
    )


def caster_pitch(depth_m: float, radius_m: float = 0.03) -> float:
    """Pitch [rad], nose down, at which a level plane touches the wheels and the caster from below.

    Both centres are above the plane by their radii: with (dx, dz) from the caster's to the wheels' centre,
    dz cos(pitch) - dx sin(pitch) is the difference of the radii.
    """
    dx = CASTER_WHEEL_X_M - CASTER_X_M
    dz = CASTER_WHEEL_RADIUS_M + depth_m - radius_m
    difference = CASTER_WHEEL_RADIUS_M - radius_m
    return float(np.arctan2(dz, dx) - np.arcsin(difference / np.hypot(dx, dz)))
