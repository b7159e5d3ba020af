"""Counts collisions: a continuous contact with a body is one collision."""

from collections.abc import Callable, Iterable

import numpy as np

from dune_rl.geometry.arrays import Counts, Flags
from dune_rl.state.state import ContactState


class CollisionCounter:
    """When each of N agents last touched each of B bodies of its scene.

    A contact begins a collision unless the same body was touched within the last `gap_steps` control steps.
    """

    def __init__(self, num_rows: int, gap_steps: int) -> None:
        self._gap = gap_steps
        self._last = np.full((num_rows, 0), -gap_steps - 1, np.int64)
        self._total = np.zeros(num_rows, np.int64)
        self._none = np.zeros(num_rows, np.int64)
        self._untouched = np.zeros(num_rows, bool)
        for constant in (self._none, self._untouched):
            constant.flags.writeable = False

    def make_room(self, bodies: int) -> None:
        """Enlarge the table to `bodies` bodies per scene."""
        more = bodies - self._last.shape[1]
        if more > 0:
            unseen = np.full((len(self._last), more), -self._gap - 1, np.int64)
            self._last = np.concatenate([self._last, unseen], axis=1)

    def reset(self, mask: Flags) -> None:
        """Clear all contacts of the agents in `mask` (N,)."""
        self._last[mask] = -self._gap - 1
        self._total = np.where(mask, 0, self._total)

    @property
    def at_rest(self) -> ContactState:
        """The contacts at the start of an episode: none begins."""
        return ContactState(self._untouched, self._none, self._total)

    def update(
        self,
        contacts: Iterable[tuple[int, int]],
        steps: Counts,
        kind_of: Callable[[int, int], str] | None = None,
    ) -> ContactState:
        """The contacts of a control step; `contacts` are pairs of row and body number, which may repeat.

        `steps` (N,) counts each episode's control steps. `kind_of` names the class of a row's body.
        """
        pairs = set(contacts)
        if not pairs:
            return self.at_rest
        new, touching = np.zeros_like(self._total), np.zeros(len(self._total), bool)
        by_kind: dict[str, Counts] = {}
        for row, body in pairs:
            if steps[row] - self._last[row, body] > self._gap:
                new[row] += 1
                if kind_of is not None:
                    by_kind.setdefault(kind_of(row, body), np.zeros_like(new))[row] += 1
            self._last[row, body] = steps[row]
            touching[row] = True
        self._total = self._total + new
        return ContactState(touching, new, self._total, by_kind)
