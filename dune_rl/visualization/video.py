"""Films: frames written to an MP4 file."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray

from dune_rl.core.files import write_atomically

Picture = NDArray[np.uint8]
AddFrame = Callable[[Picture], None]


@contextmanager
def open_video(path: Path, frames_per_s: float, width: int, height: int) -> Iterator[AddFrame]:
    """Open an MP4 file (H.264); yields a function that adds a frame (height, width, 3).

    The file gets its name when the block ends, and only if it ends without an exception. `width` and `height`
    [px] must be even, since the codec halves the resolution of colours.
    """
    if width % 2 or height % 2:
        raise ValueError(f"a video's width and height must be even (got {width} by {height})")
    with write_atomically(path) as temporary, av.open(str(temporary), "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=Fraction(frames_per_s).limit_denominator(1000))
        stream.width, stream.height = width, height
        stream.pix_fmt = "yuv420p"
        stream.options = {"crf": "25", "preset": "superfast"}
        # More threads take more processor time, and give other bytes.
        stream.codec_context.thread_count = 1

        def add(frame: Picture) -> None:
            picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="rgb24")
            for packet in stream.encode(picture):
                container.mux(packet)

        yield add
        for packet in stream.encode():
            container.mux(packet)


def enlarge(picture: Picture, width: int, height: int) -> Picture:
    """The picture (H, W, 3) in another size, by linear interpolation: as by Pillow, in half of the time."""
    frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
    return np.asarray(frame.reformat(width, height, "rgb24", interpolation="BILINEAR").to_ndarray(), np.uint8)
