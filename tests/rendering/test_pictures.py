"""Large pictures: views, shadows, water and bodies."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plain_worlds import SIZE, box, plain

from dune_rl.geometry.frames import rotation_matrices
from dune_rl.geometry.rays import RayScene
from dune_rl.rendering.fixed_camera import FixedCamera
from dune_rl.rendering.light import LightConf, srgb_to_linear
from dune_rl.rendering.moving_mesh import PosedBodies, PosedMesh, RayMesh
from dune_rl.rendering.rasteriser import rasterise
from dune_rl.rendering.renderer import Renderer, Viewpoint
from dune_rl.rendering.scenery import ColouredMesh, Segment
from dune_rl.rendering.shading import interpolate_in_faces
from dune_rl.worlds.appearance import bake_world
from dune_rl.worlds.props import slab
from dune_rl.worlds.world import Prop


def painter(*props: Prop, **light) -> Renderer:
    return Renderer(bake_world(plain(*props), LightConf(**light)))


def block(colour=(0.8, 0.2, 0.2), size=(0.5, 0.5, 1.0)) -> RayMesh:
    """A box about its own origin."""
    vertices, faces = slab([0.0, 0.0, 0.0], np.eye(3), size)
    albedo = np.tile(srgb_to_linear(np.array(colour)), (len(faces), 1))
    return RayMesh(ColouredMesh(vertices, faces, albedo, np.full(len(faces), Segment.ROBOT, np.uint8)))


def body(x: float, y: float, z: float, **shape) -> PosedMesh:
    return PosedMesh(block(**shape), np.array([x, y, z]), np.eye(3))


def brightness_at(picture: np.ndarray, view: Viewpoint, point) -> float:
    """Of the pixels round where `point` (3,) appears."""
    height, width = picture.shape[:2]
    towards = np.subtract(point, view.eye)
    towards = towards / np.linalg.norm(towards)
    row, column = np.unravel_index(np.argmax(view.directions(width, height) @ towards), (height, width))
    assert 0 < row < height - 1 and 0 < column < width - 1, "out of the picture"
    return float(picture[row - 1 : row + 2, column - 1 : column + 2].mean())


ABOVE = Viewpoint((0.0, 0.0, 12.0), (0.0, 0.0, 0.0), 0.9)
ASLANT = Viewpoint((-5.0, -3.0, 2.5), (0.0, 0.0, 0.5))


@pytest.mark.parametrize("view", [ABOVE, ASLANT, Viewpoint((1.0, 2.0, 0.5), (4.0, -2.0, 3.0), 1.4)])
def test_a_viewpoint_looks_at_its_target_and_stands_level(view):
    directions = view.directions(9, 7)
    assert directions.shape == (7, 9, 3) and directions.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1.0, rtol=1e-6)
    ahead = np.subtract(view.target, view.eye)
    np.testing.assert_allclose(directions[3, 4], ahead / np.linalg.norm(ahead), atol=1e-6)
    # The middle row runs level from left to right; rows run downward.
    np.testing.assert_allclose(
        directions[3, :, 2], directions[3, 4, 2] * directions[3] @ directions[3, 4], atol=1e-6
    )
    assert (np.cross(directions[3, 4], directions[3, 0])[2] > 0.0) or view is ABOVE
    assert (np.diff(directions[:, 4] @ np.cross(directions[3, 8] - directions[3, 0], ahead)) < 0.0).all()
    across = np.arccos(directions[3, 0] @ directions[3, 8])
    assert np.tan(across / 2) == pytest.approx(8 / 9 * np.tan(view.fov_rad / 2), rel=1e-4)


@pytest.mark.parametrize("samples", [1, 2])
@pytest.mark.parametrize("size", [(96, 72), (33, 50), (1, 1)])
def test_a_picture_has_the_size_asked_for(size, samples):
    picture = painter(box(0.0, 0.0, 1.0, 1.0, 1.0)).render(ASLANT, *size, samples=samples)
    assert picture.shape == (size[1], size[0], 3)
    assert picture.dtype == np.uint8


def test_a_picture_of_the_same_scene_is_the_same():
    props, bodies = [box(0.0, 0.0, 1.0, 1.0, 1.0)], [body(-1.0, 1.0, 0.5)]
    one, other = painter(*props), Renderer(bake_world(plain(*props), LightConf()))
    first = one.render(ASLANT, *SIZE, bodies)
    one.render(ABOVE, *SIZE)
    assert one.render(ASLANT, *SIZE, bodies).tobytes() == first.tobytes()
    assert other.render(ASLANT, *SIZE, bodies).tobytes() == first.tobytes()
    assert len(np.unique(first.reshape(-1, 3), axis=0)) > 300


def test_a_picture_painted_in_parts_is_the_same(monkeypatch):
    one, bodies = painter(box(0.0, 0.0, 1.0, 1.0, 1.0)), [body(-1.0, 1.0, 0.5)]
    whole = one.render(ASLANT, *SIZE, bodies)
    monkeypatch.setattr("dune_rl.rendering.renderer._RAYS_AT_ONCE", 1000)
    assert one.render(ASLANT, *SIZE, bodies).tobytes() == whole.tobytes()


@pytest.mark.slow(all_but=["False-2.6"])
@pytest.mark.parametrize("bearing", [0.0, 1.2, 2.6, -2.0])
@pytest.mark.parametrize("moves", [False, True])
def test_a_shadow_falls_on_the_side_away_from_the_sun(bearing, moves):
    # A metre high, under a sun of 45 degrees, a shadow reaches a metre beyond the box.
    light = {"sun_bearing_deg": np.rad2deg(bearing), "sun_elevation_deg": 45.0}
    props = () if moves else (box(0.0, 0.0, 0.5, 0.5, 1.0),)
    bodies = [body(0.0, 0.0, 0.5)] if moves else []
    picture = painter(*props, **light).render(ABOVE, *SIZE, bodies)
    bare = painter(**light).render(ABOVE, *SIZE)
    away = -np.array([np.cos(bearing), np.sin(bearing), 0.0])

    def share(metres: float) -> float:
        """Brightness as a share of the empty ground's."""
        at = metres * away
        return brightness_at(picture, ABOVE, at) / brightness_at(bare, ABOVE, at)

    assert share(0.75) < 0.75
    for lit in (1.8, 2.5, -0.9):
        assert share(lit) == pytest.approx(1.0, abs=0.08)


def test_a_lower_sun_makes_longer_shadows_and_none_are_made_where_none_are_wanted():
    post = box(0.0, 0.0, 0.4, 0.4, 1.0)

    def at_two_metres(**light) -> float:
        picture = painter(post, sun_bearing_deg=180.0, **light).render(ABOVE, *SIZE)
        bare = painter(sun_bearing_deg=180.0, **light).render(ABOVE, *SIZE)
        return brightness_at(picture, ABOVE, [2.0, 0.0, 0.0]) / brightness_at(bare, ABOVE, [2.0, 0.0, 0.0])

    assert at_two_metres(sun_elevation_deg=17.0) < 0.85
    assert at_two_metres(sun_elevation_deg=52.0) > 0.95
    assert at_two_metres(sun_elevation_deg=17.0, shadows=False) > 0.95


def test_more_samples_agree_in_the_mean_and_smooth_the_edges():
    one = painter(box(0.0, 0.0, 1.0, 1.0, 1.0, colour=(0.9, 0.9, 0.9)))
    rough, smooth = (one.render(ASLANT, *SIZE, samples=samples).astype(float) for samples in (1, 3))
    np.testing.assert_allclose(rough.mean(axis=(0, 1)), smooth.mean(axis=(0, 1)), atol=1.0)
    assert np.abs(rough - smooth).max() > 20.0
    # The steepest step from pixel to pixel lies on the box's edges.
    assert np.abs(np.diff(smooth, axis=1)).max() < np.abs(np.diff(rough, axis=1)).max()
    fine = one.render(ASLANT, 3 * SIZE[0], 3 * SIZE[1]).astype(float)
    blocks = fine.reshape(SIZE[1], 3, SIZE[0], 3, 3).mean(axis=(1, 3))
    assert np.abs(blocks - smooth).mean() < 1.0


def test_the_shade_of_a_wall_has_no_edges():
    # Less of the sky is seen from lower parts of a wall that faces another.
    baked = painter(box(0.0, 0.0, 0.2, 4.0, 3.0), box(1.0, 0.0, 0.2, 4.0, 2.0)).baked
    corners = baked.props.vertices[baked.props.faces]
    shares = baked.props_corner_sky_share
    facing = np.isclose(corners[..., 0], 0.1).all(axis=1)
    _, place = np.unique(corners[facing].reshape(-1, 3).round(4), axis=0, return_inverse=True)
    order = np.argsort(place, kind="stable")
    meeting = np.split(shares[facing].ravel()[order], np.flatnonzero(np.diff(place[order])) + 1)
    assert max(len(each) for each in meeting) > 3
    assert max(np.ptp(each) for each in meeting) < 1e-6
    height = corners[facing][..., 2]
    assert shares[facing][height < 0.5].mean() < shares[facing][height > 2.5].mean() - 0.1

    face = int(np.flatnonzero(facing)[0])
    points = np.array([*corners[face], corners[face].mean(axis=0)], np.float32)
    shown = np.zeros(4, np.float32)
    interpolate_in_faces(points, np.arange(4), np.full(4, face), corners.astype(np.float32), shares, shown)
    np.testing.assert_allclose(shown, [*shares[face], shares[face].mean()], atol=1e-4)


def test_water_reflects_the_sky():
    low = Viewpoint((-9.0, 0.0, 0.5), (0.0, 0.0, 0.3), 0.6)
    brown = (0.25, 0.18, 0.12)
    sheets = [box(0.0, 0.0, 8.0, 8.0, 0.05, colour=brown, solid=solid) for solid in (True, False)]
    dry, wet = (painter(sheet, shadows=False).render(low, *SIZE)[44, 30:66].mean(axis=0) for sheet in sheets)
    sky = painter().render(low, *SIZE)[30].mean(axis=0)
    # Looked at aslant it is nearly all sky; from above it is hardly any.
    assert np.linalg.norm(wet - sky) < 0.7 * np.linalg.norm(dry - sky)
    assert wet[2] > wet[0] and dry[2] < dry[0]
    dry, wet = (painter(sheet, shadows=False).render(ABOVE, 9, 9)[4, 4].astype(float) for sheet in sheets)
    np.testing.assert_allclose(wet, dry, atol=25.0)


def test_a_body_is_where_it_stands_and_hides_behind_walls():
    wall = box(0.0, 0.0, 0.3, 6.0, 2.0)
    # The sun stands behind the eye, so that the shadow falls behind the wall as well.
    view, light = Viewpoint((-6.0, 0.0, 1.0), (0.0, 0.0, 1.0)), {"sun_bearing_deg": 180.0}
    one = painter(wall, **light)
    empty = one.render(view, *SIZE)
    np.testing.assert_array_equal(one.render(view, *SIZE, [body(1.5, 0.0, 0.5)]), empty)
    before = one.render(view, *SIZE, [body(-2.0, 0.0, 1.0)])
    red = before[..., 0].astype(int) - before[..., 1] > 40
    rows, columns = np.nonzero(red)
    # Its front is half a metre wide, a metre high and 3.75 m away.
    focal_px = SIZE[0] / 2 / np.tan(view.fov_rad / 2)
    assert np.ptp(columns) + 1 == pytest.approx(focal_px * 0.5 / 3.75, abs=1.1)
    assert np.ptp(rows) + 1 == pytest.approx(focal_px * 1.0 / 3.75, abs=1.1)
    assert columns.mean() == pytest.approx(SIZE[0] / 2 - 0.5, abs=0.6)
    assert rows.mean() == pytest.approx(SIZE[1] / 2 - 0.5, abs=0.6)
    # Of two, the nearer is seen, whichever comes first.
    blue = body(-3.0, 0.0, 1.0, colour=(0.1, 0.2, 0.8))
    both = [one.render(view, *SIZE, order) for order in ([blue, body(-2, 0, 1)], [body(-2, 0, 1), blue])]
    np.testing.assert_array_equal(*both)
    assert both[0][36, 48, 2] > both[0][36, 48, 0] + 40


@settings(max_examples=40)
@given(
    st.lists(st.floats(-3, 3), min_size=3, max_size=3),
    st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1),
)
def test_posed_bodies_are_met_where_their_vertices_are(position, quaternion):
    rotation = rotation_matrices(np.array(quaternion) / np.linalg.norm(quaternion))
    one = PosedMesh(BLOCK, np.array(position), rotation)
    bodies = PosedBodies([body(9.0, 9.0, 9.0), one])
    rng = np.random.default_rng(0)
    start = np.array([8.0, -7.0, 5.0], np.float32)
    directions = one.position - start + rng.normal(0.0, 0.5, (300, 3))
    directions = (directions / np.linalg.norm(directions, axis=1, keepdims=True)).astype(np.float32)
    hit = bodies.rays.hits(start[None], directions, np.full(300, 99.0, np.float32))
    met = np.flatnonzero(hit.face >= 0)
    assert len(met)
    own = hit.face[met] - len(BLOCK.shape.faces)
    corners = (one.position + one.shape.vertices @ rotation.T)[one.shape.faces[own]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    np.testing.assert_allclose(hit.normal[met], normals, atol=1e-4)
    points = start + directions[met] * hit.range[met, None]
    np.testing.assert_allclose(((points - corners[:, 0]) * normals).sum(axis=1), 0.0, atol=1e-4)
    inside = np.abs((points - one.position) @ rotation)
    assert (inside <= np.array([0.25, 0.35, 0.5]) + 1e-4).all()


BLOCK = block(size=(0.5, 0.7, 1.0))


# -- a camera that stands still -------------------------------------------------------------------------


@pytest.mark.parametrize("shadows", [True, False])
@pytest.mark.parametrize("samples", [1, 2])
@pytest.mark.parametrize("view", [ABOVE, ASLANT, Viewpoint((0.6, 0.3, 0.9), (0.0, 4.0, 0.4), 1.2)])
def test_a_fixed_camera_sees_what_a_renderer_sees(view, samples, shadows):
    one = painter(box(0.0, 0.0, 1.0, 1.0, 1.0), sun_bearing_deg=200.0, shadows=shadows)
    camera = FixedCamera(one, view, *SIZE, samples)
    np.testing.assert_array_equal(camera.render([]), one.render(view, *SIZE, samples=samples))
    scenes = [
        [body(-1.5, -1.0, 0.5)],
        # About the eye, behind it, and outside the picture.
        [body(view.eye[0], view.eye[1], view.eye[2]), body(-9.0, -5.0, 2.0), body(30.0, 20.0, 0.5)],
        [body(1.5, 2.0, 0.4, colour=(0.1, 0.2, 0.8)), body(1.2, 1.8, 1.2), body(0.0, 3.5, 0.5)],
    ]
    for bodies in scenes:
        seen = camera.render(bodies).astype(int)
        expected = one.render(view, *SIZE, bodies, samples).astype(int)
        # Edges of shadows are not smoothed, and points at a body's own edge may be either.
        differs = (np.abs(seen - expected) > 30).any(axis=-1)
        assert differs.mean() < (0.01 if samples == 1 else 0.05)
        assert np.abs(seen - expected).mean() < 1.5
    np.testing.assert_array_equal(camera.render([]), one.render(view, *SIZE, samples=samples))


def test_the_upper_and_lower_edges_of_a_body_are_smoothed():
    view, one = Viewpoint((0.0, -6.0, 3.0), (0.0, 0.0, 3.0), 0.9), painter(shadows=False)
    camera = FixedCamera(one, view, *SIZE, samples=4)
    for height in (3.02, 3.035, 3.053):
        bodies = [body(0.0, 0.0, height, colour=(0.02, 0.02, 0.02))]
        differs = camera.render(bodies).astype(int) - one.render(view, *SIZE, bodies, 4)
        assert np.abs(differs).max() < 10


@pytest.mark.parametrize("seed", range(1, 5))
def test_faces_are_seen_where_rays_meet_them(seed):
    """Also those that reach behind the camera."""
    draws = np.random.default_rng(seed)
    middles, corners = draws.uniform(-1.5, 1.5, (40, 1, 3)), draws.uniform(-1.5, 1.5, (40, 3, 3))
    vertices = (ASLANT.eye + middles + corners).reshape(-1, 3)
    faces = np.arange(120, dtype=np.int32).reshape(40, 3)
    directions = ASLANT.directions(*SIZE).reshape(-1, 3)
    ranges = np.full(len(directions), np.inf, np.float32)
    hit = RayScene(vertices, faces).hits(np.asarray([ASLANT.eye], np.float32), directions, ranges)
    depths, seen = np.full(SIZE[::-1], np.inf, np.float32), np.full(SIZE[::-1], -1, np.int32)
    normals = np.zeros((40, 3), np.float32)
    rasterise(ASLANT.place(vertices), faces, ASLANT.focal_px(SIZE[0]), depths, seen, normals)
    same = seen.ravel() == hit.face
    # A pixel at an edge may be either.
    assert same.mean() > 0.998 and len(np.unique(seen)) > 2
    behind = (vertices - ASLANT.eye) @ ASLANT.axes[:, 2] < 0.0
    shown = faces[np.unique(seen[seen >= 0])]
    assert behind[shown].any()
    met = same & (hit.face >= 0)
    depth = hit.range[met] * (directions[met] @ ASLANT.axes[:, 2])
    np.testing.assert_allclose(depths.ravel()[met], depth, rtol=1e-4)
    np.testing.assert_allclose(normals[hit.face[met]] @ ASLANT.axes.T, hit.normal[met], atol=1e-4)


def test_points_are_projected_where_they_are_seen():
    for view in (ABOVE, ASLANT):
        directions = view.directions(*SIZE)
        points = np.array(view.eye) + 3.0 * directions[[10, 50], [20, 80]]
        column, row, depth = view.project(points, *SIZE)
        np.testing.assert_allclose(column, [20.5, 80.5], atol=1e-2)
        np.testing.assert_allclose(row, [10.5, 50.5], atol=1e-2)
        assert (depth > 0.0).all()
        assert view.project(2.0 * np.array(view.eye) - points, *SIZE)[2].max() < 0.0
