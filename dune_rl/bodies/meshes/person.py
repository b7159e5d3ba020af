"""Persons with a head, arms and legs that swing with the stride."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from dune_rl.bodies.meshes.solids import Colour, at, ball, box, disc, tube, union
from dune_rl.rendering.scenery import ColouredMesh

if TYPE_CHECKING:
    from dune_rl.bodies.person import PersonConf

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
    Outfit(
        (0.72, 0.70, 0.64), (0.60, 0.58, 0.53), (0.20, 0.27, 0.40), (0.42, 0.28, 0.20), (0.07, 0.06, 0.06)
    ),
    Outfit(
        (0.55, 0.13, 0.16), (0.45, 0.10, 0.13), (0.72, 0.65, 0.50), (0.86, 0.68, 0.57), (0.55, 0.38, 0.18)
    ),
    Outfit(
        (0.23, 0.42, 0.26), (0.19, 0.34, 0.22), (0.30, 0.24, 0.18), (0.60, 0.42, 0.30), (0.10, 0.08, 0.07)
    ),
    Outfit(
        (0.86, 0.83, 0.78), (0.86, 0.83, 0.78), (0.13, 0.15, 0.20), (0.33, 0.22, 0.16), (0.05, 0.05, 0.05)
    ),
    Outfit(
        (0.80, 0.62, 0.18), (0.66, 0.50, 0.14), (0.35, 0.38, 0.42), (0.88, 0.72, 0.62), (0.42, 0.25, 0.13)
    ),
)
# How many outfits people in mixed clothes have.
NUM_OUTFITS = len(_MIXED)
# Largest angles of thighs, shins and arms in a stride [rad].
_THIGH, _KNEE, _ARM = 0.45, 0.75, 0.40


def draw_person(conf: "PersonConf", phase: float, look: int = 0) -> ColouredMesh:
    """A person at a phase in [0, 1): an adult, in a vest and a hard hat unless clothes are mixed, or a child.

    `look` is the number of the outfit of mixed clothes.
    """
    is_child = conf.height_m < 1.4
    alike = _CHILD if is_child else _WORK
    clothes = _MIXED[look] if conf.clothes == "mixed" else alike
    head = 0.105 if is_child else 0.075
    tall = conf.height_m
    wide = min(conf.radius_m, 0.16 * tall)
    hip, shoulder = 0.50 * tall, (0.76 if is_child else 0.80) * tall
    parts = [
        # Pelvis, chest and the bands of the vest.
        tube(
            [
                ((0, 0, hip - 0.04 * tall), 0.55 * wide, 0.34 * wide),
                ((0, 0, hip + 0.05 * tall), 0.60 * wide, 0.38 * wide),
            ],
            clothes.trousers,
            10,
        ),
        tube(
            [
                ((0, 0, hip + 0.03 * tall), 0.62 * wide, 0.42 * wide),
                ((0, 0, hip + 0.12 * tall), 0.62 * wide, 0.42 * wide),
                ((0, 0, shoulder - 0.06 * tall), 0.72 * wide, 0.46 * wide),
                ((0, 0, shoulder), 0.60 * wide, 0.36 * wide),
                ((0, 0, shoulder + 0.025 * tall), 0.25 * wide, 0.22 * wide),
            ],
            clothes.coat,
            10,
        ),
        tube(
            [
                ((0, 0, hip + 0.10 * tall), 0.645 * wide, 0.445 * wide),
                ((0, 0, hip + 0.125 * tall), 0.645 * wide, 0.445 * wide),
            ],
            clothes.band,
            10,
        ),
        tube(
            [
                ((0, 0, shoulder), 0.2 * wide, 0.2 * wide),
                ((0, 0, shoulder + 0.06 * tall), 0.2 * wide, 0.2 * wide),
            ],
            clothes.skin,
            6,
        ),
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
        box(
            (head * tall, 0, tall * (1 - 1.25 * head)),
            (0.03 * tall, 0.016 * tall, 0.025 * tall),
            clothes.skin,
        ),
    ]
    crown = (-0.004 * tall if not is_child else -0.016 * tall, 0, tall * (1 - 0.72 * head))
    parts.append(
        ball(
            crown,
            (1.06 * head * tall, 0.92 * head * tall, 0.83 * head * tall),
            clothes.hat or clothes.hair,
            10,
            5,
        )
    )
    if clothes.hat is not None:
        parts.append(
            disc(
                (0.015 * tall, 0, tall * (1 - 0.85 * head)),
                1.25 * head * tall,
                0.012 * tall,
                clothes.hat,
                12,
                2,
            )
        )
    swing = np.sin(2 * np.pi * phase)
    for side in (-1.0, 1.0):
        parts += _leg(side * swing, side * np.cos(2 * np.pi * phase), side, tall, wide, hip, clothes.trousers)
        parts += _arm(-side * swing, side, tall, wide, shoulder, clothes)
    return _on_ground(union(parts))


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
    toe = foot + 0.09 * tall * np.array([np.cos(thigh - knee), 0.0, np.sin(thigh - knee)])
    heel = foot - 0.03 * tall * np.array([np.cos(thigh - knee), 0.0, np.sin(thigh - knee)])
    thick = 0.32 * wide
    return [
        tube(
            [(top, thick, thick), (middle, 0.72 * thick, 0.76 * thick), (foot, 0.5 * thick, 0.55 * thick)],
            colour,
            7,
        ),
        tube(
            [
                (heel, 0.5 * thick, 0.5 * thick),
                (foot + at(0, 0, 0.005), 0.55 * thick, 0.55 * thick),
                (toe, 0.48 * thick, 0.28 * thick),
            ],
            _SHOES,
            6,
        ),
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
    return [
        tube(
            [(top, thick, thick), (elbow, 0.85 * thick, 0.85 * thick), (hand, 0.65 * thick, 0.65 * thick)],
            clothes.coat,
            6,
        ),
        ball(
            hand + at(0.0, 0.0, -0.012 * tall), (0.85 * thick, 0.7 * thick, 1.1 * thick), clothes.skin, 6, 3
        ),
    ]


def _on_ground(mesh: ColouredMesh) -> ColouredMesh:
    """The mesh moved up or down so that its lowest point is on the ground: a foot is, at every phase."""
    vertices = mesh.vertices - [0.0, 0.0, mesh.vertices[:, 2].min()]
    return ColouredMesh(vertices, mesh.faces, mesh.albedo, mesh.segments)
