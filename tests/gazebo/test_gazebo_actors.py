"""Actors exported for Gazebo: their trajectories and skins are read back as they were."""

import warnings
from pathlib import Path

import collada
import numpy as np
import pytest
from libsdformat import assert_valid
from simulations import started_simulation

from dune_rl.core.untrusted_files import ImportReport, WorldFiles, WorldWarning
from dune_rl.gazebo.episode import record_actors
from dune_rl.gazebo.mesh_folder import MeshFolder
from dune_rl.gazebo.painted_mesh import paint_scenery
from dune_rl.gazebo.scene import WORLD, write_scene
from dune_rl.gazebo.skin import write_skin
from dune_rl.rendering.light import linear_to_srgb
from dune_rl.rendering.mesh_files.files import load_mesh_parts
from dune_rl.worlds.importing.actor_files import read_actor_file

# The importer adds points of Gazebo's spline where it strays by more than this from lines between poses.
SPLINE_M = 0.02
FLAT = {"name": "flat", "size_m": 20.0}


@pytest.mark.slow
def test_trajectories_are_those_of_the_episode(tmp_path: Path) -> None:
    simulation = started_simulation(FLAT, actors="walkers", seed=2)
    recorded = record_actors(simulation, 8.0)
    simulation.close()
    simulation = started_simulation(FLAT, actors="walkers", seed=2)
    scene = write_scene(tmp_path, "site", simulation, 8.0, with_robots=False)
    simulation.close()
    assert scene.actors == len(recorded) == 2
    assert_valid(tmp_path / WORLD, tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", WorldWarning)
        actors = read_actor_file(tmp_path / WORLD)
    for read, own in zip(actors, recorded, strict=True):
        assert (read.name, read.loop, read.delay_s) == (own.name, False, 0.0)
        assert read.times[-1] == own.times[-1] == pytest.approx(8.0)
        # They do walk.
        assert np.linalg.norm(np.diff(own.poses[:, :2], axis=0), axis=1).sum() > 6.0
        for axis in range(3):
            poses = np.interp(own.times, read.times, read.poses[:, axis])
            np.testing.assert_allclose(poses, own.poses[:, axis], rtol=0, atol=2e-6)
        halfway = (own.times[1:] + own.times[:-1]) / 2
        for axis in range(2):
            between = np.interp(halfway, own.times, own.poses[:, axis])
            found = np.interp(halfway, read.times, read.poses[:, axis])
            np.testing.assert_allclose(found, between, rtol=0, atol=2 * SPLINE_M)


@pytest.mark.slow
def test_visitors_are_left_out() -> None:
    presence = {"arrive_s": [0.0, 1.0], "stay_s": [5.0, 6.0]}
    walker = {"body": "person", "controller": "path"}
    actors = {"guest": {**walker, "presence": presence}, "host": walker}
    simulation = started_simulation("flat", actors=actors)
    names = [actor.name for actor in record_actors(simulation, 1.0)]
    assert "host_0" in names and not any("guest" in name for name in names)
    simulation.close()


@pytest.mark.slow
@pytest.mark.parametrize("actors", ["walkers", "cars"])
def test_a_skin_is_the_body_on_a_bone(actors: str, tmp_path: Path) -> None:
    simulation = started_simulation("flat", actors=actors)
    group = simulation.groups[1]
    shape = group.body.pictures(0)[0].shape
    simulation.close()
    path = tmp_path / write_skin(MeshFolder(tmp_path), "skin", paint_scenery(shape))
    document = collada.Collada(str(path))
    assert not document.errors
    (skin,) = document.controllers
    assert list(skin.weight_joints) == ["bone"] and len(skin) == 3 * len(shape.faces)
    assert (skin.bind_shape_matrix == np.eye(4)).all()
    (animation,) = document.animations
    assert animation.name == "rest"
    # As a mesh without its bone, as far as the importer reads it.
    text = path.read_text()
    path.write_text(text.replace("instance_controller url=\"#skin\"", "instance_geometry url=\"#shape\"")
                    .replace("/instance_controller", "/instance_geometry")
                    .replace("<skeleton>#bone</skeleton>", ""))  # fmt: skip
    parts = load_mesh_parts(path, WorldFiles(path.parent), ImportReport("skin"))
    corners = np.concatenate([part.vertices[part.faces] for part in parts])
    colours = np.concatenate([part.colours for part in parts])
    np.testing.assert_allclose(corners, shape.vertices[shape.faces], atol=1e-6)
    np.testing.assert_allclose(colours, linear_to_srgb(shape.albedo), atol=0.003)
