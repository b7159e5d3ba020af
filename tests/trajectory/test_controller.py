"""Files of trajectories as the controller of a group."""

import numpy as np
import pytest
from gazebo import GROUND, sdf

import dune_rl
from dune_rl.config.build import make_simulation
from dune_rl.config.compose import compose_environment
from dune_rl.core.errors import ConfigError, WorldError
from dune_rl.core.untrusted_files import WorldWarning
from dune_rl.trajectories.files import Appearance, write_trajectory
from dune_rl.trajectories.plan import plan_on_ground
from dune_rl.worlds.importing.actor_files import read_actor_file
from dune_rl.worlds.importing.sdf.build import SdfConf, build_sdf


def write(path, points, world="flat", **settings):
    actor = dune_rl.plan_trajectory(points, world, **settings)
    write_trajectory(path, actor, Appearance())
    return actor


def follow(files, *words: str, world="flat", scenes=1):
    listed = "[" + ",".join(map(str, files)) + "]"
    conf = compose_environment(
        world,
        [f"actors.walker.controller={{trajectory: {listed}}}", f"actors.walker.count={len(files)}", *words],
    )
    return make_simulation(conf, scenes, 0)


def test_actors_follow_their_files_on_time(tmp_path):
    first = write(tmp_path / "a.sdf", [[-3, -2], [2, 1]], velocity=1.5)
    second = write(tmp_path / "b.json", [[4, 4], [4, 0], [0, 4]], mode="loop", delay_s=0.5)
    simulation = follow([tmp_path / "a.sdf", tmp_path / "b.json"], scenes=2)
    try:
        for _ in range(2):
            simulation.reset()
            rest = {
                group.name: np.tile(group.rest_action, (simulation.num_scenes, group.count, 1))
                for group in simulation.external
            }
            for _ in range(30):
                simulation.step(rest)
            passed = 30 * simulation.physics.control_step_s
            found = simulation.group("walker").body.motion.position_w.reshape(2, 2, 3)
            for agent, (actor, clock) in enumerate(((first, passed), (second, passed - 0.5))):
                expected = [np.interp(clock, actor.times, actor.poses[:, axis]) for axis in (0, 1)]
                np.testing.assert_allclose(found[:, agent, :2], [expected] * 2, atol=1e-5)
            np.testing.assert_allclose(found[..., 2], 0.0, atol=1e-9)
    finally:
        simulation.close()


def test_what_does_not_fit_is_refused_by_name(tmp_path):
    write(tmp_path / "a.csv", [[-3, -2], [2, 1]])
    with pytest.raises(
        WorldError, match="walker has 2 agents, and its files of trajectories have 1 actors: set its"
    ):
        follow([tmp_path / "a.csv"], "actors.walker.count=2")
    far = plan_on_ground(_wide(), np.array([[0.0, 0.0], [500.0, 0.0]]), spacing_m=1)
    write_trajectory(tmp_path / "far.csv", far, Appearance())
    with pytest.raises(WorldError, match=r"the trajectory of 'walker' leaves the world 'flat' at \("):
        follow([tmp_path / "far.csv"])
    with pytest.raises(WorldError, match="there is no file"):
        follow([tmp_path / "gone.sdf"])
    with pytest.raises(ConfigError, match="paths are walked by persons, and the body is leo_rover"):
        compose_environment("flat", ["+agents={r: {body: leo_rover, controller: {trajectory: a.csv}}}"])
    with pytest.raises(ConfigError, match="trajectory"):
        compose_environment("flat", ["actors.walker.controller={trajectory: []}"])


def _wide():
    from dune_rl.geometry.heightfield import HeightField
    from dune_rl.worlds.world import World

    return World("wide", HeightField(np.zeros((2, 2)), 2000.0, (-1000.0, -1000.0)), region=(-1, 1, -1, 1))


def test_a_way_through_an_obstacle_is_a_warning(tmp_path):
    write(tmp_path / "a.csv", [[-1, 0], [5, 0]])
    wall = '<model name="w"><static>true</static><pose>2 0 1 0 0 0</pose><link name="l"><collision name="c">'
    wall += "<geometry><box><size>0.4 3 2</size></box></geometry></collision></link></model>"
    (tmp_path / "w.sdf").write_text(sdf(GROUND, wall))
    conf = compose_environment(
        "sdf",
        [
            f"world.path={tmp_path / 'w.sdf'}",
            f"actors.walker.controller={{trajectory: {tmp_path / 'a.csv'}}}",
            "actors.walker.count=1",
        ],
    )
    with pytest.warns(WorldWarning, match=r"'walker' leads through an obstacle of sdf at \(1.\d\d, 0.00\)"):
        make_simulation(conf, 1, 0).close()


@pytest.mark.filterwarnings("ignore::dune_rl.core.untrusted_files.WorldWarning")
def test_a_written_actor_in_a_world_s_file_walks_as_planned(tmp_path):
    actor = write(tmp_path / "a.sdf", [[-1, 0], [3, 1], [4, 4]], pauses_s=1.0)
    text = (tmp_path / "a.sdf").read_text()
    element = text[text.index("<actor") : text.index("</sdf>")]
    (tmp_path / "w.sdf").write_text(sdf(GROUND, element))
    (brought,) = build_sdf(SdfConf(path=str(tmp_path / "w.sdf"))).trajectories
    (alone,) = read_actor_file(tmp_path / "a.sdf")
    np.testing.assert_array_equal(brought.poses, alone.poses)
    np.testing.assert_allclose(brought.times, actor.times, atol=1e-6)
    np.testing.assert_allclose(brought.poses[:, :2], actor.poses[:, :2], atol=1e-6)
    assert brought.on_ground
