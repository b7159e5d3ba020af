"""Activation of tyres: their collision shapes exist only while they can touch anything."""

import math
from collections.abc import Sequence
from typing import Protocol

from dune_rl.physics.contact_gate import CONTACT_MARGIN_M, Disc
from dune_rl.physics.interface import SceneSpec, Tyre
from dune_rl.physics.obstacle_map import load_shared_map

# Control steps for which surplus tyres stay active: a change costs about as much as two unneeded tyres in 30.
_DEACTIVATION_DELAY_STEPS = 30

Tyres = frozenset[int]
_NONE: Tyres = frozenset()


class TyredRobot(Protocol):
    """What the activation needs to know of a robot."""

    def body_state(self) -> tuple[float, ...]:
        """See `PhysicsRobot`."""
        ...


class TyreActivation:
    """Decides which tyres of a scene's robots have collision shapes in the next control step.

    Each shape adds a link to a robot's equations of motion: four of them take a sixth of a physics step even
    without obstacles. So a tyre has one only from the control step in which it can touch anything until it
    has been out of reach for a while. Robots that are not exposed (see `ContactGate`) need none.

    `active` has the indices of the active tyres of each robot.
    """

    def __init__(self, spec: SceneSpec) -> None:
        self._tyres = [[_dimensions(tyre) for tyre in body.tyres] for body in spec.robots]
        self._with_tyres = [index for index, body in enumerate(spec.robots) if body.tyres]
        self._obstacles = load_shared_map(spec.statics) if self._with_tyres else None
        self.active: list[Tyres] = [_NONE] * len(spec.robots)
        self._surplus_steps = [0] * len(spec.robots)

    def reset(self) -> None:
        """Deactivate all tyres."""
        self.active = [_NONE] * len(self.active)

    def update(
        self,
        robots: Sequence[TyredRobot],
        exposed: Sequence[bool],
        motions_m: Sequence[float],
        duration_s: float,
        robot_discs: Sequence[Disc],
        kinematic_discs: Sequence[Disc],
    ) -> list[int]:
        """Set `active` for a control step of `duration_s`; returns the robots for which it has changed.

        `exposed`, `motions_m` and the discs are those of `ContactGate`.
        """
        changed = []
        for index in self._with_tyres:
            active, needed = self.active[index], _NONE
            if exposed[index]:
                others = (disc for other, disc in enumerate(robot_discs) if other != index)
                discs = [*kinematic_discs, *others]
                needed = self._find_needed(index, robots[index], motions_m[index], duration_s, discs)
            if needed == active:
                self._surplus_steps[index] = 0
                continue
            self._surplus_steps[index] += 1
            if needed <= active and self._surplus_steps[index] < _DEACTIVATION_DELAY_STEPS:
                continue
            # Surplus tyres stay active when others are added, which saves a later change.
            self.active[index] = needed if needed <= active else needed | active
            self._surplus_steps[index] = 0
            changed.append(index)
        return changed

    def _find_needed(
        self,
        index: int,
        robot: TyredRobot,
        motion_m: float,
        duration_s: float,
        discs: Sequence[Disc],
    ) -> Tyres:
        """The tyres of a robot that can touch an obstacle or one of the `discs` (x, y, radius) [m]."""
        x, y, _, qx, qy, qz, qw, *_, wx, wy, wz = robot.body_state()
        # A state that has diverged is near nothing.
        if not math.isfinite(x + y + qx + qy + qz + qw):
            return _NONE
        forward = 1.0 - 2.0 * (qy * qy + qz * qz), 2.0 * (qx * qy + qw * qz)
        left = 2.0 * (qx * qy - qw * qz), 1.0 - 2.0 * (qx * qx + qz * qz)
        up = 2.0 * (qx * qz + qw * qy), 2.0 * (qy * qz - qw * qx)
        turn = math.hypot(wx, wy, wz) * duration_s
        assert self._obstacles is not None
        needed = []
        for number, ((ahead, aside, above), arm, size) in enumerate(self._tyres[index]):
            tyre_x = x + ahead * forward[0] + aside * left[0] + above * up[0]
            tyre_y = y + ahead * forward[1] + aside * left[1] + above * up[1]
            reach = size + motion_m + turn * arm + CONTACT_MARGIN_M
            if self._obstacles.distance(tyre_x, tyre_y) < reach:
                needed.append(number)
                continue
            for disc_x, disc_y, radius in discs:
                if math.hypot(tyre_x - disc_x, tyre_y - disc_y) < reach + radius:
                    needed.append(number)
                    break
        return frozenset(needed)


def _dimensions(tyre: Tyre) -> tuple[tuple[float, float, float], float, float]:
    """Position in the base link's frame (3), its length, and the distance of the tyre's edge from it [m]."""
    return tyre.position_b, math.hypot(*tyre.position_b), math.hypot(tyre.radius_m, tyre.width_m / 2)
