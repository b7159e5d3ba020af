"""Poses of bodies that others see."""

import numpy as np

from dune_rl.geometry.frames import POSE_COLUMNS


def seen_at(poses: np.ndarray) -> np.ndarray:
    """Poses (..., 7) of which the last columns, such as roll, pitch and frame, are zero where left out."""
    poses = np.asarray(poses, float)
    found = np.zeros((*poses.shape[:-1], POSE_COLUMNS))
    found[..., : poses.shape[-1]] = poses
    return found
