"""Settings of kinematic bodies: their size, how they move, where they can go and how they look."""

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np

from dune_rl.bodies import fields
from dune_rl.bodies.motion import Motion, MotionLimits, MotionModelName
from dune_rl.core.settings import Settings
from dune_rl.geometry.arrays import Array
from dune_rl.physics.shapes import KinematicBox, KinematicShape
from dune_rl.rendering.moving_mesh import MovingMesh
from dune_rl.rendering.scenery import ColouredMesh
from dune_rl.state.sensor_carrier import SensorCarrier


@dataclass(frozen=True)
class FlightBand:
    """Heights above the ground [m] of a flying body, and the room [m] that it needs over obstacles."""

    usual_m: float
    least_m: float
    most_m: float
    room_m: float


class BodySettings(Settings):
    """Settings of a kinematic body; `name` selects the settings class when a file is read.

    A subclass for a new body states the defaults of its fields, its `kind`, by which encounters and
    collisions are named, and its `motion_model`, and draws its `picture`. `motion` is a registered motion
    model in place of that one. Slopes of 90 degrees and depths of 100 m stand for any.
    """

    name: str
    speed_mps: fields.Speed = 1.0
    max_push_n: fields.Push = 250.0
    max_slope_deg: fields.Slope = 90.0
    max_water_m: fields.Depth = 100.0
    motion: Motion | None = None

    kind: ClassVar[str] = "body"
    motion_model: ClassVar[MotionModelName] = "unicycle"
    # Whether its outline in plan view is a disc, and not a rectangle.
    is_round: ClassVar[bool] = False
    # Height of a camera over that of the body.
    camera_height: ClassVar[float] = 0.9

    @property
    def size_m(self) -> tuple[float, float, float]:
        """Length, width and height [m]."""
        raise NotImplementedError

    @property
    def keep_out_radius_m(self) -> float:
        """Radius [m] of the disc round the origin that encloses the outline."""
        length, width, _ = self.size_m
        return length / 2 if self.is_round else float(np.hypot(length, width)) / 2

    @property
    def num_frames(self) -> int:
        """Number of pictures of a stride, or of a turn of a propeller; 1 without moving parts."""
        return 1

    @property
    def num_looks(self) -> int:
        """Number of looks, such as clothes, that the agents of a group have in turn."""
        return 1

    @property
    def stride_m(self) -> float:
        """Way [m] in which the pictures of a stride are gone through once."""
        return 1.0

    @property
    def max_bump_m(self) -> float:
        """Largest difference [m] of the ground below it from level ground that it can stand on."""
        return 1e3

    @property
    def supports_b(self) -> Array:
        """Points (P, 2) [m] of the body's plane by which it stands; (0, 2) for bodies that stay upright."""
        return np.zeros((0, 2))

    @property
    def flight(self) -> FlightBand | None:
        """The heights of a flying body; None for bodies on the ground."""
        return None

    def limits(self) -> MotionLimits:
        """How it moves."""
        raise NotImplementedError

    def discs_b(self) -> tuple[Array, float]:
        """Discs that cover the outline: centres (D,) [m] along the body's x axis, and their radius [m]."""
        length, width, _ = self.size_m
        if self.is_round:
            return np.zeros(1), length / 2
        count = max(1, round(length / width))
        part = length / count
        along = part * (np.arange(count, dtype=np.float64) - (count - 1) / 2)
        return along, float(np.hypot(part, width)) / 2

    def collision_shape(self, name: str) -> KinematicShape:
        """The shape that physics moves, called `name`: a box down to the ground, legs and wheels included."""
        length, width, height = self.size_m
        return KinematicBox(name, length, width, height, max_push_n=self.max_push_n)

    def carrier(self) -> SensorCarrier:
        """The body as a carrier of sensors: scanners at half its height, a camera in front or at the eyes."""
        length, _, height = self.size_m
        return SensorCarrier(
            scanner_b=(0.0, 0.0, 0.55 * height),
            camera_b=(0.0 if self.is_round else 0.4 * length, 0.0, self.camera_height * height),
            imu_b=(0.0, 0.0, 0.55 * height),
            max_speed_mps=self.speed_mps,
        )

    def mesh(self) -> MovingMesh:
        """What the sensors of others see, its origin on the ground."""
        return MovingMesh(pictures_of(self))

    def picture(self, phase: float) -> ColouredMesh:
        """How it looks at a `phase` in [0, 1) of its stride, or of a turn of its propellers."""
        raise NotImplementedError

    def look(self, number: int, phase: float) -> ColouredMesh:
        """The `picture` in one of its looks, by number."""
        return self.picture(phase)


@lru_cache(maxsize=64)
def pictures_of(body: BodySettings) -> tuple[ColouredMesh, ...]:
    """The coloured meshes of a body's frames, of one look after the other, made once for equal settings."""
    looks, frames = range(body.num_looks), range(body.num_frames)
    return tuple(body.look(look, frame / body.num_frames) for look in looks for frame in frames)


class RectangularBody(BodySettings):
    """A body that is longer than wide, with a rectangular outline."""

    length_m: fields.Length
    width_m: fields.Width
    height_m: fields.Height

    @property
    def size_m(self) -> tuple[float, float, float]:
        return self.length_m, self.width_m, self.height_m


class Vehicle(RectangularBody):
    """A vehicle on four wheels that steers with the front ones.

    `turning_circle_m` is the diameter between kerbs of the tightest turn: that of the outer front wheel's
    path. It drives backwards, at up to `reverse_mps`, to get free. `overhang_m` is the length behind the
    rear axle.
    """

    wheelbase_m: fields.Wheelbase
    track_m: fields.Track
    wheel_radius_m: fields.WheelRadius
    overhang_m: fields.Overhang
    turning_circle_m: fields.TurningCircle
    clearance_m: fields.Clearance
    acceleration_mps2: fields.Acceleration
    braking_mps2: fields.Braking
    reverse_mps: fields.Reverse = 1.0

    kind: ClassVar[str] = "vehicle"
    motion_model: ClassVar[MotionModelName] = "bicycle"

    @property
    def max_bump_m(self) -> float:
        """The ground must not reach the underside."""
        return self.clearance_m

    @property
    def rear_m(self) -> float:
        """Distance [m] of the rear axle behind the origin, which is at half the length."""
        return self.length_m / 2 - self.overhang_m

    @property
    def supports_b(self) -> Array:
        """Where the wheels stand, (4, 2) [m]."""
        rear, front = -self.rear_m, self.wheelbase_m - self.rear_m
        half = self.track_m / 2
        return np.array([[front, half], [front, -half], [rear, half], [rear, -half]])

    def limits(self) -> MotionLimits:
        """How it moves; the radius of the rear axle's middle follows from the turning circle."""
        # The outer front wheel runs on the circle, wheelbase and half a track away from that middle.
        across = max((self.turning_circle_m / 2) ** 2 - self.wheelbase_m**2, 0.0)
        radius = max(float(np.sqrt(across)) - self.track_m / 2, 0.2 * self.wheelbase_m)
        return MotionLimits(
            self.motion_model,
            self.speed_mps,
            turning_radius_m=radius,
            rear_m=self.rear_m,
            max_reverse_mps=self.reverse_mps,
            acceleration_mps2=self.acceleration_mps2,
            braking_mps2=self.braking_mps2,
        )


class Quadruped(RectangularBody):
    """An animal on four legs, which turns on the spot and leans with the ground."""

    max_turn_radps: fields.TurnRate = 2.0
    acceleration_mps2: fields.Acceleration = 2.0
    stride_m_per_m: fields.Stride = 1.0

    kind: ClassVar[str] = "animal"

    @property
    def num_frames(self) -> int:
        return 12

    @property
    def stride_m(self) -> float:
        """Length of a stride [m]: the way between two steps of the same foot."""
        return self.stride_m_per_m * self.length_m

    @property
    def supports_b(self) -> Array:
        """Where the feet stand, (4, 2) [m]."""
        along, aside = 0.3 * self.length_m, 0.3 * self.width_m
        return np.array([[along, aside], [along, -aside], [-along, aside], [-along, -aside]])

    def limits(self) -> MotionLimits:
        return MotionLimits(
            self.motion_model,
            self.speed_mps,
            self.max_turn_radps,
            acceleration_mps2=self.acceleration_mps2,
            braking_mps2=2.0 * self.acceleration_mps2,
        )
