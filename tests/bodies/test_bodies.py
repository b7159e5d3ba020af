"""Bodies of actors: what each of them says of itself, and what it looks like."""

import numpy as np
import pytest

import dune_rl
from dune_rl.bodies.animals import CowConf
from dune_rl.bodies.person import ChildConf, PersonConf
from dune_rl.bodies.registry import BODIES
from dune_rl.bodies.settings import BodySettings, Quadruped, pictures_of
from dune_rl.bodies.vehicles import CarConf, TractorConf, TruckConf
from dune_rl.core.errors import RegistryError
from dune_rl.rendering.scenery import ColouredMesh

MOVING = ("person", "child", "cow", "sheep", "dog")


def body(name: str, **settings: object) -> BodySettings:
    """The body of this name; a person with limbs."""
    looks = {"looks": "figure"} if name == "person" else {}
    made: BodySettings = BODIES.parse_settings({"name": name, **looks, **settings})
    return made


def is_closed(mesh: ColouredMesh) -> bool:
    """Whether every edge belongs to as many faces in one direction as in the other."""
    start, end = mesh.faces.ravel(), np.roll(mesh.faces, -1, axis=1).ravel()
    number = len(mesh.vertices)
    return np.array_equal(np.sort(start * number + end), np.sort(end * number + start))


@pytest.mark.parametrize("name", BODIES.own)
def test_a_mesh_has_the_size_of_its_body(name: str) -> None:
    made = body(name)
    length, width, height = made.size_m
    for picture in pictures_of(made):
        assert 200 <= len(picture.faces) <= 2000
        assert is_closed(picture)
        low, high = picture.vertices.min(axis=0), picture.vertices.max(axis=0)
        # Limbs and mirrors reach a little beyond the outline.
        reach = 0.35 * height if made.kind == "person" else 0.15
        assert max(-low[0], high[0]) <= length / 2 + reach
        assert max(-low[1], high[1]) <= width / 2 + 0.15
        assert -0.02 <= low[2] <= 0.02
        assert 0.85 * height <= high[2] <= 1.15 * height


@pytest.mark.parametrize("name", BODIES.own)
def test_meshes_are_made_once_and_alike(name: str) -> None:
    made = body(name)
    assert pictures_of(made) is pictures_of(body(name))
    again = made.picture(0.0)
    np.testing.assert_array_equal(again.vertices, pictures_of(made)[0].vertices)
    np.testing.assert_array_equal(again.albedo, pictures_of(made)[0].albedo)


@pytest.mark.parametrize("name", MOVING)
def test_limbs_swing_with_the_stride(name: str) -> None:
    pictures = pictures_of(body(name))
    assert len(pictures) == 12
    swings = [np.abs(picture.vertices - pictures[0].vertices).max() for picture in pictures[1:]]
    assert min(swings) > 0.02
    # Half a stride later the other leg is in front.
    assert swings[5] > 0.1 * body(name).size_m[2]


def test_a_pillar_is_one_picture() -> None:
    assert len(pictures_of(PersonConf())) == 1
    with pytest.raises(ValueError, match="set looks to figure"):
        PersonConf(clothes="mixed")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["person", "child"])
def test_people_in_mixed_clothes_differ_in_colour_alone(name: str) -> None:
    mixed = body(name, clothes="mixed")
    pictures = pictures_of(mixed)
    assert len(pictures) == mixed.num_frames * mixed.num_looks == 72
    for frame in range(12):
        outfits = pictures[frame::12]
        for one in outfits:
            assert is_closed(one)
            np.testing.assert_array_equal(one.vertices, outfits[0].vertices)
        colours = {one.albedo.tobytes() for one in outfits}
        assert len(colours) == 6


@pytest.mark.parametrize(("conf", "radius"), [(CarConf(), 3.7), (TruckConf(), 4.9), (TractorConf(), 2.7)])
def test_the_outer_front_wheel_runs_on_the_turning_circle(conf: CarConf, radius: float) -> None:
    limits = conf.limits()
    outer = np.hypot(limits.turning_radius_m + conf.track_m / 2, conf.wheelbase_m)
    assert 2 * outer == pytest.approx(conf.turning_circle_m)
    assert limits.turning_radius_m == pytest.approx(radius, abs=0.3)


@pytest.mark.parametrize("name", BODIES.own)
def test_discs_cover_the_outline(name: str) -> None:
    made = body(name)
    along, radius = made.discs_b()
    length, width, _ = made.size_m
    angle = np.linspace(0.0, 2 * np.pi, 200)
    if made.is_round:
        edge = length / 2 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    else:
        x = np.linspace(-length / 2, length / 2, 100)
        edge = np.concatenate([np.column_stack([x, np.full(100, side * width / 2)]) for side in (-1, 1)])
    apart = np.hypot(edge[:, 0, None] - along, edge[:, 1, None]).min(axis=1)
    assert apart.max() <= radius + 1e-9
    assert np.abs(along).max() + radius < made.keep_out_radius_m + 0.5


def test_a_child_is_a_smaller_person() -> None:
    child, person = ChildConf(), PersonConf()
    assert child.kind == person.kind == "person"
    assert child.height_m < 0.75 * person.height_m


def test_one_s_own_body_is_a_few_lines() -> None:
    @dune_rl.register_body("test_goat")
    class Goat(Quadruped):
        """A goat."""

        speed_mps: float = 2.0
        length_m: float = 1.1
        width_m: float = 0.4
        height_m: float = 0.9

        def picture(self, phase: float) -> ColouredMesh:
            """As a small cow."""
            return CowConf(length_m=1.1, width_m=0.4, height_m=0.9).picture(phase)

    goat = body("test_goat", speed_mps=1.5)
    assert isinstance(goat, Goat)
    assert (goat.name, goat.kind, goat.limits().max_speed_mps) == ("test_goat", "animal", 1.5)
    assert len(pictures_of(goat)) == 12


def test_what_is_no_body_is_refused() -> None:
    with pytest.raises(RegistryError, match=r"must be a subclass of .*BodySettings"):
        dune_rl.register_body("test_nothing")(dict)

    class Cart(Quadruped):
        """It has no size."""

    with pytest.raises(RegistryError, match="has none for length_m, width_m, height_m"):
        dune_rl.register_body("test_cart")(Cart)
