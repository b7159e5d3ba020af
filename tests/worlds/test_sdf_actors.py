"""The <actor>s of SDF files: their trajectories, and how environments let them walk."""

import warnings

import numpy as np
import pytest
from actors_files import SQUARE, actor, line, way_point
from gazebo import GROUND, include, model, sdf

import dune_rl
from dune_rl.behaviours.trajectory import TrajectoryBank
from dune_rl.config.build import describe_world, make_simulation
from dune_rl.config.compose import compose_environment
from dune_rl.core.errors import ConfigError, WorldError
from dune_rl.core.untrusted_files import WorldWarning
from dune_rl.worlds.actor_trajectory import ActorTrajectory
from dune_rl.worlds.cache.serialization import deserialize_world, serialize_world
from dune_rl.worlds.importing.sdf.build import SdfConf, build_sdf, count_actors

pytestmark = pytest.mark.filterwarnings("ignore::dune_rl.core.untrusted_files.WorldWarning")


def write(folder, *elements: str):
    path = folder / "w.sdf"
    path.write_text(sdf(GROUND, *elements))
    return path


def read(folder, *elements: str) -> tuple[ActorTrajectory, ...]:
    return build_sdf(SdfConf(path=str(write(folder, *elements)))).trajectories


def pose_at(trajectory: ActorTrajectory, seconds: float) -> np.ndarray:
    return TrajectoryBank.of((trajectory,)).poses_at(np.array([seconds]))[0]


def simulation_of(path, scenes: int = 1, **settings):
    conf = compose_environment("sdf", [f"world.path={path}"], settings)
    return make_simulation(conf, scenes, 0)


def rest(simulation):
    return {
        group.name: np.tile(group.rest_action, (simulation.num_scenes, group.count, 1))
        for group in simulation.external
    }


def positions(simulation) -> np.ndarray:
    return simulation.group("actor").body.motion.position_w.copy()


def test_poses_are_on_gazebo_s_spline_and_turn_the_shorter_way(tmp_path):
    (walker,) = read(tmp_path, actor("walker", *SQUARE))
    assert walker.name == "walker" and walker.loop and walker.on_ground
    np.testing.assert_allclose(pose_at(walker, 0.0), [2, 2, 1, 0], atol=1e-6)
    # Tangents are 0.2 of the way from the point before to the one behind, with a tension of 0.6; the path is
    # closed. Its lines are within 2 cm of the spline.
    np.testing.assert_allclose(pose_at(walker, 1.0), [2.7, 1.8875, 1, 0], atol=0.02)
    np.testing.assert_allclose(pose_at(walker, 5.0), [6.1, 1.9, 1, np.pi / 4], atol=0.02)
    # From half a turn to three quarters of one, not back through zero.
    x, y, _, yaw = pose_at(walker, 16.0)
    np.testing.assert_allclose([x, y], [1.8, 4], atol=0.02)
    assert yaw == pytest.approx(-0.75 * np.pi, abs=1e-5)
    # It begins anew.
    np.testing.assert_allclose(pose_at(walker, 19.0), pose_at(walker, 1.0), atol=1e-6)


def test_loop_delay_and_auto_start_are_as_the_script_says(tmp_path):
    ends = way_point(0, 0, 0), way_point(2, 4, 0)
    once, late, waits = read(
        tmp_path,
        actor("once", *ends, script="<loop>false</loop>"),
        actor("late", *SQUARE, script="<delay_start>3</delay_start>"),
        actor("waits", *ends, script="<auto_start>false</auto_start>"),
    )
    np.testing.assert_allclose(pose_at(once, 1.0)[:2], [2, 0], atol=1e-9)
    np.testing.assert_allclose(pose_at(once, 50.0)[:2], [4, 0], atol=1e-9)
    np.testing.assert_allclose(pose_at(late, 2.9), pose_at(late, 0.0), atol=1e-9)
    np.testing.assert_allclose(pose_at(late, 4.0)[:2], [2.7, 1.8875], atol=0.02)
    # The delay comes before each round.
    np.testing.assert_allclose(pose_at(late, 21.0 + 4.0), pose_at(late, 4.0), atol=1e-6)
    np.testing.assert_allclose(pose_at(waits, 50.0)[:2], [0, 0], atol=1e-9)


def test_an_open_loop_is_walked_back_at_the_mean_speed(tmp_path):
    with pytest.warns(WorldWarning, match="ends 4.0 m from its start: it walks back"):
        (walker,) = read(tmp_path, actor("walker", way_point(0, 0, 0), way_point(2, 4, 0)))
    np.testing.assert_allclose([pose_at(walker, t)[0] for t in (1, 2, 3, 4, 5)], [2, 4, 2, 0, 2], atol=1e-6)


def test_trajectories_of_a_script_follow_one_another(tmp_path):
    second = '<trajectory id="1" type="walking">' + way_point(1, 4, 3) + "</trajectory>"
    (walker,) = read(
        tmp_path, actor("w", way_point(0, 0, 0), way_point(2, 4, 0), script=f"<loop>0</loop>{second}")
    )
    # The trajectory that the file has first comes first.
    assert walker.duration_s == pytest.approx(2.0)
    np.testing.assert_allclose(pose_at(walker, 50.0)[:2], [4, 0], atol=1e-9)


def test_included_actors_stand_where_the_include_says(tmp_path):
    own = tmp_path / "person"
    own.mkdir()
    (own / "model.sdf").write_text(
        f'<sdf version="1.7">{actor("p", way_point(0, 1, 0), way_point(2, 2, 0))}</sdf>'
    )
    path = write(tmp_path, include("model://person", "0 5 0 0 0 1.5707963"))
    (walker,) = build_sdf(SdfConf(path=str(path))).trajectories
    np.testing.assert_allclose(walker.poses[0], [0, 6, 1, np.pi / 2], atol=1e-6)
    assert count_actors(str(path)) == 1


@pytest.mark.parametrize(
    ("element", "message"),
    [
        (actor("a", *SQUARE), "skins and animations of <actor>s are not drawn"),
        (
            actor("a", more='<plugin name="follow" filename="f.so"/>'),
            r"moved by a plugin \(follow\), has no <tra",
        ),
        (actor("a"), "the actor 'a' has no <trajectory> and is left out"),
        (actor("a", way_point(0, 0, 0), way_point(9, 99, 0)), "walks beyond the edge of the ground"),
        (actor("a", *SQUARE, script="<auto_start>0</auto_start>"), "stands at its start"),
    ],
)
def test_what_is_different_here_is_said(tmp_path, element, message):
    with pytest.warns(WorldWarning, match=message):
        read(tmp_path, element)


def test_an_actor_that_walks_through_an_obstacle_is_named(tmp_path):
    wall = model("wall", "<box><size>0.2 4 1</size></box>", "4 2 0.5 0 0 0")
    with pytest.warns(WorldWarning, match="the actor 'through' walks through an obstacle"):
        read(tmp_path, wall, actor("through", *SQUARE))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        read(tmp_path, wall, actor("beside", way_point(0, 2, 5), way_point(9, 6, 5)))
    assert not [each for each in caught if "through an obstacle" in str(each.message)]


@pytest.mark.parametrize(
    ("element", "message"),
    [
        (actor("a", "<waypoint><time>x</time></waypoint>"), "<time> must hold a number"),
        (actor("a", way_point(-1, 0, 0)), "must be 0 to 1e.06 "),
        (actor("a", *SQUARE, script="<delay_start>-2</delay_start>"), "<delay_start> of the actor 'a'"),
        (
            actor("a", *SQUARE).replace('tension="0.6"', 'tension="2"'),
            "tension of the actor 'a' must be 0 to 1",
        ),
    ],
)
def test_a_faulty_actor_is_refused(tmp_path, element, message):
    with pytest.raises(WorldError, match=message):
        read(tmp_path, element)


def test_trajectories_are_kept_in_the_cache(tmp_path):
    world = build_sdf(SdfConf(path=str(write(tmp_path, actor("walker", *SQUARE)))))
    (again,) = deserialize_world(*serialize_world(world)).trajectories
    np.testing.assert_array_equal(again.poses, world.trajectories[0].poses)
    assert (again.name, again.loop, again.on_ground) == ("walker", True, True)


def test_an_environment_has_the_file_s_actors_unless_told_otherwise(tmp_path):
    path = write(tmp_path, actor("a", *SQUARE), actor("b", *SQUARE, script="<delay_start>2</delay_start>"))
    conf = compose_environment("sdf", [f"world.path={path}"])
    assert {name: (group.controller, group.count) for name, group in conf.actors.items()} == {
        "actor": ("trajectory", 2)
    }
    assert describe_world(conf)[-1] == (
        "Actors: 2 of the file (a, b) on their trajectories; actors=none leaves them out, actors=walkers has "
        "walkers instead"
    )
    for choice, groups in (("none", set()), ("walkers", {"walker"}), ("external_walkers", {"walker"})):
        assert set(compose_environment("sdf", [f"world.path={path}"], {"actors": choice}).actors) == groups
    assert set(compose_environment("flat").actors) == {"walker"}
    empty = write(tmp_path)
    assert set(compose_environment("sdf", [f"world.path={empty}"]).actors) == {"walker"}


@pytest.mark.slow
def test_settings_of_the_file_s_actors_count(tmp_path):
    path = write(tmp_path, actor("a", *SQUARE), actor("b", *SQUARE))

    def groups(*words):
        conf = compose_environment("sdf", [f"world.path={path}", *words])
        return {group.name: group for group in conf.groups if group.name != "rover"}

    (one,) = groups("actors.actor.count=1", "actors.actor.body.speed_mps=0.4").values()
    assert (one.count, one.body.speed_mps, one.controller) == (1, 0.4, "trajectory")
    with pytest.raises(ConfigError, match=r"take the place of walker; set actors.actor.count, or choose act"):
        groups("actors.walker.count=5")
    assert groups("actors=walkers", "actors.walker.count=5")["walker"].count == 5
    # A group of one's own that has their name is not lost.
    (own,) = groups("+actors.actor={body: person, count: 3, controller: path}").values()
    assert (own.count, own.controller) == (3, "path")


def test_trajectories_that_last_too_long_together_are_refused(tmp_path):
    long = "".join(
        f'<trajectory id="{number}">{way_point(0, 0, 0)}{way_point(9e5, 1, 0)}</trajectory>'
        for number in (1, 2)
    )
    with pytest.raises(WorldError, match="must end before 1e\\+06 s"):
        read(tmp_path, actor("slow", script=long))


def test_way_points_that_are_too_far_off_are_refused(tmp_path):
    with pytest.raises(WorldError, match="is farther off than 1e\\+06 m"):
        read(tmp_path, actor("far", way_point(0, 0, 0), way_point(3, 1e200, 0)))


@pytest.mark.slow
def test_actors_walk_on_time_on_the_ground_in_every_scene(tmp_path):
    walk = line(2, 6, 2)
    late = actor("late", *walk, script="<delay_start>1</delay_start>")
    simulation = simulation_of(write(tmp_path, actor("a", *walk), late), 2)
    try:
        simulation.reset()
        start = positions(simulation).reshape(2, 2, 3)
        np.testing.assert_allclose(start[:, :, :2], 2.0, atol=1e-9)
        for _ in range(round(2.0 / simulation.physics.control_step_s)):
            simulation.step(rest(simulation))
        now = positions(simulation).reshape(2, 2, 3)
        np.testing.assert_allclose(now[:, 0, :2], [[4, 2], [4, 2]], atol=1e-6)
        np.testing.assert_allclose(now[:, 1, :2], [[3, 2], [3, 2]], atol=1e-6)
        np.testing.assert_allclose(now[..., 2], 0.0, atol=1e-9)
        velocity = simulation.group("actor").body.motion.velocity_w
        np.testing.assert_allclose(velocity[:, :2], [[1, 0]] * 4, atol=1e-6)
        # Another episode begins where the first did.
        simulation.reset()
        np.testing.assert_allclose(positions(simulation).reshape(2, 2, 3), start, atol=1e-9)
    finally:
        simulation.close()


@pytest.mark.slow
def test_robots_start_away_from_actors(tmp_path):
    simulation = simulation_of(
        write(tmp_path, actor("a", *SQUARE)), task={"spawn": {"region": [0.0, 4.0, 0.0, 4.0]}}
    )
    try:
        for _ in range(12):
            simulation.reset()
            robot = simulation.group().body.motion.position_w[0, :2]
            # Footprints of 0.38 and 0.25 m, and half a metre between.
            assert np.hypot(*(robot - 2.0)) > 1.0
    finally:
        simulation.close()


@pytest.mark.slow
def test_an_actor_that_a_robot_holds_up_is_late_and_walks_on(tmp_path):
    walk = actor("a", *line(0, 8, 0), script="<loop>false</loop>")
    simulation = simulation_of(write(tmp_path, walk))
    try:
        simulation.reset()
        follower = simulation.group("actor").starts.follower
        simulation.step(rest(simulation))
        step_s = simulation.physics.control_step_s
        reached = np.array([[[0.25 * step_s, 0.1, 0.0, 0.0]]])
        follower.hold_back(np.array([0]), reached)
        after = follower.advance(step_s).reshape(4)
        assert after[0] == pytest.approx(1.25 * step_s, abs=1e-9)
        assert 0.0 < after[1] < 0.1
        for _ in range(20):
            after = follower.advance(step_s).reshape(4)
        np.testing.assert_allclose(after[:2], [21.25 * step_s, 0.0], atol=1e-9)
    finally:
        simulation.close()


def test_a_world_without_trajectories_is_refused_by_name():
    actors = {"actor": {"body": "person", "controller": "trajectory", "count": 2}}
    with pytest.raises(WorldError, match="actor has 2 on trajectories, and the world 'flat' has 0 actors"):
        dune_rl.parallel_env(world="flat", actors=actors)
