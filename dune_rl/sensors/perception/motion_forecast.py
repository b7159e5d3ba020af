"""A learnt forecast of tracks: which of them are agents, how fast these move, and where they will be."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from scipy.special import expit

from dune_rl.core.errors import ConfigError
from dune_rl.core.paths import assets_folder
from dune_rl.core.suggestions import advise
from dune_rl.core.untrusted_files import load_npz
from dune_rl.geometry.arrays import Array, Floats
from dune_rl.geometry.compiled import compile_function
from dune_rl.geometry.frames import frames_of_poses, into_frames, out_of_frames
from dune_rl.sensors.perception.scan_tracks import HISTORY_STEPS, ScanTracker

# In the folder of a forecast.
FORECAST_FILE = "forecast.npz"
# A forecast tells of so many times ahead [s].
AHEAD_S = (0.5, 1.0, 1.5, 2.0, 2.5)
# A track is an agent from this chance on.
LEAST_CHANCE = 0.5
# Returns within this of where an agent is by its forecast are taken for the agent's [m].
_NEAR_M = 0.42
_FARTHEST_M, _FASTEST_MPS, _OLDEST_S, _MOST_RAYS = 2.0, 3.0, 5.0, 20.0
# Numbers of a track's features, and of what is told of it: the chance's logit, a place, a velocity and the
# places ahead.
FEATURES = 6 * HISTORY_STEPS + 9
OUTPUTS = 1 + 2 * (2 + len(AHEAD_S))
_LAYERS = 4


def find_forecast(name: str) -> Path:
    """The file of a forecast: of this name in `assets/forecasts`, in a folder, or itself a file.

    Raises ConfigError without.
    """
    folder, given = assets_folder() / "forecasts", Path(name).expanduser()
    for file in (folder / f"{name}.npz", given / FORECAST_FILE, given):
        if file.is_file():
            return file
    known = advise(name, sorted(path.stem for path in folder.glob("*.npz")))
    raise ConfigError(f"there is no forecast {name!r} ({known}), nor a folder of python -m dune_rl.forecast")


def track_features(tracks: Array, histories: Array, poses: Array) -> tuple[Floats, Array]:
    """Features (R, F) of `tracks` (R, columns) with their `histories` (R, steps, columns), and their frames.

    `poses` (R, 3) are those of the robots, in the frame of the odometry, as are tracks and histories. A
    track's frame (R, 4: x, y, cos, sin of its x axis) is where it is, its x axis away from the robot.
    """
    sight = tracks[:, :2] - poses[:, :2]
    away = np.hypot(sight[:, 0], sight[:, 1])
    frames = np.column_stack([tracks[:, :2], sight / np.maximum(away, 1e-3)[:, None]])
    seen = histories[..., 0]
    places = np.clip(into_frames(frames, histories[..., 1:3]), -_FARTHEST_M, _FARTHEST_M) * seen[..., None]
    still = frames.copy()
    still[:, :2] = 0.0
    velocity = into_frames(still, tracks[:, None, 2:4])[:, 0]
    begun = into_frames(frames, tracks[:, None, 8:10])[:, 0]
    parts = (
        places.reshape(len(tracks), 2 * HISTORY_STEPS), seen, 5.0 * histories[..., 3],
        np.minimum(histories[..., 4], _MOST_RAYS) / 10.0, histories[..., 5],
        np.clip(velocity, -_FASTEST_MPS, _FASTEST_MPS), np.sqrt(np.maximum(tracks[:, 4:6], 0.0)),
        tracks[:, 7:8], np.minimum(tracks[:, 10:11], _OLDEST_S), away[:, None] / 4.0,
        np.clip(begun, -_OLDEST_S, _OLDEST_S) / 2.0,
    )  # fmt: skip
    return np.concatenate(parts, axis=1).astype(np.float32), frames


def constant_velocity(features: Floats) -> Floats:
    """What a track's filter tells, (R, 2 + A, 2): no other place, its velocity, and places ahead by that.

    Forecasts are told beside it, in units of `OUTPUT_SCALES`.
    """
    first = 6 * HISTORY_STEPS
    velocity = features[:, None, first : first + 2]
    times = np.array([0.0, 1.0, *AHEAD_S], np.float32)
    return velocity * times[:, None]


# Errors of a filter that are usual: of a place, of a velocity, of places ahead.
OUTPUT_SCALES = np.array([0.1, 0.3, *(0.1 + 0.3 * time for time in AHEAD_S)], np.float32)[:, None]


def read_forecast(name: str, step_s: float) -> "MotionForecast":
    """The forecast of a name or a file, for scans every `step_s` [s]; raises ConfigError where it is none."""
    file = find_forecast(name)
    weights = _read_weights(file)
    made_for = float(weights["step_s"])
    if not np.isclose(made_for, step_s):
        raise ConfigError(
            f"{file} forecasts tracks of scans every {made_for:g} s, and these come every {step_s:g} s: "
            "set physics.control_hz, or train a forecast for it with python -m dune_rl.forecast"
        )
    return MotionForecast(weights)


class MotionForecast:
    """A network of dense layers that forecasts tracks: arrays that `python -m dune_rl.forecast` writes."""

    def __init__(self, weights: Mapping[str, Any]) -> None:
        self._mean, self._scale = weights["mean"], weights["scale"]
        self._layers = [(weights[f"weight_{n}"], weights[f"bias_{n}"]) for n in range(_LAYERS)]

    def predict(self, features: Floats) -> tuple[Floats, Floats]:
        """Chances (R,) that tracks are agents, and (R, 2 + A, 2) in their frames: place, velocity, places
        ahead.
        """
        values = (features - self._mean) / self._scale
        for number, (weight, bias) in enumerate(self._layers):
            values = values @ weight + bias
            if number < _LAYERS - 1:
                values = values * expit(values)
        beside = values[:, 1:].reshape(len(values), len(OUTPUT_SCALES), 2) * OUTPUT_SCALES
        return expit(values[:, 0]), constant_velocity(features) + beside

    def revise(self, tracker: ScanTracker) -> Array:
        """Set what moves, of a tracker that has taken a scan, to the agents among its tracks.

        Returns where these will be, (N, T, A, 2) [m] in the frame of the odometry, in the order of
        `tracker.moving`.
        """
        rows, numbers = np.nonzero(np.arange(tracker.tracks.shape[1]) < tracker.counts[:, None])
        poses = tracker.poses[rows]
        features, frames = track_features(
            tracker.tracks[rows, numbers], tracker.histories[rows, numbers], poses
        )
        chances, told = self.predict(features)
        agents = chances >= LEAST_CHANCE
        rows, poses, frames, told = rows[agents], poses[agents], frames[agents], told[agents]
        order = np.arange(len(rows)) - np.searchsorted(rows, rows)
        still = frames.copy()
        still[:, :2] = 0.0
        places = out_of_frames(frames, np.delete(told, 1, axis=1).astype(np.float64))
        velocities = out_of_frames(still, told[:, 1:2].astype(np.float64))
        bodies = frames_of_poses(poses)
        turned = bodies.copy()
        turned[:, :2] = 0.0
        tracker.moving[rows, order, :2] = into_frames(bodies, places[:, :1])[:, 0]
        tracker.moving[rows, order, 2:] = into_frames(turned, velocities)[:, 0]
        tracker.moving_counts[:] = np.bincount(rows, minlength=len(tracker.counts))
        _assign_returns(
            tracker.points, tracker.sees, tracker.moving, tracker.moving_counts, tracker.velocities
        )
        ahead = np.zeros((*tracker.tracks.shape[:2], len(AHEAD_S), 2))
        ahead[rows, order] = places[:, 1:]
        return ahead


def _read_weights(file: Path) -> Mapping[str, Any]:
    try:
        found = load_npz(file)
    except OSError as error:
        raise ConfigError(f"{file} cannot be read as a forecast: {error.strerror or error}") from None
    except (ValueError, NotImplementedError, RuntimeError, EOFError, BadZipFile):
        raise ConfigError(f"{file} cannot be read as a forecast: it is no whole file of arrays") from None
    sizes = [FEATURES, *(np.size(found.get(f"bias_{n}", 0.0)) for n in range(_LAYERS - 1)), OUTPUTS]
    shapes: dict[str, tuple[int, ...]] = {"mean": (FEATURES,), "scale": (FEATURES,), "step_s": ()}
    for n in range(_LAYERS):
        shapes |= {f"weight_{n}": (sizes[n], sizes[n + 1]), f"bias_{n}": (sizes[n + 1],)}
    for name, shape in shapes.items():
        values = found.get(name, np.zeros(0, bool))
        is_sound = values.shape == shape and values.dtype.kind == "f" and bool(np.isfinite(values).all())
        if not is_sound or (name == "scale" and bool((values <= 0.0).any())):
            raise ConfigError(
                f"{file} is no forecast of this version: it has no sound {name}; train one with "
                "python -m dune_rl.forecast"
            )
    return found


@compile_function
def _assign_returns(points: Any, sees: Any, moving: Any, counts: Any, velocities: Any) -> None:
    """Fill the `velocities` (N, S, 2) of rays, which end at `points` (N, S, 2), with those of the nearest of
    what is `moving` (N, T, 4), `counts` (N,) of them, or zeros where none is near.
    """
    for row in range(len(points)):
        for ray in range(points.shape[1]):
            velocities[row, ray] = 0.0
            nearest = _NEAR_M * _NEAR_M
            if not sees[row, ray]:
                continue
            for number in range(counts[row]):
                right = points[row, ray, 0] - moving[row, number, 0]
                up = points[row, ray, 1] - moving[row, number, 1]
                if right * right + up * up < nearest:
                    nearest = right * right + up * up
                    velocities[row, ray, 0] = moving[row, number, 2]
                    velocities[row, ray, 1] = moving[row, number, 3]
