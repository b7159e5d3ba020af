"""Persons on foot: capsules that walk as a unicycle does, or figures with head, arms and legs."""

from dataclasses import replace
from typing import ClassVar, Literal, NamedTuple, Self

import numpy as np
from pydantic import Field, model_validator

from dune_rl.bodies.motion import MotionLimits
from dune_rl.bodies.settings import BodySettings
from dune_rl.bodies.solids import Colour, at, ball, box, disc, rod, tube
from dune_rl.physics.shapes import KinematicCapsule
from dune_rl.rendering.light import srgb_to_linear
from dune_rl.rendering.scenery import ColouredMesh, Segment, join_meshes

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
    is_round: ClassVar[bool] = True
    camera_height: ClassVar[float] = 0.93

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if self.height_m <= 2 * self.radius_m:
            raise ValueError(f"height_m ({self.height_m}) must be more than twice radius_m ({self.radius_m})")
        if self.clothes == "mixed" and self.looks == "pillar":
            raise ValueError("clothes: mixed are those of figures: set looks to figure, or clothes to alike")
        return self

    @property
    def size_m(self) -> tuple[float, float, float]:
        return 2 * self.radius_m, 2 * self.radius_m, self.height_m

    @property
    def num_frames(self) -> int:
        return 12 if self.looks == "figure" else 1

    @property
    def num_looks(self) -> int:
        return 1 if self.clothes == "alike" else len(_MIXED)

    @property
    def stride_m(self) -> float:
        """Length of a stride [m], two steps: about 0.8 times the height."""
        return 0.8 * self.height_m

    def limits(self) -> MotionLimits:
        return MotionLimits(self.motion_model, self.speed_mps, self.max_turn_radps)

    def collision_shape(self, name: str) -> KinematicCapsule:
        return KinematicCapsule(name, self.radius_m, self.height_m, self.max_push_n)

    def picture(self, phase: float) -> ColouredMesh:
        """The person at a phase of its stride, in the first outfit."""
        return self.look(0, phase)

    def look(self, number: int, phase: float) -> ColouredMesh:
        """The person in an outfit, at a phase of its stride; a pillar looks the same at each."""
        if self.looks == "pillar":
            return _capsule_in_clothes(self.radius_m, self.height_m)
        return _figure(self, phase, _MIXED[number] if self.clothes == "mixed" else None)


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
    clothes = np.searchsorted([top for top, _ in _CLOTHES], middle).clip(max=len(_CLOTHES) - 1)
    colours = srgb_to_linear(np.array([colour for _, colour in _CLOTHES]))[clothes]
    segments = np.full(len(mesh.faces), Segment.ACTOR, np.uint8)
    return ColouredMesh(mesh.vertices, mesh.faces.astype(np.int32), colours, segments)


_EYES = (0.06, 0.05, 0.05)
_SHOES = (0.10, 0.09, 0.08)


class Outfit(NamedTuple):
    """Colours (sRGB) of a person's clothes, skin and hair; `hat` is a hard hat's, None without one."""

    coat: Colour
    band: Colour
    trousers: Colour
    skin: Colour = (0.80, 0.60, 0.47)
    hair: Colour = (0.20, 0.13, 0.08)
    hat: Colour | None = None


_WORK = Outfit((0.93, 0.45, 0.10), (0.90, 0.92, 0.86), (0.16, 0.20, 0.34), hat=(0.95, 0.80, 0.12))
_CHILD = Outfit((0.80, 0.12, 0.20), (0.95, 0.85, 0.30), (0.20, 0.38, 0.60))
_MIXED = (
    Outfit((0.16, 0.32, 0.55), (0.13, 0.26, 0.46), (0.22, 0.22, 0.24)),
    Outfit((0.72, 0.70, 0.64), (0.60, 0.58, 0.53), (0.20, 0.27, 0.40), (0.42, 0.28, 0.2), (0.07, 0.06, 0.06)),
    Outfit((0.55, 0.13, 0.16), (0.45, 0.10, 0.13), (0.72, 0.65, 0.5), (0.86, 0.68, 0.57), (0.55, 0.38, 0.18)),
    Outfit((0.23, 0.42, 0.26), (0.19, 0.34, 0.22), (0.3, 0.24, 0.18), (0.6, 0.42, 0.3), (0.10, 0.08, 0.07)),
    Outfit((0.86, 0.83, 0.78), (0.86, 0.83, 0.78), (0.13, 0.15, 0.2), (0.33, 0.22, 0.16), (0.05, 0.05, 0.05)),
    Outfit((0.8, 0.62, 0.18), (0.66, 0.50, 0.14), (0.35, 0.38, 0.42), (0.88, 0.72, 0.62), (0.42, 0.25, 0.13)),
)  # fmt: skip
# Largest angles of thighs, shins and arms in a stride [rad].
_THIGH, _KNEE, _ARM = 0.45, 0.75, 0.40


def _figure(conf: PersonConf, phase: float, outfit: Outfit | None) -> ColouredMesh:
    """A person at a phase in [0, 1): without `outfit` an adult in a vest and a hard hat, or a child."""
    is_child = conf.height_m < 1.4
    clothes = outfit or (_CHILD if is_child else _WORK)
    head = 0.105 if is_child else 0.075
    tall = conf.height_m
    wide = min(conf.radius_m, 0.16 * tall)
    hip, shoulder = 0.50 * tall, (0.76 if is_child else 0.80) * tall

    def column(rings: list[tuple[float, float, float]], colour: Colour) -> ColouredMesh:
        """Upright, through rings at a height, with half-axes in units of `wide`."""
        return tube(
            [((0, 0, z), aside, ahead) for z, aside, ahead in rings], colour, 10, wide=wide, high=wide
        )

    chest = [
        (hip + 0.03 * tall, 0.62, 0.42), (hip + 0.12 * tall, 0.62, 0.42),
        (shoulder - 0.06 * tall, 0.72, 0.46), (shoulder, 0.60, 0.36), (shoulder + 0.025 * tall, 0.25, 0.22),
    ]  # fmt: skip
    nose = (head * tall, 0, tall * (1 - 1.25 * head))
    crown = (-0.004 * tall if not is_child else -0.016 * tall, 0, tall * (1 - 0.72 * head))
    hair = (1.06 * head * tall, 0.92 * head * tall, 0.83 * head * tall)
    parts = [
        # Pelvis, chest, the bands of the vest, and the neck.
        column([(hip - 0.04 * tall, 0.55, 0.34), (hip + 0.05 * tall, 0.60, 0.38)], clothes.trousers),
        column(chest, clothes.coat),
        column([(hip + 0.10 * tall, 0.645, 0.445), (hip + 0.125 * tall, 0.645, 0.445)], clothes.band),
        rod((0, 0, shoulder), (0, 0, shoulder + 0.06 * tall), 0.2 * wide, clothes.skin),
        ball(
            (0.01 * tall, 0, tall * (1 - 1.1 * head)),
            (0.95 * head * tall, 0.8 * head * tall, 1.1 * head * tall),
            clothes.skin,
            10,
            6,
        ),
        *(
            ball((0.84 * head * tall, y * head * tall, tall * (1 - head)), (0.010 * tall,) * 3, _EYES, 5, 3)
            for y in (-0.34, 0.34)
        ),
        box(nose, (0.03 * tall, 0.016 * tall, 0.025 * tall), clothes.skin),
        ball(crown, hair, clothes.hat or clothes.hair, 10, 5),
    ]
    if clothes.hat is not None:
        brim = (0.015 * tall, 0, tall * (1 - 0.85 * head))
        parts.append(disc(brim, 1.25 * head * tall, 0.012 * tall, clothes.hat, 12, 2))
    swing = np.sin(2 * np.pi * phase)
    for side in (-1.0, 1.0):
        parts += _leg(side * swing, side * np.cos(2 * np.pi * phase), side, tall, wide, hip, clothes.trousers)
        parts += _arm(-side * swing, side, tall, wide, shoulder, clothes)
    mesh = join_meshes(parts)
    # A foot is on the ground at every phase.
    return replace(mesh, vertices=mesh.vertices - [0.0, 0.0, mesh.vertices[:, 2].min()])


def _leg(
    swing: float, lift: float, side: float, tall: float, wide: float, hip: float, colour: Colour
) -> list[ColouredMesh]:
    thigh = _THIGH * swing
    # The knee bends while the leg comes forward.
    knee = _KNEE * max(lift, 0.0) + 0.08
    length = hip / 2 - 0.02 * tall
    top = np.array([0.0, side * 0.32 * wide, hip])
    middle = top + length * np.array([np.sin(thigh), 0.0, -np.cos(thigh)])
    foot = middle + length * np.array([np.sin(thigh - knee), 0.0, -np.cos(thigh - knee)])
    along = np.array([np.cos(thigh - knee), 0.0, np.sin(thigh - knee)])
    toe, heel = foot + 0.09 * tall * along, foot - 0.03 * tall * along
    thick = 0.32 * wide
    leg = [(top, 1.0, 1.0), (middle, 0.72, 0.76), (foot, 0.5, 0.55)]
    shoe = [(heel, 0.5, 0.5), (foot + at(0, 0, 0.005), 0.55, 0.55), (toe, 0.48, 0.28)]
    return [
        tube(leg, colour, 7, wide=thick, high=thick),
        tube(shoe, _SHOES, 6, wide=thick, high=thick),
    ]


def _arm(
    swing: float, side: float, tall: float, wide: float, shoulder: float, clothes: Outfit
) -> list[ColouredMesh]:
    angle = _ARM * swing
    bend = 0.25 + 0.2 * max(swing, 0.0)
    length = 0.17 * tall
    top = np.array([0.0, side * 0.72 * wide, shoulder - 0.025 * tall])
    out = side * 0.06 * tall
    elbow = top + np.array([length * np.sin(angle), 0.35 * out, -length * np.cos(angle)])
    hand = elbow + 0.95 * length * np.array([np.sin(angle + bend), 0.0, -np.cos(angle + bend)])
    thick = 0.19 * wide
    arm = [(top, 1.0, 1.0), (elbow, 0.85, 0.85), (hand, 0.65, 0.65)]
    palm = hand + at(0.0, 0.0, -0.012 * tall)
    return [
        tube(arm, clothes.coat, 6, wide=thick, high=thick),
        ball(palm, (0.85 * thick, 0.7 * thick, 1.1 * thick), clothes.skin, 6, 3),
    ]
