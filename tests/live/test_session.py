"""Episodes on a live page, without a browser: what is sent to it, its drivers, resets and driving by hand."""

import dataclasses
import socket
from collections.abc import Callable, Iterator
from contextlib import suppress

import numpy as np
import pytest

from dune_rl.config.commands import ViewConf
from dune_rl.core.errors import ConfigError
from dune_rl.rendering.light import Light, LightConf
from dune_rl.rendering.web.server import FIRST_PORT, LAST_PORT, LOCALHOST, check_address
from dune_rl.reporting.views.episode import EpisodeView
from dune_rl.reporting.views.live import BY_HAND, LiveSession

ConfOf = Callable[..., ViewConf]
Open = Callable[..., LiveSession]


@pytest.fixture(name="open_session")
def _open_session(conf_of: ConfOf) -> Iterator[Open]:
    opened = []

    def make(*words: str) -> LiveSession:
        view = EpisodeView(conf_of(*words))
        session = LiveSession(view)
        opened.append((session, view))
        session.begin()
        return session

    yield make
    for session, view in opened:
        session.close()
        view.close()


def positions(session: LiveSession, steps: int) -> np.ndarray:
    """Where the agent is after each of some steps, (steps, 3)."""
    found = []
    for _ in range(steps):
        session.step()
        found.append(session.view.group.body.motion.position_w[0].copy())
    return np.array(found)


def test_nodes_of_bodies_are_where_the_bodies_are(open_session: Open) -> None:
    session = open_session("actors=pedestrians")
    positions(session, 8)
    pictures = session.page.scene_view.pictures.bodies_by_name(0)
    nodes = session.page.server.scene
    assert {"rover_0", "goal_of_rover_0"} < pictures.keys() and len(pictures["rover_0"]) == 5
    for name, parts in pictures.items():
        for number, part in enumerate(parts):
            node = nodes.get_handle_by_name(f"/bodies/{name}/{number}")
            assert node.visible
            np.testing.assert_allclose(node.position, part.position, atol=1e-6)
            w, x, y, z = node.wxyz
            np.testing.assert_allclose(
                part.rotation[:, 0],
                [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)],
                atol=1e-6,
            )


def test_a_step_sends_poses_and_no_meshes(open_session: Open) -> None:
    session = open_session()
    positions(session, 3)
    record = session.page.server.get_scene_serializer()
    before = len(record._messages)
    positions(session, 5)
    sent = {message["type"] for _, message in record._messages[before:]}
    assert "SetPositionMessage" in sent and "SetOrientationMessage" in sent
    assert not {each for each in sent if "Glb" in each or "Create" in each or "Remove" in each}


def test_a_seed_begins_the_same_episode_again(open_session: Open) -> None:
    seed = 3_000_000_000
    session = open_session("policy=random", f"seed={seed}")
    first = positions(session, 10)
    session.reset()
    np.testing.assert_array_equal(positions(session, 10), first)
    session.begin_next()
    assert not np.array_equal(positions(session, 10), first)
    session.seed_input.value = 4
    session.reset()
    other = positions(session, 10)
    session.seed_input.value = seed
    session.reset()
    np.testing.assert_array_equal(positions(session, 10), first)
    assert not np.array_equal(other, first)


@pytest.mark.slow
def test_a_driver_that_cannot_drive_here_leaves_the_last_one(open_session: Open) -> None:
    session = open_session("policy=go_to_goal", "robot=hyperdog")
    session.choose("dwa")
    assert session.driver == "go_to_goal" == session.drivers.value


@pytest.mark.slow
def test_keys_drive_the_agent_and_take_over(open_session: Open) -> None:
    session = open_session("policy=go_to_goal")
    positions(session, 3)
    for _ in range(8):
        session.nudge(0, 1)
    assert session.driver == BY_HAND == session.drivers.value
    positions(session, 30)
    motion = session.view.group.body.motion
    assert motion.velocity_b[0, 0] > 0.6
    session.stop()
    positions(session, 30)
    assert abs(session.view.group.body.motion.velocity_b[0, 0]) < 0.1
    session.choose("go_to_goal")
    assert session.driver == "go_to_goal"


def test_a_port_that_is_taken_is_named_with_what_to_do(conf_of: ConfOf) -> None:
    conf = conf_of()
    with socket.socket() as other:
        other.bind((conf.host, conf.port))
        other.listen()
        view = EpisodeView(conf)
        with pytest.raises(ConfigError) as refused:
            LiveSession(view)
        view.close()
    assert str(refused.value) == (
        f"port={conf.port} of 127.0.0.1 is taken: give another, such as port={conf.port + 1}, or end what "
        "listens there"
    )


def test_no_port_beyond_the_last_one_is_advised() -> None:
    with socket.socket() as other:
        # One that is taken by somebody else serves as well.
        with suppress(OSError):
            other.bind((LOCALHOST, LAST_PORT))
            other.listen()
        with pytest.raises(ConfigError, match=f"such as port={FIRST_PORT}"):
            check_address(LOCALHOST, LAST_PORT)


def test_an_address_of_ipv6_is_in_brackets(open_session: Open) -> None:
    try:
        check_address("::1", FIRST_PORT)
    except ConfigError:
        pytest.skip("this machine has no IPv6, or the port is taken")
    session = open_session("host=::1")
    assert session.url == f"http://[::1]:{session.page.server.get_port()}"


@pytest.mark.parametrize("host", ["192.0.2.1", "no.such.host.invalid"])
def test_an_address_of_another_machine_is_refused(host: str, conf_of: ConfOf) -> None:
    view = EpisodeView(conf_of(f"host={host}"))
    with pytest.raises(ConfigError, match=f"host={host} is no address of this machine"):
        LiveSession(view)
    view.close()


def test_an_arrow_is_over_the_goal_also_when_it_is_renewed(open_session: Open) -> None:
    session = open_session("task.terminations.goal_reached.renew=true", "policy=go_to_goal")
    goals, arrows = [], []
    while len(np.unique(goals, axis=0)) < 2 and len(goals) < 400:
        session.step()
        goals.append(session.view.group.starts.goals_w[0].copy())
        arrows.append(session.page.server.scene.get_handle_by_name("/bodies/arrow/0").position[:2].copy())
    assert len(np.unique(goals, axis=0)) == 2
    np.testing.assert_allclose(arrows, goals, atol=1e-6)


def test_grass_is_on_the_page_where_the_world_has_it(open_session: Open) -> None:
    session = open_session("world.grass_cover=0.05")
    scene = session.page.server.scene
    tufts = scene.get_handle_by_name("/world/grass_in_sun").batched_positions
    world = session.view.simulation.worlds.worlds[0]
    assert len(tufts) > 100 and (world.grass.foliage.density_at(tufts) > 0.0).all()
    # Another world, without grass, takes its place.
    bare = dataclasses.replace(session.page.scene_view.pictures.scenery(0)[1], foliage=None)
    baked = session.page.scene_view.pictures.scenery(0)[0].relight(Light.from_conf(LightConf()))
    session.page._web.show_world(baked, bare)
    assert scene.get_handle_by_name("/world/grass_in_sun") is None


def test_the_goal_is_beyond_the_agent_in_the_first_view(open_session: Open) -> None:
    session = open_session()
    camera = session.page.server.initial_camera
    group = session.view.group
    to_goal = group.starts.goals_w[0] - group.body.motion.position_w[0, :2]
    seen = (camera.look_at - camera.position)[:2]
    np.testing.assert_allclose(seen / np.linalg.norm(seen), to_goal / np.linalg.norm(to_goal), atol=1e-6)


def test_the_metric_that_was_chosen_is_plotted_over_the_episode(open_session: Open) -> None:
    session = open_session("policy=go_to_goal", "seed=4")
    session.page.playback.is_paused = True
    panel = session.page.panel
    positions(session, 4)
    assert panel._plotted.value == "clearance" and "steps" in panel._plotted.options
    panel._plotted.value = "steps"
    positions(session, 2)
    times_s, steps = panel._metric_plot.data
    np.testing.assert_allclose(steps, np.arange(7), atol=1e-6)
    np.testing.assert_allclose(times_s, 0.05 * np.arange(7), atol=1e-6)
    # Of an episode that begins nothing is left of the one before.
    session.begin()
    assert len(panel._metric_plot.data[0]) == 1
