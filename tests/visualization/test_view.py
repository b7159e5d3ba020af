"""The view command: the sheets, films and pictures that it makes, and what it refuses."""

import signal
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import av
import numpy as np
import pytest
import trimesh
import yaml
from PIL import Image
from rich.console import Console
from training import make_sac

from dune_rl import view
from dune_rl.config.build import make_torchrl_env
from dune_rl.config.commands import ViewConf
from dune_rl.config.compose import compose, compose_environment
from dune_rl.config.schema import Conf
from dune_rl.core.errors import ConfigError
from dune_rl.core.files import write_atomically
from dune_rl.evaluation.episode_sets.apply import (
    compose_on_set,
    plan_of_set,
    settings_of_episode,
)
from dune_rl.learning.checkpoint import write_checkpoint_file
from dune_rl.learning.policy_spec import PolicySpec
from dune_rl.learning.saved_policies import policy_entry
from dune_rl.reporting.views import film
from dune_rl.reporting.views.maps import drive_episodes, map_content
from dune_rl.visualization.video import open_video

TINY = ["+world=flat", "width=128", "height=96", "samples=1", "longest_s=1", "after_s=0.2", "actors=none"]
# Few sensors, for films that are not about them.
BLIND = "sensors=[lidar,goal]"
Call = Callable[..., int]


@pytest.fixture(name="call")
def _call(call: Call) -> Call:
    return partial(call, view.main)


def frames_of(path: Path) -> tuple[np.ndarray, float]:
    """All frames (T, height, width, 3) of a film, and its length [s]."""
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
        return np.array(frames), float(stream.duration * stream.time_base)


# -- the command --------------------------------------------------------------------------------------


def test_a_sheet_and_a_film_are_made(call: Call, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(*TINY, "out=new/views") == 0
    made = folder / "new" / "views"
    assert sorted(path.name for path in made.iterdir()) == ["flat_seed0_go_to_goal.mp4", "flat_sheet.png"]
    assert capsys.readouterr().out.splitlines() == [
        "Drawing all readings, 0.2 s into the episode.",
        "Written: new/views/flat_sheet.png",
        "Written: new/views/flat_seed0_go_to_goal.mp4",
    ]
    with Image.open(made / "flat_sheet.png") as sheet:
        assert sheet.format == "PNG"
        assert sheet.width == 1760 and sheet.height > 1000
        assert len(sheet.convert("RGB").getcolors(2**22)) > 1000
    frames, length_s = frames_of(made / "flat_seed0_go_to_goal.mp4")
    # A second at ten frames a second, both ends included, and the last picture for another 1.5 s.
    assert frames.shape == (26, 96, 128, 3)
    assert length_s == pytest.approx(2.6)
    assert np.abs(frames[0].astype(int) - frames[10]).max() > 30
    assert np.abs(frames[11:].astype(int) - frames[10]).mean() < 3.0


@pytest.mark.slow
def test_a_robot_on_legs_is_seen_with_all_sensors_but_odometry(
    call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(*TINY, "robot=hyperdog", "view=sheet") == 0
    assert (folder / "views" / "flat_sheet.png").is_file()
    assert call(*TINY, "robot=hyperdog", "view=sheet", "sensors=[odometry]") == 2
    assert "odometry is of wheels, and this robot has none" in capsys.readouterr().err


@pytest.mark.slow
def test_a_film_ends_with_its_episode(call: Call, folder: Path) -> None:
    words = [
        "view=video",
        BLIND,
        "longest_s=9",
        "seed=4",
        "frames_per_s=4",
        "task.terminations.time_limit.max_steps=12",
    ]
    assert call(*TINY, *words) == 0
    frames, length_s = frames_of(folder / "views" / "flat_seed4_go_to_goal.mp4")
    # At steps 0, 5, 10 and 12, and 1.5 s of the last.
    assert len(frames) == 4 + 6
    assert length_s == pytest.approx(10 / 4)


@pytest.mark.slow
@pytest.mark.parametrize("size", [(64, 64), (130, 70)])
def test_a_film_has_the_size_asked_for(size: tuple[int, int], call: Call, folder: Path) -> None:
    words = ["view=video", BLIND, f"width={size[0]}", f"height={size[1]}", "longest_s=0.1"]
    assert call(*TINY, *words) == 0
    assert frames_of(folder / "views" / "flat_seed0_go_to_goal.mp4")[0].shape[1:] == (size[1], size[0], 3)


@pytest.mark.slow
def test_the_place_is_pictured_from_above(call: Call, folder: Path) -> None:
    assert call(*TINY, "view=orbit", BLIND) == 0
    assert [path.name for path in (folder / "views").iterdir()] == ["flat_orbit.png"]
    with Image.open(folder / "views" / "flat_orbit.png") as picture:
        assert picture.size == (128, 96)
        assert len(picture.getcolors(2**20)) > 100


def film_of(call: Call, kind: str, policy: str) -> np.ndarray:
    assert call(*TINY, BLIND, "longest_s=0.5", f"view={kind}", f"policy={policy}") == 0
    return frames_of(Path("views") / f"flat_seed0_{policy}.mp4")[0]


@pytest.mark.slow
def test_films_of_one_seed_are_the_same_and_drivers_differ(call: Call, folder: Path) -> None:
    driven = film_of(call, "video", "go_to_goal")
    assert (film_of(call, "video", "random") != driven).any()
    assert {path.name for path in Path("views").iterdir()} == {
        "flat_seed0_go_to_goal.mp4",
        "flat_seed0_random.mp4",
    }
    np.testing.assert_array_equal(film_of(call, "video", "go_to_goal"), driven)


@pytest.mark.slow
def test_an_episode_of_a_set_is_shown_by_its_number(call: Call, folder: Path) -> None:
    words = ["policy=go_to_goal", "set=construction-v1", "episode=6"]
    assert call(*words, "view=map", "dpi=72") == 0
    assert [path.name for path in (folder / "views").iterdir()] == ["construction-v1_6_map.png"]
    conf, episode_set = compose_on_set(ViewConf, words, (), None)
    assert episode_set is not None
    conf, plan = settings_of_episode(conf, episode_set, 6), plan_of_set(conf, episode_set)
    row = episode_set.episodes[6]
    assert conf.world.seed == row.world_seed != episode_set.episodes[0].world_seed
    tracks = drive_episodes(conf, Console(), plan)
    (robot,) = (track for track in tracks if track.ending is not None)
    assert robot.episode == 6
    assert robot.points[0] == pytest.approx(row.start[:2], abs=0.02)
    (placed,) = map_content(conf, tracks, plan).episodes[6]
    assert (placed.x, placed.y, placed.goal_x, placed.goal_y) == (*row.start[:2], *row.goal)


@pytest.mark.slow
def test_a_sheet_before_it_does_not_change_a_film(call: Call, folder: Path) -> None:
    alone = film_of(call, "video", "random")
    np.testing.assert_array_equal(film_of(call, "both", "random"), alone)


@pytest.mark.slow
def test_the_agent_that_is_followed_is_chosen_by_name(call: Call, folder: Path) -> None:
    words = [word for word in TINY if word != "actors=none"]
    pictures = []
    for agent in ("rover_0", "rover_1", "walker_0"):
        more = ["robots=[rover_zero,rover_zero]", BLIND, "view=video", "longest_s=0.1", f"agent={agent}"]
        assert call(*words, *more, f"out={agent}") == 0
        pictures.append(frames_of(folder / agent / "flat_seed0_go_to_goal.mp4")[0][0])
    for first, second in ((0, 1), (0, 2), (1, 2)):
        assert np.abs(pictures[first].astype(int) - pictures[second]).mean() > 1.0


def test_the_episode_s_seed_is_not_the_training_s() -> None:
    saved = compose(Conf, ["+world=flat", "seed=7"]).model_dump(mode="json")
    assert compose(ViewConf, ["checkpoint=policy.pt"], (), saved).seed == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["width=127"], "width must be a multiple of 2 (got 127)"),
        (["height=32"], "height must be at least 64 (got 32)"),
        (["view=film"], "view must be one of sheet, video, both, orbit, map, live, html, gltf (got 'film')"),
        (["view=live", "port=0"], "port must be at least 1 (got 0)"),
        (["frames_per_s=0"], "frames_per_s must be above 0.0 (got 0)"),
        (["agent=rover_7"], "agent: there is no agent 'rover_7'; did you mean rover_0?"),
        (["agent=rover_7", "view=map"], "agent: there is no agent 'rover_7'; did you mean rover_0?"),
        (["set=flat-v1", "episode=200", "view=map"], "set=flat-v1 has the episodes 0 to 199"),
        (["set=flat-v1", "actors=none"], "set=flat-v1 determines actors; leave actors=none out"),
        (["-m", "seed=1,2"], "this command runs once; leave -m out"),
        (["out=file"], "cannot write file: a file of that name is in the way; choose another place"),
        (["out=file/views"], "cannot write file/views: file is a file; choose another place"),
        (["out=link/a"], "cannot write link/a: link is a link that leads nowhere; choose another place"),
    ],
)  # fmt: skip
def test_bad_input_is_refused_in_one_line(
    words: list[str], message: str, call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "file").write_text("kept")
    (folder / "link").symlink_to("nowhere")
    world = [] if words[0].startswith("set=") else ["+world=flat"]
    assert call(*world, *words) == 2
    assert capsys.readouterr().err == f"{message}\n"
    assert sorted(path.name for path in folder.iterdir()) == ["file", "link"]
    assert (folder / "file").read_text() == "kept"


def test_a_film_that_is_cut_off_leaves_no_folder(
    call: Call, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(*_: object) -> None:
        assert (folder / "new" / "views").is_dir()
        raise KeyboardInterrupt

    monkeypatch.setattr(film, "_drive", interrupt)
    assert call(*TINY, BLIND, "view=video", "out=new/views") == 128 + signal.SIGINT
    assert len(capsys.readouterr().err.splitlines()) <= 1
    assert not list(folder.iterdir())


def test_a_checkpoint_that_is_not_there_is_named(
    call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call("checkpoint=nowhere") == 2
    assert "nowhere" in capsys.readouterr().err
    assert not list(folder.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize(("robot", "group"), [("rover_zero", "rover"), ("hyperdog", "hyperdog")])
def test_a_checkpoint_drives(robot: str, group: str, call: Call, folder: Path) -> None:
    words = ["sensors=[goal,velocity]", "actors=none", f"robot={robot}"]
    config = compose(Conf, ["+world=flat", *words]).model_dump(mode="json")
    spec = spec_of(words, group)
    ends = []
    for bias in (-3.0, 3.0):
        learner = make_sac(spec, folder, hidden=(8,))
        # All actions at one end of their ranges.
        for name, values in learner.policy.network.named_parameters():
            values.data.fill_(bias if name.endswith("bias") else 0.0)
        groups = {group: policy_entry(learner)}
        write_checkpoint_file(folder / "policy.pt", "policy", {"groups": groups, "config": config})
        view_words = [word for word in TINY if word != "actors=none" and not word.startswith("+world")]
        assert call(*view_words, "checkpoint=policy.pt", "view=video", f"out=views{bias}") == 0
        frames, _ = frames_of(folder / f"views{bias}" / f"flat_seed0_{folder.name}_policy.mp4")
        ends.append(frames[10].astype(int))
    assert np.abs(ends[0] - ends[1]).mean() > 1.0


def spec_of(words: Sequence[str], group: str) -> PolicySpec:
    env = make_torchrl_env(compose_environment("flat", words), 1, 0)
    spec = PolicySpec.of(env, group)
    env.close()
    return spec


def test_two_drivers_are_refused() -> None:
    with pytest.raises(ConfigError, match="choose one driver: checkpoint=PATH or policy=NAME"):
        compose(ViewConf, ["+world=flat", "checkpoint=runs/a", "policy=random"])


@pytest.mark.parametrize("name", ["a/film.mp4", "scene.GLB"])
def test_out_is_no_file(name: str) -> None:
    with pytest.raises(ConfigError, match=f"^out: {name} is the name of a file; name the folder"):
        compose(ViewConf, ["+world=flat", f"out={name}"])


def test_a_map_that_nobody_drives_has_no_numbered_episode() -> None:
    with pytest.raises(ConfigError, match=r"episode=3 of a set=NAME.* leave episode out"):
        compose(ViewConf, ["+world=flat", "view=map", "episode=3"])
    assert compose(ViewConf, ["+world=flat", "view=map", "episode=3", "policy=random"]).episode == 3


def test_help_and_settings_are_shown(call: Call, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call("--help") == 0
    text = capsys.readouterr().out
    for words in ("python -m dune_rl.view", "view=NAME", "checkpoint=PATH", "out=FOLDER"):
        assert words in text
    assert call("+world=flat", "seed=4", "--cfg", "job") == 0
    shown = yaml.safe_load(capsys.readouterr().out)
    assert (shown["seed"], shown["world"]["name"], shown["view"]) == (4, "flat", "both")
    assert not list(folder.iterdir())


# -- films and files ----------------------------------------------------------------------------------


@pytest.mark.parametrize("rate", [10.0, 20.0 / 3.0, 25.0])
def test_a_film_holds_the_frames_added(rate: float, tmp_path: Path) -> None:
    path = tmp_path / "film.mp4"
    shades = [20, 90, 160, 230]
    with open_video(path, rate, 64, 48) as add:
        for shade in shades:
            add(np.full((48, 64, 3), shade, np.uint8))
        assert not path.exists()
    frames, length_s = frames_of(path)
    assert frames.shape == (4, 48, 64, 3)
    np.testing.assert_allclose(frames.mean(axis=(1, 2, 3)), shades, atol=4.0)
    assert length_s == pytest.approx(4 / rate, rel=0.01)
    assert [each.name for each in tmp_path.iterdir()] == ["film.mp4"]


@pytest.mark.parametrize("size", [(63, 48), (64, 47)])
def test_a_film_of_an_odd_size_is_refused(size: tuple[int, int], tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=f"must be even \\(got {size[0]} by {size[1]}\\)"):
        open_video(tmp_path / "film.mp4", 10.0, *size).__enter__()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_a_film_that_fails_leaves_the_old_one_alone(error: type[BaseException], tmp_path: Path) -> None:
    path = tmp_path / "film.mp4"
    path.write_bytes(b"an older film")
    with pytest.raises(error), open_video(path, 10.0, 64, 48) as add:
        add(np.zeros((48, 64, 3), np.uint8))
        raise error
    assert path.read_bytes() == b"an older film"
    assert [each.name for each in tmp_path.iterdir()] == ["film.mp4"]


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "file.txt"
    with write_atomically(path) as temporary:
        temporary.write_text("first")
        assert not path.exists()
        assert temporary.parent == tmp_path
    assert path.read_text() == "first"
    with pytest.raises(RuntimeError), write_atomically(path) as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert path.read_text() == "first"
    with write_atomically(path) as temporary:
        temporary.write_text("second")
        assert path.read_text() == "first"
    assert path.read_text() == "second"
    assert [each.name for each in tmp_path.iterdir()] == ["file.txt"]
    path = tmp_path / "nowhere" / "file.txt"
    with pytest.raises(FileNotFoundError) as refused, write_atomically(path):
        pass
    assert refused.value.filename == str(path)


@pytest.mark.filterwarnings("ignore:.*try world.unit_m=1000")
def test_a_world_without_room_is_told_with_its_size(
    call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    trimesh.creation.box((1.0, 0.5, 0.1)).export(folder / "small.obj")
    assert call("+world=mesh", "world.path=small.obj", "view=map", "actors=none") == 2
    said = capsys.readouterr().err
    assert "the world 'mesh' is 1 by 0.5 m, and starts and goals keep 1 m from its edge" in said
    assert "world.unit_m" in said and not (folder / "views").exists()
