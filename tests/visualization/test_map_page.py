"""The page of a map, and the command that writes it."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from map_pages import COARSE, WORLDS, conf_of, site, texts
from matplotlib.figure import Figure
from PIL import Image
from sites import write_site
from world_files import CRATE, write_yard

from dune_rl import view
from dune_rl.reporting.views import maps
from dune_rl.visualization.site_map import colours
from dune_rl.visualization.site_map.figure import draw_site_map
from dune_rl.visualization.site_map.panel import Track

Call = Callable[..., int]


@pytest.fixture(name="call")
def _call(call: Call) -> Call:
    return partial(call, view.main)


def test_a_page_says_what_is_on_it() -> None:
    figure = draw_site_map(site("inspection"), "inspection", "world: seed 0", 72)
    found = texts(figure)
    for text in ("inspection", "world: seed 0", "the world", "starts and goals", "solar array", "water",
                 "bridge, drivable", "over 25°, too steep", "64 by 64 m", "8 by 8 m"):  # fmt: skip
        assert text in found
    panels = [axes for axes in figure.axes if axes.get_xlabel()]
    assert [axes.get_xlabel() for axes in panels] == ["x [m], east"] * 2
    assert panels[0].get_xlim() == (-32.0, 32.0)
    xmin, xmax, ymin, ymax = site("inspection").spawner.region
    assert panels[1].get_xlim()[0] < xmin and panels[1].get_xlim()[1] > xmax
    assert panels[1].get_ylim()[0] < ymin and panels[1].get_ylim()[1] > ymax
    for axes in panels:
        box_px = axes.get_window_extent()
        across, up = np.ptp(axes.get_xlim()), np.ptp(axes.get_ylim())
        assert box_px.width / across == pytest.approx(box_px.height / up, rel=1e-3)


@pytest.mark.slow
def test_a_region_as_large_as_the_world_needs_one_panel() -> None:
    here = maps.map_content(conf_of("+world=flat", "task.spawn.region=anywhere", "world.size_m=20"), [])
    figure = draw_site_map(here, "flat", "", 72)
    assert "starts and goals" not in texts(figure)
    assert len([axes for axes in figure.axes if axes.get_xlabel()]) == 1


@pytest.mark.slow
def test_positions_below_objects_have_their_legend() -> None:
    words = "the same, below an object"
    assert words in texts(draw_site_map(site("inspection"), "", "", 72))
    assert words not in texts(draw_site_map(site("flat"), "", "", 72))


def test_the_closer_panel_holds_all_that_was_driven() -> None:
    here = site("flat")
    far = Track("rover_0", 0, np.array([[0.0, 0.0], [20.0, 3.0]]), "stuck")
    figure = draw_site_map(replace(here, tracks=[far]), "", "", 72)
    closer = [axes for axes in figure.axes if axes.get_xlabel()][1]
    assert closer.get_xlim()[1] > 20.0
    assert "stuck: 1 of 1" in texts(figure)


@pytest.mark.slow(all_but=["island-True"])
@pytest.mark.parametrize("driven", [False, True])
@pytest.mark.parametrize("name", WORLDS)
def test_nothing_written_overlaps_or_leaves_the_page(name: str, driven: bool) -> None:
    here = site(name)
    if driven:
        track = np.stack(
            [np.linspace(*here.spawner.region[:2], 9), np.full(9, here.spawner.region[2])], axis=1
        )
        here = replace(
            here,
            tracks=[Track("rover_0", number, track, each) for number, each in enumerate(colours.ENDINGS)],
        )
    figure = draw_site_map(here, name, maps.subtitle(conf_of(f"+world={name}")), 72)
    figure.canvas.draw()
    page = next(axes for axes in figure.axes if axes.get_label() == "page")
    boxes = [(text.get_text(), text.get_window_extent()) for text in page.texts if text.get_text()]
    panels = [axes.get_window_extent() for axes in figure.axes if axes.get_xlabel()]
    for index, (text, here) in enumerate(boxes):
        assert here.x0 >= 0 and here.y0 >= 0 and here.x1 <= figure.bbox.x1 and here.y1 <= figure.bbox.y1, text
        assert not any(here.overlaps(panel) for panel in panels), text
        # A pixel is what hinting moves them by.
        for other, there in boxes[index + 1 :]:
            assert min(here.x1 - there.x0, there.x1 - here.x0) <= 1 or (
                min(here.y1 - there.y0, there.y1 - here.y0) <= 2
            ), (text, other)


# -- the command --------------------------------------------------------------------------------------


@pytest.mark.slow(all_but=["flat"])
@pytest.mark.parametrize("name", WORLDS)
def test_each_world_has_a_map_of_the_stated_size(
    name: str, call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(f"+world={name}", "view=map", COARSE) == 0
    assert capsys.readouterr().out == f"Written: views/{name}_map.png\n"
    with Image.open(folder / "views" / f"{name}_map.png") as picture:
        assert picture.format == "PNG"
        assert picture.size == (13 * 72, 8 * 72)
        assert len(picture.convert("RGB").getcolors(2**20)) > 100


def test_names_of_folders_are_no_markup(call: Call, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call("+world=flat", "view=map", COARSE, "out='maps[/b]'") == 0
    assert capsys.readouterr().out == "Written: maps[/b]/flat_map.png\n"


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["glb", "obj"])
def test_an_imported_world_has_a_map(kind: str, call: Call, folder: Path) -> None:
    file = write_yard(folder, kind)
    words = ["+world=mesh", f"world.path={file.name}", "world.region=[-4,4,-4,4]"]
    assert call(*words, "view=map", COARSE) == 0
    assert (folder / "views" / f"mesh_{file.stem}_map.png").exists()
    conf = conf_of(*words)
    assert maps.title(conf) == f"mesh: {file.name}"
    assert str(folder) not in maps.subtitle(conf)
    corners = np.concatenate([each.triangles for each in maps.map_content(conf, []).footprints]).reshape(
        -1, 2
    )
    assert (np.abs(corners - CRATE).max(axis=1) < 0.51).sum() >= 6


@pytest.mark.slow
def test_equal_settings_give_equal_bytes_and_a_seed_others(call: Call, folder: Path) -> None:
    words = ["+world=island", "view=map", COARSE, "policy=go_to_goal", "episodes=2"]
    words.append("task.terminations.time_limit.max_steps=60")
    made = []
    for more in (["out=a"], ["out=b"], ["out=c", "seed=1"]):
        assert call(*words, *more) == 0
        made.append((folder / more[0][4:] / "island_map.png").read_bytes())
    assert made[0] == made[1] != made[2]


def test_a_map_of_dwa_keeps_the_sensors_that_it_needs(call: Call, folder: Path) -> None:
    words = ["+world=flat", "view=map", COARSE, "policy=dwa", "episodes=1", "sensors=perception"]
    words += ["+sensors.command_costs={}", "task.terminations.time_limit.max_steps=20", "out=a"]
    assert call(*words) == 0
    assert (folder / "a" / "flat_map.png").stat().st_size > 10_000


@pytest.mark.slow(all_but=["words0*"])
@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["+world=flat", "episodes=0"], "episodes must be at least 1 (got 0)"),
        (["+world=flat", "dpi=9000"], "dpi must be at most 600 (got 9000)"),
        (["+world=flat", "task.spawn.region=[90,99,0,9]"],
         "task.spawn.region (90, 99, 0, 9) reaches outside the world 'flat', "
         "which covers (-50, 50, -50, 50): choose a rectangle within that."),
        (["+world=flat", "out=file"],
         "cannot write file: a file of that name is in the way; choose another place"),
        (["+world=flat", "out=file/maps"],
         "cannot write file/maps: file is a file; choose another place"),
    ],
)  # fmt: skip
def test_bad_input_is_refused_in_one_line(
    words: list[str], message: str, call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "file").write_text("kept")
    assert call("view=map", *words) == 2
    assert capsys.readouterr().err == f"{message}\n"
    assert (folder / "file").read_text() == "kept"


@pytest.mark.parametrize(("words", "named"), [([], "+world=NAME"), (["+world=inspektion"], "inspection")])
def test_a_missing_or_misspelt_world_is_told_with_the_choices(
    words: list[str], named: str, call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call("view=map", *words) == 2
    error = capsys.readouterr().err
    assert named in error and error.count("\n") == 1
    assert not list(folder.iterdir())


def test_ctrl_c_leaves_no_half_a_file(call: Call, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Figure, "savefig", interrupted)
    assert call("+world=flat", "view=map", COARSE) == 130
    assert not list(folder.iterdir())


@pytest.mark.slow
def test_the_regions_to_choose_from_are_on_the_map_with_their_numbers(tmp_path) -> None:
    content = maps.map_content(conf_of("+world=sdf", f"world.path={write_site(tmp_path, 'maze')}"), [])
    figure = draw_site_map(content, "maze", "", 72)
    panel, closer = figure.axes[1], figure.axes[2]
    numbers = {text.get_text(): text.xy for text in panel.texts if text.get_text() in "12"}
    for number, each in enumerate(content.world.region_candidates, start=1):
        assert numbers[f"{number}"] == (each.rectangle[0], each.rectangle[3])
    dashed = [patch for patch in panel.patches if patch.get_linestyle() not in ("-", "solid")]
    other = content.world.region_candidates[1].rectangle
    assert any(patch.get_xy() == (other[0], other[2]) for patch in dashed)
    assert not [text for text in closer.texts if text.get_bbox_patch() is not None]
    written = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert "others to choose: world.region=2" in written
    assert "wall" in written
