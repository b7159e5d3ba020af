"""Activation of tyres: their collision shapes exist only while they can touch anything."""

from collections.abc import Sequence

# Control steps for which surplus tyres stay active: a change costs about as much as two unneeded tyres in 30.
_DEACTIVATION_DELAY_STEPS = 30

Tyres = frozenset[int]
_NONE: Tyres = frozenset()


class TyreActivation:
    """Decides which tyres of a scene's robots have collision shapes in the next control step.

    Each shape adds a link to a robot's equations of motion: four of them take a sixth of a physics step even
    without obstacles. So a tyre has one only from the control step in which it can touch anything until it
    has been out of reach for a while.

    `active` has the indices of the active tyres of each of `num_robots`.
    """

    def __init__(self, num_robots: int) -> None:
        self.active: list[Tyres] = [_NONE] * num_robots
        self._surplus_steps = [0] * num_robots

    def reset(self) -> None:
        """Deactivate all tyres."""
        self.active = [_NONE] * len(self.active)

    def update(self, needed_tyres: Sequence[Tyres]) -> list[int]:
        """Set `active` for a control step; returns the robots for which it has changed.

        `needed_tyres` are those of each robot that can touch anything: see `ContactGate`.
        """
        changed = []
        for index, needed in enumerate(needed_tyres):
            active = self.active[index]
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
