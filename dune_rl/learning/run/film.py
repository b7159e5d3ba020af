"""A run's film in TensorBoard."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from dune_rl.learning.run.events import EventFile, Picture

# An animation of a GIF's few colours; film.mp4 has the pictures as they are.
_WIDTH = 400
_RATE_HZ = 6.0
_MOST_PICTURES = 90


def log_film(folder: Path, pictures: Sequence[Picture], rate_hz: float, frames: int) -> None:
    """Show `pictures`, RGB (height, width, 3) at `rate_hz`, beside the other events of the run in `folder`.

    Small, with some pictures a second, and of a long film only some of these: TensorBoard loads it whole.
    """
    every = max(1, round(rate_hz / _RATE_HZ), -(-len(pictures) // _MOST_PICTURES))
    events = EventFile(folder)
    try:
        events.film("film", [_smaller(each) for each in pictures[::every]], rate_hz / every, frames)
    finally:
        events.close()


def _smaller(picture: Picture) -> Picture:
    height, width = picture.shape[:2]
    return np.asarray(Image.fromarray(picture).resize((_WIDTH, round(height * _WIDTH / width))))
