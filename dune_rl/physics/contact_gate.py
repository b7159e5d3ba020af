"""Conservative test of whether robots can touch anything but ground within a control step.

Reading contacts after every physics step costs about 6 % of a control step;
most of the time this test shows that there cannot be any.
"""

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from dune_rl.physics.gate_loops import (
    FOUND_COLUMNS,
    KINEMATIC_COLUMNS,
    POSE_COLUMNS,
    ROBOT_COLUMNS,
    TYRE_COLUMNS,
    find_near,
    measure_moves,
)
from dune_rl.physics.obstacle_map import load_shared_map
from dune_rl.physics.robot_body import RobotBody, Tyre
from dune_rl.physics.shapes import KinematicShape, StaticBody

# Bounds the acceleration of a robot by its motors and gravity; landings on ground change the direction of a
# velocity and do not increase it.
_MAX_ACCELERATION_MPS2 = 40.0
# Upper bound of the distance below which engines treat two shapes as in contact.
_CONTACT_MARGIN_M = 0.05


class GatedRobot(Protocol):
    """What the gate needs to know of a robot."""

    @property
    def reach_m(self) -> float:
        """Largest horizontal distance of any point of the robot, tyres included, from its position, at any
        joint angles.
        """
        ...

    @property
    def base_mass_kg(self) -> float:
        """Mass of the base link, on which external forces act."""
        ...

    def planar_motion(self) -> tuple[float, float, float]:
        """Position x, y [m] of the centre of mass, and speed [m/s] in all three directions."""
        ...

    def body_state(self) -> tuple[float, ...]:
        """See `PhysicsRobot`."""
        ...


class ContactGate:
    """Finds the bodies that can have contacts, other than with ground, in the next control step.

    As of the last `find_contacts`, `needed_tyres` are the indices of each robot's tyres that can touch
    anything, in the order of its `RobotBody.tyres`.
    """

    def __init__(
        self,
        statics: tuple[StaticBody, ...],
        kinematics: Sequence[KinematicShape],
        robots: Sequence[RobotBody],
    ) -> None:
        self.obstacles = load_shared_map(statics)
        upright, leaning = ([shape.reach_m(lean) for shape in kinematics] for lean in (0.0, 1.0))
        self._reaches = np.column_stack([upright, np.subtract(leaning, upright)])
        self._moves = np.zeros((len(kinematics), KINEMATIC_COLUMNS))
        most = max((len(body.tyres) for body in robots), default=0)
        self._tyres = np.full((len(robots), most, TYRE_COLUMNS), np.nan)
        for own, body in zip(self._tyres, robots, strict=True):
            for row, tyre in zip(own, body.tyres, strict=False):
                row[:] = _dimensions(tyre)
        self.needed_tyres: list[frozenset[int]] = [frozenset()] * len(robots)
        self._found, self._found_kinematics = (
            np.zeros((len(robots), FOUND_COLUMNS)),
            np.zeros(len(kinematics)),
        )

    def find_contacts(
        self,
        robots: Sequence[GatedRobot],
        duration_s: float,
        forces: Mapping[int, Sequence[float]],
        old_poses: ArrayLike,
        new_poses: ArrayLike,
    ) -> tuple[list[int], list[bool]]:
        """Indices of the kinematic bodies that robots can touch, and whether each robot can touch anything.

        The step takes `duration_s` [s]. `forces` [N] are the external ones, by index of the robot. The K
        kinematic bodies move from `old_poses` (K, 6: x, y, z [m], yaw, roll, pitch [rad]) to `new_poses`.
        """
        if not robots:
            return [], []
        rows = []
        for index, robot in enumerate(robots):
            acceleration = _MAX_ACCELERATION_MPS2
            if index in forces:
                acceleration += math.hypot(*forces[index]) / robot.base_mass_kg
            x, y, _, qx, qy, qz, qw, *_, wx, wy, wz = robot.body_state()
            motion = robot.planar_motion()
            rows.append((*motion, robot.reach_m, acceleration, x, y, qx, qy, qz, qw, wx, wy, wz))
        old, new = (np.asarray(each, float).reshape(-1, POSE_COLUMNS) for each in (old_poses, new_poses))
        measure_moves(old, new, self._reaches, self._moves)
        found, near = self._found, self._found_kinematics
        find_near(
            *self.obstacles.arrays,
            np.array(rows).reshape(-1, ROBOT_COLUMNS),
            self._tyres,
            self._moves,
            duration_s,
            _CONTACT_MARGIN_M,
            found,
            near,
        )
        exposed = []
        for index, (_, _, _, is_exposed, bits) in enumerate(found.tolist()):
            exposed.append(is_exposed != 0.0)
            self.needed_tyres[index] = _of_bits(int(bits))
        return [body for body, is_near in enumerate(near.tolist()) if is_near], exposed

    def statics_near(self, robot: int) -> list[int]:
        """Numbers of the static bodies that a robot can touch, as of `find_contacts`: none of the others."""
        return self.obstacles.bodies_near(*self._found[robot, :3].tolist())


def _dimensions(tyre: Tyre) -> tuple[float, ...]:
    """See `TYRE_COLUMNS`."""
    return *tyre.position_b, math.hypot(*tyre.position_b), math.hypot(tyre.radius_m, tyre.width_m / 2)


@lru_cache(maxsize=1024)
def _of_bits(bits: int) -> frozenset[int]:
    return frozenset(index for index in range(bits.bit_length()) if bits >> index & 1)
