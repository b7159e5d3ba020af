"""Persons on foot: upright capsules that walk as a unicycle does."""

from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from dune_rl.bodies.motion import MotionLimits
from dune_rl.bodies.settings import BodySettings
from dune_rl.geometry.arrays import Array, Floats
from dune_rl.physics.shapes import KinematicCapsule
from dune_rl.rendering.light import srgb_to_linear
from dune_rl.rendering.scenery import ColouredMesh, Segment
from dune_rl.state.sensor_carrier import SensorCarrier

_SIDES = 24
# Upper ends of the clothes as shares of the height, and their colours (sRGB).
_CLOTHES = (
    (0.05, (0.10, 0.09, 0.08)),
    (0.47, (0.16, 0.20, 0.34)),
    (0.55, (0.93, 0.45, 0.10)),
    (0.58, (0.86, 0.87, 0.84)),
    (0.68, (0.93, 0.45, 0.10)),
    (0.71, (0.86, 0.87, 0.84)),
    (0.82, (0.93, 0.45, 0.10)),
    (0.91, (0.80, 0.60, 0.47)),
    (1.00, (0.95, 0.80, 0.12)),
)


class PersonConf(BodySettings):
    """Size and motion limits of a person: never backwards, and turns take time.

    With `looks: figure` it has a head, arms and legs that swing with its stride; `pillar` is the capsule in
    clothes that physics has. Figures in `mixed` clothes wear one of six outfits in turn.
    """

    name: Literal["person"] = "person"
    speed_mps: float = Field(1.0, gt=0.0, le=5.0)
    max_turn_radps: float = Field(3.0, gt=0.0, le=50.0)
    radius_m: float = Field(0.25, gt=0.0, le=2.0)
    height_m: float = Field(1.75, gt=0.0, le=5.0)
    # Largest horizontal force on robots [N], see `KinematicCapsule`.
    max_push_n: float = Field(250.0, gt=0.0, le=5_000.0)
    max_slope_deg: float = Field(45.0, gt=0.0, le=90.0)
    max_water_m: float = Field(1.0, ge=0.0, le=100.0)
    looks: Literal["pillar", "figure"] = "pillar"
    clothes: Literal["alike", "mixed"] = "alike"

    kind: ClassVar[str] = "person"

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if self.height_m <= 2 * self.radius_m:
            raise ValueError(f"height_m ({self.height_m}) must be more than twice radius_m ({self.radius_m})")
        if self.clothes == "mixed" and self.looks == "pillar":
            raise ValueError("clothes: mixed are those of figures: set looks to figure, or clothes to alike")
        return self

    @property
    def size_m(self) -> tuple[float, float, float]:
        """Length, width and height [m]."""
        return 2 * self.radius_m, 2 * self.radius_m, self.height_m

    @property
    def num_frames(self) -> int:
        """Number of pictures of a stride."""
        return 12 if self.looks == "figure" else 1

    @property
    def num_looks(self) -> int:
        """Number of outfits."""
        if self.clothes == "alike":
            return 1
        from dune_rl.bodies.meshes.person import NUM_OUTFITS

        return NUM_OUTFITS

    @property
    def is_round(self) -> bool:
        """A person's outline is a disc."""
        return True

    @property
    def stride_m(self) -> float:
        """Length of a stride [m], two steps: about 0.8 times the height."""
        return 0.8 * self.height_m

    def limits(self) -> MotionLimits:
        """How it moves."""
        return MotionLimits(self.motion_model, self.speed_mps, self.max_turn_radps)

    def collision_shape(self, name: str) -> KinematicCapsule:
        """The capsule that physics moves, called `name`."""
        return KinematicCapsule(name, self.radius_m, self.height_m, self.max_push_n)

    def carrier(self) -> SensorCarrier:
        """The person as a carrier of sensors: scanners at the hip, a camera at the eyes."""
        return SensorCarrier(
            scanner_b=(0.0, 0.0, 0.55 * self.height_m),
            camera_b=(0.0, 0.0, 0.93 * self.height_m),
            imu_b=(0.0, 0.0, 0.55 * self.height_m),
            max_speed_mps=self.speed_mps,
        )

    def picture(self, phase: float) -> ColouredMesh:
        """The person at a phase of its stride, in the first outfit."""
        return self.look(0, phase)

    def look(self, number: int, phase: float) -> ColouredMesh:
        """The person in an outfit, at a phase of its stride; a pillar looks the same at each."""
        if self.looks == "pillar":
            return _capsule_in_clothes(self.radius_m, self.height_m)
        from dune_rl.bodies.meshes.person import draw_person

        return draw_person(self, phase, number)


class ChildConf(PersonConf):
    """A child of about seven years."""

    name: Literal["child"] = "child"  # type: ignore[assignment]
    speed_mps: float = Field(1.2, gt=0.0, le=5.0)
    radius_m: float = Field(0.18, gt=0.0, le=2.0)
    height_m: float = Field(1.22, gt=0.0, le=5.0)
    max_push_n: float = Field(100.0, gt=0.0, le=5_000.0)
    max_turn_radps: float = Field(4.0, gt=0.0, le=50.0)
    max_water_m: float = Field(0.4, ge=0.0, le=100.0)
    looks: Literal["pillar", "figure"] = "figure"

    def picture(self, phase: float) -> ColouredMesh:
        """The child at a phase of its stride."""
        return super().picture(phase)


def _capsule_in_clothes(radius_m: float, height_m: float) -> ColouredMesh:
    # Only now: it takes half a second to load, and those who read settings need none of it.
    import trimesh

    bends = np.linspace(0.0, np.pi / 2, 7)
    round_end = np.column_stack([np.sin(bends), 1.0 - np.cos(bends)]) * radius_m
    seams = height_m * np.array([top for top, _ in _CLOTHES[:-1]])
    seams = seams[(seams > radius_m * 1.05) & (seams < height_m - radius_m * 1.05)]
    sides = np.column_stack([np.full(len(seams), radius_m), seams])
    upper = np.column_stack([round_end[::-1, 0], height_m - round_end[::-1, 1]])
    mesh = trimesh.creation.revolve(np.concatenate([round_end, sides, upper]), sections=_SIDES)
    middle = mesh.triangles_center[:, 2] / height_m
    return ColouredMesh(
        mesh.vertices,
        mesh.faces.astype(np.int32),
        _clothes_colour(middle),
        np.full(len(mesh.faces), Segment.ACTOR, np.uint8),
    )


def _clothes_colour(share: Array) -> Floats:
    """Linear RGB (F, 3) at shares (F,) of the height."""
    tops = np.array([top for top, _ in _CLOTHES])
    colours = srgb_to_linear(np.array([colour for _, colour in _CLOTHES]))
    return colours[np.minimum(np.searchsorted(tops, share), len(tops) - 1)]
