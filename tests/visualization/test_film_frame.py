"""Frames of films: what is in the column beside the picture, and where."""

import numpy as np
import pytest

from dune_rl.sensors.lidar import LidarConf
from dune_rl.visualization.film_frame import FilmFrame, draw_map, draw_scan, fit_picture
from dune_rl.visualization.video import enlarge

LIDAR = LidarConf()
SIZE = 120, 90
MIDDLE = np.array([60.0, 45.0])
RADIUS = 0.47 * 90


def drawn_at(picture: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Mean column and row of the pixels in which two pictures differ."""
    rows, columns = np.nonzero((picture != other).any(axis=-1))
    return np.array([columns.mean(), rows.mean()])


@pytest.mark.parametrize("size", [(64, 64), (130, 70), (1920, 1080)])
@pytest.mark.parametrize("titles", [[], ["map"], ["camera", "LiDAR", "map"]])
def test_a_frame_holds_the_picture_and_all_panels(size: tuple[int, int], titles: list[str]) -> None:
    layout = FilmFrame(*size, titles)
    width, height = layout.picture_size
    panels = {
        title: np.full((*layout.panel_size(title)[::-1], 3), 50 * k + 60, np.uint8)
        for k, title in enumerate(titles)
    }
    frame = layout.compose(np.full((height, width, 3), 7, np.uint8), panels)
    assert frame.shape == (size[1], size[0], 3)
    assert (frame[:, :width] == 7).all()
    for title, panel in panels.items():
        assert (frame == panel[0, 0]).all(axis=-1).sum() >= panel[..., 0].size, title
    again = layout.compose(np.full((height, width, 3), 7, np.uint8), panels)
    np.testing.assert_array_equal(again, frame)


def _written(state: list[tuple[str, str]], headline: str = "") -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns that text changes in a frame of 640 by 360, whose picture is 448 wide."""
    layout = FilmFrame(640, 360, ["map"])
    width, height = layout.picture_size
    picture = np.full((height, width, 3), 200, np.uint8)
    panels = {"map": np.zeros((*layout.panel_size("map")[::-1], 3), np.uint8)}
    changed = layout.compose(picture, panels, state, headline) != layout.compose(picture, panels)
    assert (picture == 200).all()
    rows, columns = np.nonzero(changed.any(axis=-1))
    return rows, columns


def test_text_is_written_at_the_edges_of_the_picture_alone() -> None:
    rows, columns = _written([("speed", "1 m/s")])
    assert rows.max() < 90 and columns.min() < 56 and columns.max() < 448
    rows, columns = _written([], "stuck")
    assert abs(columns.mean() - 224) < 6 and rows.min() > 270


def test_the_state_stays_in_its_place_while_its_numbers_grow() -> None:
    short = [("time", "9.95 s"), ("collisions", "1")]
    long = [("time", "10.00 s"), ("collisions", "12")]
    for axis, other in zip(_written(short), _written(long), strict=True):
        assert (axis.min(), axis.max()) == (other.min(), other.max())


def test_a_reading_is_enlarged_without_new_colours() -> None:
    red = np.zeros((8, 16, 3), np.uint8)
    red[..., 0] = 255
    rows, columns = np.nonzero((fit_picture(red, SIZE) == [255, 0, 0]).all(axis=-1))
    assert (np.ptp(columns) + 1, np.ptp(rows) + 1) == (120, 60)
    assert rows.mean() == pytest.approx(44.5, abs=1.0)


@pytest.mark.parametrize(("segment", "right", "down"), [(0, 0, 1), (8, 1, 0), (16, 0, -1), (24, -1, 0)])
def test_returns_lie_where_they_come_from(segment: int, right: int, down: int) -> None:
    # The first segment is behind, and they run counter-clockwise: ahead is up, and left is left.
    nothing = np.full(32, 12.0)
    ranges = nothing.copy()
    ranges[segment] = 8.0
    empty, seen = (draw_scan(scan, LIDAR, None, SIZE) for scan in (nothing, ranges))
    offset = drawn_at(seen, empty) - MIDDLE
    # Half a segment aside, since two of them meet straight ahead.
    assert np.linalg.norm(offset) == pytest.approx(8.0 / 12.0 * RADIUS, abs=2.0)
    assert offset @ [right, down] > 0.9 * np.linalg.norm(offset)


def test_the_goal_lies_where_it_is() -> None:
    nothing = np.full(32, 12.0)
    for bearing, expected in ((0.0, (0.0, -RADIUS / 2)), (np.pi / 2, (-RADIUS / 2, 0.0))):
        seen = draw_scan(nothing, LIDAR, np.array([6.0, bearing]), SIZE)
        place = drawn_at(seen, draw_scan(nothing, LIDAR, None, SIZE)) - MIDDLE
        np.testing.assert_allclose(place, expected, atol=1.5)


def test_a_map_shows_the_way_and_the_others_where_they_are() -> None:
    ground = np.full((90, 120, 3), 100, np.uint8)
    way = np.array([[20.0, 20.0], [20.0, 70.0]])
    bare = draw_map(ground, way, np.zeros((0, 2)), None)
    assert (ground == 100).all()
    rows, columns = np.nonzero((bare != ground).any(axis=-1))
    assert (rows.min(), columns.mean()) == (pytest.approx(20, abs=2), pytest.approx(20, abs=1.5))
    other = draw_map(ground, way, np.array([[80.0, 30.0]]), None)
    np.testing.assert_allclose(drawn_at(other, bare), [80.0, 30.0], atol=1.0)
    goal = draw_map(ground, way, np.zeros((0, 2)), np.array([90.0, 60.0]))
    np.testing.assert_allclose(drawn_at(goal, bare), [90.0, 60.0], atol=1.0)


def test_enlarged_pictures_keep_places_and_colours() -> None:
    picture = np.zeros((36, 48, 3), np.uint8)
    picture[:18, 24:] = 200, 40, 90
    larger = enlarge(picture, 72, 54)
    assert larger.shape == (54, 72, 3)
    assert np.abs(larger[:24, 40:].astype(int) - [200, 40, 90]).max() <= 4
    assert larger[:, :32].max() <= 4 and larger[30:].max() <= 4
