"""Contact sheets of any readings."""

from collections.abc import Iterator

import numpy as np
import pytest
from simulations import act, observation, started_simulation

from dune_rl.sensors.conf import parse_sensors
from dune_rl.sensors.settings import SensorSettings
from dune_rl.visualization.contact_sheet import contact_sheet

PICTURE = np.zeros((6, 8, 3), np.uint8)
# The first words of each panel's title.
TITLES = {
    "camera_rgb": "camera, RGB",
    "camera_depth": "camera, depth",
    "camera_segmentation": "camera, segments",
    "camera_normals": "camera, normals",
    "camera_grey": "camera, grey",
    "lidar_3d_range": "3D LiDAR, 16 rings",
    "lidar_3d_intensity": "3D LiDAR, intensity",
    "lidar_3d_segmentation": "3D LiDAR, segments",
    "height_scan": "height scan",
    "depth_strip": "depth strip",
    "lidar": "LiDAR, ahead is up",
}


def panels(readings: dict[str, np.ndarray], conf: dict[str, SensorSettings]) -> list[str]:
    """Titles of a sheet's panels, the sheet being drawn."""
    figure = contact_sheet(readings, conf, PICTURE, "a title")
    figure.canvas.draw()
    assert figure.get_suptitle() == "a title"
    return [title for axes in figure.axes if (title := axes.get_title(loc="left"))]


@pytest.fixture(scope="module")
def everything() -> Iterator[tuple[dict[str, np.ndarray], dict[str, SensorSettings]]]:
    simulation = started_simulation("flat", sensors="all")
    act(simulation, [0.0, 0.0])
    suite = simulation.group().suite
    assert suite is not None
    yield {name: value[0] for name, value in observation(simulation).items()}, suite.settings
    simulation.close()


def test_a_sheet_has_a_panel_for_each_reading(everything) -> None:
    readings, conf = everything
    found = panels(readings, conf)
    assert found[0] == "scene"
    for name, title in TITLES.items():
        assert name in readings
        assert sum(each.startswith(title) for each in found) == 1
    assert "numbers" in found
    assert len(found) == len(TITLES) + 2
    figure = contact_sheet(readings, conf, PICTURE, "")
    text = " ".join(text.get_text() for axes in figure.axes for text in axes.texts)
    for name in set(readings) - set(TITLES) - {"lidar_past"}:
        assert name in text


@pytest.mark.parametrize("name", [*TITLES, "lidar_past", "imu"])
def test_any_reading_alone_makes_a_sheet(name: str, everything) -> None:
    readings, conf = everything
    found = panels({name: readings[name]}, conf)
    assert len(found) == 2
    assert found[0] == "scene"
    assert found[1].startswith(TITLES.get(name, "numbers" if name == "imu" else "LiDAR"))


def test_what_a_robot_makes_of_its_readings_is_drawn() -> None:
    """Nothing of several values is among the numbers; pasts, tracks and low obstacles are over the scan."""
    names = ("lidar", "agent_tracks", "ground_profile", "command_costs", "goal_direction")
    made = {name: {} for name in names}
    of_others = {
        "past": {"sensor": "lidar_past"},
        "way_left": {"low_obstacles": "low_obstacles"},
        "low_obstacles": {},
        "imu_6axis": {},
    }
    simulation = started_simulation("inspection", sensors=made | of_others)
    act(simulation, [0.0, 0.0])
    suite = simulation.group().suite
    assert suite is not None
    readings = {name: value[0] for name, value in observation(simulation).items()}
    conf = suite.settings
    simulation.close()
    found = panels(readings, conf)
    assert [title.partition(",")[0] for title in found] == [
        *("scene", "ground_profile", "command_costs", "way_left", "LiDAR"),
        *("agent_tracks_radial", "agent_tracks_tangential", "numbers"),
    ]
    figure = contact_sheet(readings, conf, PICTURE, "")
    figure.canvas.draw()
    frame = figure.axes[0].figure.bbox
    for axes in figure.axes:
        box = axes.get_window_extent()
        assert frame.x0 <= box.x0 < box.x1 <= frame.x1
        assert frame.y0 <= box.y0 < box.y1 <= frame.y1
    legend = next(axes for axes in figure.axes if axes.get_title(loc="left").startswith("LiDAR")).get_legend()
    assert legend is not None
    assert {"now", "past"} <= {text.get_text() for text in legend.get_texts()}


def test_what_is_far_is_on_the_sheet_of_what_is_near() -> None:
    conf = parse_sensors(["lidar", "agent_tracks", "goal"])
    near, track = np.full(32, 12.0, np.float32), np.zeros(18, np.float32)
    near[0] = 2.0
    track[:6] = 0.0, 1.0, 0.5, 0.0, 1.0 / 6.0, 0.25
    cases: list[tuple[dict[str, np.ndarray], float]] = [
        ({"lidar": near, "goal": np.array([8.0, 0.3])}, 8.0),
        ({"lidar": near, "agent_tracks": track}, 6.0),
        ({"agent_tracks": track}, 6.0),
        ({"lidar": near}, 2.0),
        ({"lidar": np.full_like(near, 12.0)}, 12.0),
        ({"agent_tracks": np.zeros_like(track)}, 12.0),
    ]
    for readings, farthest in cases:
        figure = contact_sheet(readings, conf, PICTURE, "")
        figure.canvas.draw()
        limit = figure.axes[1].get_ylim()[1]
        assert farthest <= limit <= 1.2 * farthest + 1e-6
        drawn = [float(line.get_ydata()[-1]) for line in figure.axes[1].lines if line.get_label() == "goal"]
        assert drawn == ([8.0] if "goal" in readings else [])


def test_what_meets_nothing_makes_a_sheet_too() -> None:
    conf = parse_sensors(["lidar", "lidar_3d", "depth_strip", "camera"])
    nothing = {
        "lidar": np.full(32, 12.0, np.float32),
        "lidar_3d_range": np.full((16, 32, 1), 30.0, np.float32),
        "lidar_3d_intensity": np.zeros((16, 32, 1), np.float32),
        "depth_strip": np.full(32, 5.0, np.float32),
        "camera_segmentation": np.zeros((8, 8, 1), np.uint8),
    }
    assert len(panels(nothing, conf)) == 6


def test_a_camera_that_sees_only_sky_makes_a_sheet_too() -> None:
    assert (
        len(panels({"camera_depth": np.full((8, 8, 1), 100.0, np.float32)}, parse_sensors(["camera"]))) == 2
    )


def test_a_strip_of_one_column_makes_a_sheet_too() -> None:
    conf = parse_sensors({"depth_strip": {"columns": 1}})
    assert len(panels({"depth_strip": np.full(1, 2.0, np.float32)}, conf)) == 2
