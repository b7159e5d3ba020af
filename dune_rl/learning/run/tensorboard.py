"""The TensorBoard file of a run: scalars, histograms, pictures, films and hyperparameters."""

import io
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from PIL import Image, ImageOps
from tensorboard.compat.proto.summary_pb2 import Summary
from torch.utils.tensorboard import SummaryWriter
from torch.utils.tensorboard.summary import hparams

HParam = bool | int | float | str
Picture = NDArray[np.uint8]
_COLOURS = 128


class EventFile(SummaryWriter):
    """Writes TensorBoard's events of the run in `folder`, which is one run of TensorBoard.

    `resumed_at` are the frames of the checkpoint that the run goes on from: what was written after these
    before is dropped where TensorBoard reads it.
    """

    def __init__(self, folder: Path, *, resumed_at: int | None = None) -> None:
        # TensorBoard drops the step given and all later ones; that of the checkpoint is not written again.
        super().__init__(str(folder), purge_step=None if resumed_at is None else resumed_at + 1)

    def histograms(self, values: Mapping[str, Iterable[float]], frames: int) -> None:
        """Log distributions by name; values that are not finite are left out, and so are empty ones."""
        for name, found in values.items():
            numbers = np.asarray(found, float).ravel()
            numbers = numbers[np.isfinite(numbers)]
            if len(numbers):
                self.add_histogram(name, numbers, frames)

    def film(self, name: str, pictures: Sequence[Picture], rate_hz: float, frames: int) -> None:
        """Log `pictures`, RGB (height, width, 3) each, as an animated image."""
        if not pictures:
            return
        height, width, colours = pictures[0].shape
        image = Summary.Image(
            height=height,
            width=width,
            colorspace=colours,
            encoded_image_string=encode_film(pictures, rate_hz),
        )
        self._add(Summary(value=[Summary.Value(tag=name, image=image)]), frames)

    def begin_session(self, settings: Mapping[str, HParam], results: Sequence[str]) -> None:
        """Declare the run's row in the table of hyperparameters, with columns for scalars named `results`.

        TensorBoard takes the first declaration of a run, so this is called once in its life.
        """
        experiment, start, _ = hparams(dict(settings), dict.fromkeys(results, 0.0))
        for summary in (experiment, start):
            self._add(summary)

    def end_session(self, results: Mapping[str, float], frames: int) -> None:
        """Log the results of a finished run, and that it is finished."""
        for name, value in results.items():
            if not math.isnan(value):
                self.add_scalar(name, value, frames)
        self._add(hparams({}, {})[2])

    def _add(self, summary: Summary, frames: int | None = None) -> None:
        assert self.file_writer is not None
        self.file_writer.add_summary(summary, frames)


def encode_film(pictures: Sequence[Picture], rate_hz: float) -> bytes:
    """A GIF that repeats for ever; `pictures` are RGB (height, width, 3)."""
    # One palette for all, so that the ground does not flicker.
    palette = Image.fromarray(np.concatenate(pictures[:: max(1, len(pictures) // 8)])).quantize(_COLOURS)
    first, *rest = (
        Image.fromarray(each).quantize(palette=palette, dither=Image.Dither.NONE) for each in pictures
    )
    encoded = io.BytesIO()
    first.save(
        encoded, format="gif", save_all=True, append_images=rest, duration=round(1000 / rate_hz), loop=0
    )
    return encoded.getvalue()


# An animation of a GIF's few colours; film.mp4 has the pictures as they are.
_WIDTH = 400
_RATE_HZ = 6.0
_MOST_PICTURES = 90


def reduce_picture(picture: Picture) -> Picture:
    """A picture, RGB (height, width, 3), as small as `log_film` shows it."""
    return np.asarray(ImageOps.contain(Image.fromarray(picture), (_WIDTH, _WIDTH * 10)))


def log_film(folder: Path, pictures: Sequence[Picture], rate_hz: float, frames: int) -> None:
    """Show reduced `pictures`, RGB (height, width, 3) at `rate_hz`, beside the other events of a run.

    There are some pictures a second, and of a long film only some of these: TensorBoard loads it whole.
    """
    every = max(1, round(rate_hz / _RATE_HZ), -(-len(pictures) // _MOST_PICTURES))
    with EventFile(folder) as events:
        events.film("film", pictures[::every], rate_hz / every, frames)


# These say how a run is run, and not what is learned.
_LEFT_OUT = (
    *("run_dir", "resume", "film", "hydra", "device"),
    *("learning.collector", "learning.evaluation", "learning.checkpoint", "learning.threads"),
)


def choose_hyperparameters(config: Mapping[str, Any], words: Sequence[str] = ()) -> dict[str, HParam]:
    """The hyperparameters of a run in a resolved `config`: world, robot, algorithm, seed, length and `words`.

    `words` come from the command line or from a job of a sweep, KEY=VALUE: whatever a sweep changes has a
    column, also in the run that has the default. TensorBoard shows few columns at first: there are no others.
    """
    found: dict[str, HParam] = {}
    # Robots are the first of the groups.
    first: Mapping[str, Any] = next(iter((config.get("agents") or {}).values()), {})
    for name, option in (
        ("world", config.get("world")),
        ("robot", first.get("body")),
        ("algorithm", config.get("learning")),
    ):
        if isinstance(option, Mapping) and "name" in option:
            found[name] = str(option["name"])
    for name in ("seed", "total_frames"):
        if name in config:
            found[name] = config[name]
    for word in words:
        name, _, text = word.lstrip("+").partition("=")
        left_out = any(name == each or name.startswith((f"{each}.", f"{each}/")) for each in _LEFT_OUT)
        if text and not name.startswith("~") and not left_out:
            found[name] = _value(config, name, text)
    return found


def _value(config: Mapping[str, Any], name: str, text: str) -> HParam:
    """The setting's resolved value; the word's text where it names an option of several settings."""
    found: Any = config
    for key in name.split("."):
        found = found.get(key) if isinstance(found, Mapping) else None
    if isinstance(found, bool | int | float | str):
        return found
    if isinstance(found, list):
        return str(found)
    # Shorthands of agent groups are in no resolved settings.
    value = yaml.safe_load(text) if found is None and text[0] not in "[{" else text
    return value if isinstance(value, bool | int | float) else text
