"""Lenses against closed formulae, and distortion against OpenCV's as its documentation states it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from sensors_of_rover_zero import camera_conf

from dune_rl.config.compose import compose_environment
from dune_rl.core.errors import ConfigError
from dune_rl.sensors.lens import Lens, LensConf


def opencv_pinhole(points, k1=0.0, k2=0.0, p1=0.0, p2=0.0, k3=0.0):
    """OpenCV's x'' and y'' ("Camera Calibration and 3D Reconstruction") of points right, down and forward."""
    found = []
    for x_c, y_c, z_c in points:
        x, y = x_c / z_c, y_c / z_c
        r2 = x**2 + y**2
        radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        found.append(
            (
                x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2),
                y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y,
            )
        )
    return np.array(found)


def opencv_fisheye(points, k1=0.0, k2=0.0, k3=0.0, k4=0.0):
    """OpenCV's x' and y' ("Fisheye camera model")."""
    found = []
    for x_c, y_c, z_c in points:
        r = np.hypot(x_c, y_c)
        theta = np.arctan2(r, z_c)
        theta_d = theta * (1 + k1 * theta**2 + k2 * theta**4 + k3 * theta**6 + k4 * theta**8)
        found.append((theta_d / r * x_c, theta_d / r * y_c))
    return np.array(found)


def in_camera_frame(points: np.ndarray) -> np.ndarray:
    """Right, down and forward (N, 3), as OpenCV has it, to forward, left and up."""
    return np.column_stack([points[:, 2], -points[:, 0], -points[:, 1]])


def angle_between(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other))


def edge_to_edge(lens: Lens) -> float:
    """Angle between the left and the right edge of the picture at half its height [rad]."""
    middle = lens.conf.height / 2
    return angle_between(*lens.look(np.array([[0.0, middle], [lens.conf.width, middle]])))


# -- plain lenses -------------------------------------------------------------------------------------


@pytest.mark.parametrize(("width", "height"), [(4, 3), (7, 5), (1, 1), (16, 12)])
@pytest.mark.parametrize("fov_deg", [17.0, 60.0, 166.0])
def test_a_pinhole_looks_through_a_plane(width, height, fov_deg):
    directions = Lens(LensConf(width=width, height=height, fov_deg=fov_deg)).directions
    assert directions.shape == (height, width, 3)
    focal_px = width / 2 / np.tan(np.deg2rad(fov_deg) / 2)
    for row in range(height):
        for column in range(width):
            through = np.array([focal_px, width / 2 - column - 0.5, height / 2 - row - 0.5])
            np.testing.assert_allclose(directions[row, column], through / np.linalg.norm(through), atol=1e-6)


@pytest.mark.parametrize(("width", "height"), [(4, 3), (7, 5), (16, 12)])
@pytest.mark.parametrize("fov_deg", [17.0, 60.0, 180.0])
def test_a_fisheye_s_angle_from_the_axis_grows_evenly(width, height, fov_deg):
    conf = LensConf(width=width, height=height, projection="fisheye", fov_deg=fov_deg)
    directions = Lens(conf).directions
    for row in range(height):
        for column in range(width):
            away_px = np.array([width / 2 - column - 0.5, height / 2 - row - 0.5])
            far_px = np.linalg.norm(away_px)
            angle = far_px * np.deg2rad(fov_deg) / width
            expected = [np.cos(angle), *(np.sin(angle) * away_px / max(far_px, 1e-9))]
            np.testing.assert_allclose(directions[row, column], expected, atol=1e-6)


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"distortion": (-0.2, 0.05, 0.0, 0.0, 0.01)},
        {"projection": "fisheye", "fov_deg": 172.0, "distortion": (-0.02, 0.003)},
    ],
)
def test_the_picture_is_symmetric_about_its_centre(settings):
    lens = Lens(LensConf(width=10, height=6, **settings))
    directions = lens.directions
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1.0)
    np.testing.assert_allclose(directions[:, ::-1] * [1, -1, 1], directions, atol=1e-12)
    np.testing.assert_allclose(directions[::-1] * [1, 1, -1], directions, atol=1e-12)
    np.testing.assert_allclose(lens.look(np.array([5.0, 3.0])), [1.0, 0.0, 0.0], atol=1e-12)
    # The first column is the left, the first row the top.
    assert (directions[:, 0, 1] > 0).all() and (directions[0, :, 2] > 0).all()
    np.testing.assert_array_equal(Lens(LensConf(width=9, height=5, **settings)).directions[2, 4], [1, 0, 0])


@pytest.mark.parametrize("fov_deg", [17.0, 69.0, 160.0])
@pytest.mark.parametrize("size", [(8, 8), (64, 48), (20, 30)])
@pytest.mark.parametrize(
    ("projection", "distortion"),
    [
        ("pinhole", ()),
        ("pinhole", (0.02,)),
        ("pinhole", (0.02, 0.01, 0.0, 0.0, 0.003)),
        ("fisheye", ()),
        ("fisheye", (0.05, -0.001)),
        ("fisheye", (-0.02, 0.003, -0.0002, 0.00001)),
    ],
)
def test_the_field_of_view_spans_edge_to_edge_distortion_included(projection, distortion, size, fov_deg):
    conf = LensConf(
        width=size[0], height=size[1], projection=projection, fov_deg=fov_deg, distortion=distortion
    )
    assert edge_to_edge(Lens(conf)) == pytest.approx(np.deg2rad(fov_deg), abs=2e-6)


def test_the_field_of_view_spans_edge_to_edge_off_centre_lenses_included():
    assert edge_to_edge(Lens(LensConf(distortion=(0.0, 0.0, 0.0, 0.03)))) == pytest.approx(
        np.pi / 3, abs=1e-4
    )


# -- distortion ---------------------------------------------------------------------------------------


def scattered(rng: np.random.Generator, widest_rad: float, count: int = 200) -> np.ndarray:
    """Points (count, 3), right, down and forward, up to `widest_rad` from the axis."""
    angle, turn = rng.uniform(0.01, widest_rad, count), rng.uniform(-np.pi, np.pi, count)
    away = rng.uniform(0.5, 20.0, (count, 1))
    return away * np.column_stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)])


@pytest.mark.parametrize(
    "coefficients",
    [
        (),
        (-0.28,),
        (0.1, -0.03),
        (0.0, 0.0, 0.01, 0.0),
        (0.0, 0.0, 0.0, -0.02),
        (-0.2, 0.08, 0.002, -0.003, 0.01),
    ],
)
def test_a_pinhole_s_distortion_is_opencv_s(coefficients):
    lens = Lens(LensConf(width=64, height=40, fov_deg=52.0, distortion=coefficients))
    points = scattered(np.random.default_rng(0), 0.55)
    expected = opencv_pinhole(points, *coefficients) * lens.focal_px + [32.0, 20.0]
    np.testing.assert_allclose(lens.project(in_camera_frame(points)), expected, atol=1e-9)


@pytest.mark.parametrize("coefficients", [(), (-0.05,), (0.03, -0.004), (-0.02, 0.003, -0.0004, 0.00003)])
def test_a_fisheye_s_distortion_is_opencv_s(coefficients):
    lens = Lens(LensConf(width=64, height=40, projection="fisheye", fov_deg=160.0, distortion=coefficients))
    points = scattered(np.random.default_rng(1), 1.7)
    expected = opencv_fisheye(points, *coefficients) * lens.focal_px + [32.0, 20.0]
    np.testing.assert_allclose(lens.project(in_camera_frame(points)), expected, atol=1e-9)


def test_a_point_s_distance_does_not_move_it():
    for projection in ("pinhole", "fisheye"):
        lens = Lens(LensConf(projection=projection, distortion=(-0.1, 0.02)))
        along = np.array([1.0, 0.2, -0.3])
        at = lens.project(np.array([1e-3, 1.0, 1e3])[:, None] * along)
        np.testing.assert_allclose(at, np.tile(at[0], (3, 1)), atol=1e-9)
        # To the right and above: columns grow to the right, rows downward.
        assert (
            lens.project(np.array([1.0, -0.1, 0.1]))[0] > 32.0 > lens.project(np.array([1.0, -0.1, 0.1]))[1]
        )


def test_what_lies_behind_a_pinhole_appears_nowhere():
    points = np.array([[-1.0, 0.1, 0.2], [0.0, 1.0, 0.0], [1.0, 0.1, 0.2]])
    seen = Lens(LensConf()).project(points)
    assert np.isnan(seen[:2]).all()
    assert np.isfinite(seen[2]).all()
    # A fisheye looks to its sides, too.
    assert np.isfinite(Lens(LensConf(projection="fisheye")).project(points)).all()


@given(
    st.sampled_from(["pinhole", "fisheye"]),
    st.integers(1, 300),
    st.integers(1, 300),
    st.floats(3.0, 69.0),
    st.lists(st.floats(-0.02, 0.02), max_size=4),
    st.floats(0.0, 1.0),
    st.floats(0.0, 1.0),
)
def test_what_a_pixel_sees_is_shown_in_that_pixel(projection, width, height, fov_deg, distortion, x, y):
    # Of wide fields and tall pictures the upper edge would lie too far out.
    width, height = max(width, height), min(width, height)
    conf = LensConf(width=width, height=height, projection=projection, fov_deg=fov_deg, distortion=distortion)
    lens = Lens(conf)
    at = np.array([x * width, y * height])
    direction = lens.look(at)
    assert np.linalg.norm(direction) == pytest.approx(1.0)
    np.testing.assert_allclose(lens.project(7.0 * direction), at, atol=1e-3)


def test_a_strong_distortion_is_undone_all_over_the_picture():
    for conf in (
        LensConf(width=64, height=48, fov_deg=69.0, distortion=(-0.3, 0.1, 0.002, -0.001, -0.01)),
        LensConf(width=64, height=48, fov_deg=149.0, distortion=(0.05,)),
        LensConf(width=64, height=48, fov_deg=180.0, projection="fisheye", distortion=(-0.02, 0.003)),
    ):
        lens = Lens(conf)
        rows, columns = np.mgrid[0:48, 0:64] + 0.5
        at = np.stack([columns, rows], axis=-1)
        np.testing.assert_allclose(lens.project(lens.directions), at, atol=1e-3)


def test_barrel_distortion_draws_the_corners_in_and_pincushion_out():
    corner = np.array([1.0, 0.35, 0.35])
    plain, barrel, pincushion = (
        np.abs(Lens(LensConf(distortion=k)).project(corner) - 32.0).max() / focal(k)
        for k in ((), (-0.2,), (0.2,))
    )
    assert barrel < plain < pincushion


def focal(distortion: tuple[float, ...]) -> float:
    return Lens(LensConf(distortion=distortion)).focal_px


# -- what cannot be -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        (
            {"fov_deg": 172.0},
            "sensors.camera: fov_deg of a pinhole must be at most 170 (got 172); "
            "projection=fisheye reaches farther",
        ),
        (
            {"distortion": [-0.5]},
            "sensors.camera: distortion [-0.5] folds the picture over 39 degrees from its axis, "
            "which 64 by 64 pixels at fov_deg=60 reach; lessen one of them",
        ),
        (
            {"projection": "fisheye", "fov_deg": 172.0, "distortion": [-0.2]},
            "sensors.camera: distortion [-0.2] folds the picture over 74 degrees from its axis, "
            "which 64 by 64 pixels at fov_deg=172 reach; lessen one of them",
        ),
        (
            {"projection": "fisheye", "distortion": [0, 0, 0, 0, 0]},
            "sensors.camera: distortion of a fisheye has at most 4 numbers (got 5)",
        ),
        (
            {"distortion": [0, 0, 0, 0, 0, 0]},
            "sensors.camera.distortion must be a list of at most 5 (got [0, 0, 0, 0, 0, 0])",
        ),
        (
            {"width": 0, "height": -1},
            "sensors.camera.width must be at least 1 (got 0)\n"
            "sensors.camera.height must be at least 1 (got -1)",
        ),
        ({"fov_deg": 0.0}, "sensors.camera.fov_deg must be at least 0.5 (got 0.0)"),
        ({"projection": "round"}, "sensors.camera.projection must be one of pinhole, fisheye (got 'round')"),
        ({"outputs": []}, "sensors.camera.outputs must be a list of at least 1 (got [])"),
        ({"range_m": 0}, "sensors.camera.range_m must be above 0.0 (got 0)"),
    ],
)
def test_impossible_lenses_are_refused_in_words(camera, message):
    with pytest.raises(ConfigError) as refused:
        compose_environment("flat", (), {"sensors": {"enabled": ["camera"], "camera": camera}})
    assert str(refused.value) == message


def test_a_pinhole_reaches_170_degrees_and_no_farther():
    assert edge_to_edge(Lens(LensConf(fov_deg=170.0))) == pytest.approx(np.deg2rad(170.0))
    with pytest.raises(ValidationError, match="projection=fisheye reaches farther"):
        camera_conf(fov_deg=170.1)
    # Half of all there is to see.
    assert edge_to_edge(Lens(LensConf(fov_deg=180.0, projection="fisheye"))) == pytest.approx(np.pi)


def test_a_distortion_is_refused_just_where_it_folds():
    # 1 + 3 k1 r² = 0 is where the radius stops to grow; a corner is √2 farther out than an edge.
    def sound(k1: float) -> bool:
        try:
            LensConf(width=8, height=8, fov_deg=57.0, distortion=(k1,))
        except ValidationError as error:
            assert "folds the picture" in str(error)
            return False
        return True

    edge = np.tan(np.deg2rad(57.0) / 2)

    def corner_reachable(k1: float) -> bool:
        top = np.sqrt(-1.0 / (3.0 * k1))
        return bool(edge < top and np.sqrt(2.0) * edge * (1 + k1 * edge**2) < top * (1 + k1 * top**2))

    tried = -np.linspace(0.05, 1.5, 60)
    expected = [corner_reachable(k1) for k1 in tried]
    assert any(expected) and not all(expected)
    assert [sound(k1) for k1 in tried] == expected
