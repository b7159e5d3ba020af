"""Episodes in 3D as files: a page that plays by itself, and an animated glTF."""

from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from test_gltf import tree_of, values_of
from test_live_page import Page

from dune_rl import view
from dune_rl.config.commands import ViewConf
from dune_rl.config.compose import compose
from dune_rl.reporting.views.episode import EpisodeView

Call = Callable[..., int]
WORDS = ("+world=flat", "sensors=[lidar,goal]", "policy=go_to_goal", "actors=walkers", "seed=4")


@pytest.fixture(name="call")
def _call(call: Call) -> Call:
    return lambda *words: call(view.main, *words)


def test_a_gltf_has_each_body_where_it_was(
    call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(*WORDS, "view=gltf", "longest_s=1") == 0
    assert capsys.readouterr().out.splitlines() == [
        "Recording an episode of at most 1 s.",
        "Written: views/flat_seed4_go_to_goal.glb",
    ]
    content = (folder / "views" / "flat_seed4_go_to_goal.glb").read_bytes()
    tree, _ = tree_of(content)
    numbers = {node["name"]: number for number, node in enumerate(tree["nodes"])}
    assert {"ground_and_objects", "rover_0", "walker_0", "walker_1", "goal_of_rover_0"} < numbers.keys()
    episode = EpisodeView(compose(ViewConf, [*WORDS, "longest_s=1"]))
    truth = []
    for steps, _ in enumerate(episode.run()):
        truth.append(episode.group.body.motion.position_w[0].copy())
        if steps == 20:
            break
    episode.close()
    (animation,) = tree["animations"]
    samplers = {
        (each["target"]["node"], each["target"]["path"]): animation["samplers"][each["sampler"]]
        for each in animation["channels"]
    }
    # The base link is the first part.
    moved = samplers[numbers["rover_0_0"], "translation"]
    np.testing.assert_allclose(values_of(content, moved["output"]), truth, atol=1e-5)
    np.testing.assert_allclose(values_of(content, moved["input"])[:, 0], np.arange(21) * 0.05, atol=1e-6)
    # Wheels turn.
    assert (numbers["rover_0_1"], "rotation") in samplers
    assert (numbers["goal_of_rover_0_0"], "translation") not in samplers
    scene = trimesh.load(BytesIO(content), file_type="glb")
    scene.delete_geometry(scene.graph["sky"][1])
    # The y axis is up.
    assert scene.extents[1] < 5.0 < scene.extents[0]


def test_the_sky_of_a_gltf_encloses_the_world_closely_and_is_seen_from_within(
    call: Call, folder: Path
) -> None:
    assert call(*WORDS, "view=gltf", "longest_s=0.1") == 0
    content = (folder / "views" / "flat_seed4_go_to_goal.glb").read_bytes()
    scene = trimesh.load(BytesIO(content), file_type="glb")
    pose, name = scene.graph["sky"]
    sky, middle = scene.geometry[name], pose[:3, 3]
    scene.delete_geometry(name)
    world = scene.to_geometry()
    farthest_m = np.linalg.norm(world.vertices - middle, axis=1).max()
    facets_m = np.einsum("ij,ij->i", sky.triangles_center, sky.face_normals)[sky.area_faces > 1e-6]
    # Normals point to the middle.
    assert facets_m.max() < -farthest_m
    assert np.linalg.norm(sky.vertices, axis=1).max() < 1.05 * farthest_m
    tree, _ = tree_of(content)
    (number,) = [node["mesh"] for node in tree["nodes"] if node["name"] == "sky"]
    material = tree["materials"][tree["meshes"][number]["primitives"][0]["material"]]
    assert "KHR_materials_unlit" in material["extensions"] and not material.get("doubleSided")


@pytest.mark.slow
def test_the_legs_of_people_are_shown_one_after_another(call: Call, folder: Path) -> None:
    assert call(*WORDS, "actors=pedestrians", "view=gltf", "longest_s=2") == 0
    content = (folder / "views" / "flat_seed4_go_to_goal.glb").read_bytes()
    tree, _ = tree_of(content)
    names = [node["name"] for node in tree["nodes"]]
    (animation,) = tree["animations"]
    shown = np.zeros(41)
    frames = 0
    for each in animation["channels"]:
        if each["target"]["path"] == "scale" and names[each["target"]["node"]].startswith("walker_0_0_"):
            sampler = animation["samplers"][each["sampler"]]
            times, scales = values_of(content, sampler["input"])[:, 0], values_of(content, sampler["output"])
            at = np.searchsorted(times, np.arange(41) * 0.05 + 0.01) - 1
            shown += scales[at, 0]
            frames += 1
    assert frames > 3
    np.testing.assert_array_equal(shown, 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["html", "gltf"])
def test_the_same_seed_gives_the_same_file(kind: str, _viser: None, call: Call, folder: Path) -> None:
    contents = []
    for out in ("first", "second"):
        assert call(*WORDS, f"view={kind}", "longest_s=0.5", f"out={out}") == 0
        (path,) = (folder / out).iterdir()
        contents.append(path.read_bytes())
    assert contents[0] == contents[1]


@pytest.mark.slow
def test_a_page_plays_without_a_server_or_a_network(
    _viser: None, call: Call, folder: Path, browser: Any
) -> None:
    assert call(*WORDS, "view=html", "longest_s=1") == 0
    page = Page(browser)
    asked: list[str] = []
    page.tab.on("request", lambda request: asked.append(request.url))
    page.tab.context.set_offline(True)
    path = folder / "views" / "flat_seed4_go_to_goal.html"
    page.tab.goto(path.as_uri())
    page.wait_until_drawn()
    assert not page.errors
    assert {url.partition(":")[0] for url in asked} <= {"file", "blob", "data"}
