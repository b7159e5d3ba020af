"""Check that a restored simulation has the state that was saved."""

import hashlib

from dune_rl.core.errors import DuneError
from dune_rl.state.state import State


class RestoreError(DuneError):
    """Repeating the saved episodes did not reproduce the saved state."""


def state_digest(state: State | None) -> str:
    """Hash of the bytes of the poses, velocities and goals of all agents."""
    digest = hashlib.sha256()
    for name, group in () if state is None else sorted(state.groups.items()):
        digest.update(name.encode())
        motion = group.motion
        for values in (motion.position_w, motion.roll_pitch_yaw, motion.velocity_w, group.goal.position_w):
            digest.update(values.tobytes())
    return digest.hexdigest()


def check_arrival(saved: str | None, state: State | None) -> None:
    """Raise RestoreError unless the digest of `state` is the `saved` one; None, of older files, is
    not checked.
    """
    if saved is not None and saved != state_digest(state):
        raise RestoreError(
            "the episodes under way, played again, arrived elsewhere than where they were saved: this machine"
            " or this version computes otherwise. Start new episodes, or go on where the run was saved."
        )
