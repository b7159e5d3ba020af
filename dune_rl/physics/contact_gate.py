"""Conservative test of whether robots can touch anything but ground within a control step.

Reading contacts after every physics step costs about 6 % of a control step;
most of the time this test shows that there cannot be any.
"""

import math
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Protocol

from dune_rl.physics.interface import KinematicCapsule, StaticBody
from dune_rl.physics.obstacle_map import load_shared_map

# Bounds the acceleration of a robot by its motors and gravity; landings on ground change the direction of a
# velocity and do not increase it.
_MAX_ACCELERATION_MPS2 = 40.0
# Upper bound of the distance below which engines treat two shapes as in contact.
CONTACT_MARGIN_M = 0.05

# x, y and radius [m].
Disc = tuple[float, float, float]


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
        """Position x, y [m] and speed [m/s] in all three directions."""
        ...


class ContactGate:
    """Finds the bodies that can have contacts, other than with ground, in the next control step."""

    def __init__(self, statics: tuple[StaticBody, ...], kinematics: Sequence[KinematicCapsule]) -> None:
        self.obstacles = load_shared_map(statics)
        self._radii_m = [body.radius_m for body in kinematics]
        # As of `find_contacts`: bound of each robot's motion in the next control step, and discs that contain
        # all places of each robot, and of each kinematic body near any, in that step.
        self.motions_m: list[float] = []
        self.discs: list[Disc] = []
        self.kinematic_discs: list[Disc] = []

    def find_contacts(
        self,
        robots: Sequence[GatedRobot],
        duration_s: float,
        forces: Mapping[int, Sequence[float]],
        old_poses: Sequence[Sequence[float]],
        new_poses: Sequence[Sequence[float]],
    ) -> tuple[list[int], list[bool]]:
        """Indices of the kinematic bodies that robots can touch, and whether each robot can touch anything.

        The step takes `duration_s` [s]. `forces` [N] are the external ones, by index of the robot. The K
        kinematic bodies move from `old_poses` (x, y, ...) [m] to `new_poses`.
        """
        discs, exposed, motions = [], [], []
        for index, robot in enumerate(robots):
            x, y, speed = robot.planar_motion()
            acceleration = _MAX_ACCELERATION_MPS2
            if index in forces:
                acceleration += math.hypot(*forces[index]) / robot.base_mass_kg
            motion = (speed + acceleration * duration_s / 2) * duration_s
            motions.append(motion)
            span = robot.reach_m + motion + CONTACT_MARGIN_M
            discs.append((x, y, span))
            # A state that has diverged counts as exposed.
            exposed.append(not (math.isfinite(x + y) and self.obstacles.distance(x, y) >= span))
        if len(discs) > 1:
            for one, other in combinations(range(len(discs)), 2):
                (x, y, span), (other_x, other_y, other_span) = discs[one], discs[other]
                # Written so that NaN, which compares false, counts as near.
                if not math.hypot(x - other_x, y - other_y) > span + other_span:
                    exposed[one] = exposed[other] = True
        self.motions_m, self.discs = motions, discs
        near: list[int] = []
        self.kinematic_discs = []
        for body, radius in enumerate(self._radii_m):
            old, new = old_poses[body], new_poses[body]
            x, y = new[0], new[1]
            room = radius + abs(x - old[0]) + abs(y - old[1])
            is_near = False
            for index, (robot_x, robot_y, span) in enumerate(discs):
                if not math.hypot(x - robot_x, y - robot_y) > span + room:
                    is_near = exposed[index] = True
            if is_near:
                near.append(body)
                self.kinematic_discs.append((x, y, room))
        return near, exposed

    def statics_near(self, robot: int) -> list[int]:
        """Numbers of the static bodies that a robot can touch, as of `find_contacts`: none of the others."""
        return self.obstacles.bodies_near(*self.discs[robot])
