"""Views of visitors of a live page: they follow the agent from where a visitor has turned them."""

from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np
import pytest

from dune_rl.rendering.web.scene import WebScene
from dune_rl.rendering.web.server import LOCALHOST, open_server, stop_server

FIRST = np.full(3, 3.0), np.zeros(3)
EYE, TARGET = np.array([5.0, 0.0, 2.0]), np.array([9.0, 0.0, 0.5])
BESIDE = np.array([0.0, 8.0, 1.0])
STEP = np.array([0.1, 0.2, 0.0])
NEARER = np.array([1.5, 0.0, -0.5])


@pytest.fixture(name="scene")
def _scene(_viser: None) -> Iterator[WebScene]:
    server = open_server(LOCALHOST, 0, "a page")
    yield WebScene(server)
    stop_server(server)


@pytest.fixture(name="camera")
def _camera(scene: WebScene, monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """The camera of a visitor who has just come."""
    camera = SimpleNamespace(position=FIRST[0], look_at=FIRST[1])
    client = SimpleNamespace(client_id=7, camera=camera)
    monkeypatch.setattr(scene._server, "get_clients", lambda: {7: client})
    scene.show_to(client, EYE, TARGET)
    return camera


def _is_free(eye: np.ndarray) -> np.ndarray:
    return eye


def test_a_view_follows_from_the_side_that_the_visitor_chose(
    scene: WebScene, camera: SimpleNamespace
) -> None:
    scene.follow(TARGET + STEP, _is_free)
    np.testing.assert_allclose([camera.position, camera.look_at], [EYE + STEP, TARGET + STEP])
    camera.position = TARGET + STEP + BESIDE
    scene.follow(TARGET, _is_free)
    np.testing.assert_allclose([camera.position, camera.look_at], [TARGET + BESIDE, TARGET])


def test_a_browser_that_reports_its_first_pose_late_does_not_turn_the_view(
    scene: WebScene, camera: SimpleNamespace
) -> None:
    # At any time: also after the target was set.
    for camera.position, camera.look_at in (FIRST, (FIRST[0], TARGET + STEP)):
        scene.follow(TARGET + STEP, _is_free)
        np.testing.assert_allclose([camera.position, camera.look_at], [EYE + STEP, TARGET + STEP])


def test_a_view_comes_nearer_while_a_wall_hides_the_agent(scene: WebScene, camera: SimpleNamespace) -> None:
    def behind_a_wall(eye: np.ndarray) -> np.ndarray:
        return eye + NEARER

    for _ in range(3):
        scene.follow(TARGET, behind_a_wall)
        np.testing.assert_allclose([camera.position, camera.look_at], [EYE + NEARER, TARGET])
    late = camera.position
    scene.follow(TARGET, _is_free)
    np.testing.assert_allclose(camera.position, EYE)
    # A browser reports the position behind the wall again: the visitor has not chosen it.
    camera.position = late
    scene.follow(TARGET + STEP, _is_free)
    np.testing.assert_allclose([camera.position, camera.look_at], [EYE + STEP, TARGET + STEP])
