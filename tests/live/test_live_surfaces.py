"""Worlds as surfaces of glTF: the colours of the renderer's baked light, and textures where they were."""

import numpy as np

from dune_rl.geometry.heightfield import HeightField
from dune_rl.rendering.baked_scenery import BakedScenery
from dune_rl.rendering.light import Light, LightConf, linear_to_srgb
from dune_rl.rendering.mesh_texture import MeshTexture
from dune_rl.rendering.scenery import ColouredMesh, Scenery, Segment
from dune_rl.rendering.web.gltf import Surface
from dune_rl.rendering.web.surfaces import world_surfaces

# A square of two triangles over the ground, the picture's corners at its own.
SQUARE = np.array([[0, 0, 1], [0.5, 0, 1], [0.5, 0.5, 1], [0, 0.5, 1]], float)
FACES = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
CORNER_UV = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)


def baked(segment: Segment, texture: MeshTexture | None = None) -> BakedScenery:
    """Even ground of one colour with the square above it."""
    terrain = HeightField(np.zeros((5, 5)), 2.0, (-4.0, -4.0))
    mesh = ColouredMesh(
        SQUARE, FACES, np.full((2, 3), 0.3, np.float32), np.full(2, segment, np.uint8), texture
    )
    ground = np.tile(np.array([0.2, 0.3, 0.1], np.float32), (16, 16, 1))
    return BakedScenery(Scenery(terrain, ground, mesh), Light.from_conf(LightConf()))


def shown(surface: Surface) -> np.ndarray:
    """SRGB bytes (F, 3) of a surface's faces, as a viewer without a tone map shows them."""
    return linear_to_srgb(surface.colours * surface.gain) * 255.0


def test_faces_have_the_colours_that_the_renderer_bakes() -> None:
    scenery = baked(Segment.OBSTACLE)
    ground, plain = world_surfaces(scenery, tone_mapped=True)
    np.testing.assert_allclose(shown(plain), scenery.faces[scenery.ground_faces : -1], atol=1.0)
    mean = ground.picture.reshape(-1, 3).mean(axis=0)
    np.testing.assert_allclose(mean, scenery.ground.reshape(-1, 3).mean(axis=0), atol=3.0)
    assert not ground.lit and ground.gain == 1.0


def test_viewers_with_a_tone_map_get_light() -> None:
    scenery = baked(Segment.OBSTACLE)
    _, plain = world_surfaces(scenery)
    albedo, light = 0.3, scenery.light
    normals = np.array([[0.0, 0.0, 1.0]], np.float32)
    sun = light.shade(np.full((1, 3), albedo, np.float32), normals, np.ones(1), np.ones(1))
    np.testing.assert_allclose(plain.colours[0] * plain.gain, sun[0], rtol=0.03)


def test_pictures_lie_on_faces_as_their_texture_says() -> None:
    picture = np.zeros((4, 4, 3), np.uint8)
    texture = MeshTexture.from_uv(picture, SQUARE[FACES], CORNER_UV[FACES])
    (textured,) = [
        each for each in world_surfaces(baked(Segment.DECK, texture))[1:] if each.picture is not None
    ]
    assert textured.picture is picture
    # glTF counts from the upper left, the texture from the lower left.
    at = textured.corners[..., :2] / 0.5
    np.testing.assert_allclose(textured.uv[..., 0] % 1.0, at[..., 0] % 1.0, atol=1e-6)
    np.testing.assert_allclose(textured.uv[..., 1] % 1.0, (1.0 - at[..., 1]) % 1.0, atol=1e-6)


def test_water_is_one_surface_that_lets_light_through() -> None:
    *_, water = world_surfaces(baked(Segment.WATER))
    assert len(water.corners) == 2 and water.opacity < 1.0
    assert len(np.unique(water.colours, axis=0)) == 1
