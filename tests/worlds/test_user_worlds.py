"""Worlds of a user's own: YAML files, functions by entry point or registered, and what is said of faults."""

import os
import pickle
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from pydantic import Field
from user_packages import install_package, packages_on_path, write_package

import dune_rl
from dune_rl.config.build import build_world
from dune_rl.config.commands import EvaluateConf
from dune_rl.config.compose import check_sweep, compose, compose_environment
from dune_rl.config.schema import Conf
from dune_rl.core.errors import ConfigError, WorldError
from dune_rl.core.untrusted_files import WorldWarning
from dune_rl.env.registration import register_envs
from dune_rl.worlds import HeightField, Prop, Settings, World, check_world, upright_box
from dune_rl.worlds.registry import WORLDS

ROOT = Path(__file__).resolve().parents[2]
# The world, the package and the folder of options that the documentation shows.
SHOWN = "\n".join((ROOT / "docs" / name).read_text() for name in ("tutorial.md", "how_to/vary_a_world.md"))
TERRAIN = HeightField(np.zeros((21, 21)), 1.0, (-10.0, -10.0))
CUBE = Prop("cube", "box", *upright_box([3.0, 0.0], 0.0, -0.2, 0.6, 1.0, 1.0))


def plain(*props: Prop, region: Any = (-5, 5, -5, 5), friction: float = 1.0) -> World:
    return World("plain", TERRAIN, props, region=region, friction=friction)


class DishConf(Settings):
    depth_m: float = Field(1.0, gt=0.0)
    posts_m: list[float] = Field([1.0, 2.0])


def dish(conf: DishConf) -> World:
    return World("dish", HeightField(TERRAIN.heights - conf.depth_m, 1.0, (-10, -10)), region=(-5, 5, -5, 5))


@pytest.fixture
def user(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder with the files of the documentation, which is the current one and on Python's path."""
    monkeypatch.chdir(write_package(SHOWN, tmp_path))
    with packages_on_path(tmp_path):
        yield tmp_path


def fault(*words: str, folders: tuple[str, ...] = ()) -> str:
    with pytest.raises(ConfigError) as caught:
        compose(Conf, words, folders)
    return str(caught.value)


@pytest.mark.slow
def test_the_tutorial_s_world_as_a_new_user_tries_it(user: Path) -> None:
    command = re.search(r"^python -m (dune_rl\.evaluate \+world=crater .*)$", SHOWN, flags=re.MULTILINE)
    assert command is not None
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(user), str(ROOT)])}
    done = subprocess.run(
        [sys.executable, "-m", *command[1].split()], cwd=user, env=environment, capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "crater: 2 episodes of seed 0" in done.stdout
    (table,) = user.glob("evaluations/*_go_to_goal_crater/episodes.csv")
    assert len(table.read_text().splitlines()) == 3


@pytest.mark.slow
def test_a_function_is_a_world_like_any_other(user: Path) -> None:
    conf = compose(Conf, ["+world=crater", "world.depth_m=3", "world.rocks=4"])
    saved = conf.model_dump(mode="json")
    assert saved["world"] == {"name": "crater", "seed": 0, "depth_m": 3.0, "rocks": 4}
    assert compose(EvaluateConf, ["checkpoint=x"], (), saved).world == conf.world
    assert compose_environment(saved["world"]).world == conf.world
    assert check_sweep(["+world=crater,flat", "seed=1,2"]) == ["+world=crater,flat", "seed=1,2"]
    assert check_sweep(["+world=crater", "world.seed=1,2"]) == ["+world=crater", "world.seed=1,2"]
    world = build_world(conf.world)
    assert len(world.props) == 5
    assert build_world(compose(Conf, ["+world=crater", "world.depth_m=3", "world.rocks=4"]).world) is world
    register_envs()
    env = gymnasium.make("dune_rl/Crater-v0", actors="none")
    env.reset(seed=0)
    env.close()
    del gymnasium.registry["dune_rl/Crater-v0"]


@pytest.mark.slow
def test_the_faults_of_settings_have_the_words_they_have_elsewhere(user: Path) -> None:
    assert fault("+world=creter") == "there is no world 'creter'; did you mean crater?"
    assert fault("+world=crater", "world.deph_m=3", "world.rocks=x").splitlines() == [
        "world.rocks must be a whole number (got 'x')",
        "world.deph_m is not a setting; did you mean world.depth_m?",
    ]
    assert "construction, crater, flat" in fault()
    saved = compose(Conf, ["+world=crater"]).model_dump(mode="json")
    saved["world"]["name"] = "dune"
    with pytest.raises(ConfigError, match=r"no world 'dune' \(is the package that brings it installed\?\)"):
        compose(EvaluateConf, ["checkpoint=x"], (), saved)


@pytest.mark.slow
def test_a_folder_of_options_varies_any_world(user: Path) -> None:
    (user / "my" / "world" / "deep.yaml").write_text("name: crater\ndepth_m: 4\n")
    (user / "my" / "world" / "hole.yaml").write_text(
        "name: heightmap\npath: ${config_dir:world/hole.npy}\nsize_m: [20, 20]\n"
    )
    assert compose(Conf, ["+world=quarry"], ["my"]).world.model_dump()["rocks_per_100m2"] == 25
    assert (
        compose(Conf, ["+world=deep"], ["my"]).world
        == compose(Conf, ["+world=crater", "world.depth_m=4"]).world
    )
    assert "there is no file world/hole.npy in my" in fault("+world=hole", folders=("my",))
    np.save(user / "my" / "world" / "hole.npy", np.random.default_rng(0).uniform(0.0, 0.1, (41, 41)))
    conf = compose(Conf, ["+world=hole"], ["my"])
    assert conf.world.model_dump()["path"] == str(user / "my" / "world" / "hole.npy")
    # A file of the user's goes before a package, whose defaults are then the schema's.
    (user / "my" / "world" / "crater.yaml").write_text("name: crater\nrocks: 7\n")
    assert compose(Conf, ["+world=crater"], ["my"]).world.model_dump() == {
        **{"name": "crater", "seed": 0, "depth_m": 2.0},
        "rocks": 7,
    }
    env = dune_rl.make({"name": "deep", "rocks": 1}, 1, config_dirs=["my"], actors="none")
    assert len(env.simulation.worlds.worlds[0].props) == 2
    env.close()


BROKEN = {
    "absent": ("no_such_module:world", "which cannot be imported: ModuleNotFoundError: No module named"),
    "gone": ("broken:gone", "which cannot be imported: AttributeError: module 'broken' has no attribute"),
    "thing": ("broken:thing", "which must be a function that returns a World, and is 3."),
    "untyped": ("broken:untyped", "whose parameter 'seed' has no type: write such as seed: int = 0."),
    "rest": ("broken:rest", "whose parameter **rest: int cannot be a setting"),
    "taken": ("broken:taken", "whose parameter 'name' has a name that settings use themselves."),
    "returns": (
        "broken:returns",
        "a function that returns a World, and says that it returns int.",
    ),
    "arrays": ("broken:arrays", "whose parameters cannot be settings: Unable to generate"),
    "unfit": ("broken:unfit", "whose default for seed is unfit: Input should be a valid integer"),
}
MODULE = """
import numpy as np
from dune_rl.worlds import World
thing = 3
def untyped(seed=0): ...
def rest(**rest: int): ...
def taken(name: str = "x"): ...
def returns(seed: int = 0) -> int: ...
def arrays(heights: np.ndarray): ...
def unfit(seed: int = 0.5): ...
def nothing(seed: int = 0): return seed
def fails(seed: int = 0): return World(seed)
"""


@pytest.mark.slow
def test_a_broken_package_is_named_and_harms_no_other_world(user: Path) -> None:
    (user / "broken.py").write_text(MODULE)
    points = {name: value for name, (value, _) in BROKEN.items()}
    worlds = {**points, "nothing": "broken:nothing", "fails": "broken:fails"}
    install_package(user, "broken-worlds", {"dune_rl.worlds": worlds})
    for name, (value, reason) in BROKEN.items():
        said = fault(f"+world={name}")
        assert said.startswith(f"world: the package broken-worlds brings the world {name!r} as {value}, ")
        assert reason in said, said
    with pytest.raises(WorldError, match="as broken:nothing, which must return a World, but returned 0"):
        build_world(compose(Conf, ["+world=nothing"]).world)
    with pytest.raises(TypeError) as caught:
        build_world(compose(Conf, ["+world=fails"]).world)
    assert "broken-worlds brings the world 'fails'" in caught.value.__notes__[0]
    assert compose(Conf, ["+world=crater"]).world.name == "crater"
    assert compose(Conf, ["+world=flat"]).world.name == "flat"


def test_names_that_clash(user: Path) -> None:
    worlds = {"crater": "rival:crater", "flat": "rival:flat"}
    install_package(user, "rival-worlds", {"dune_rl.worlds": worlds})
    with pytest.warns(WorldWarning, match="rival-worlds brings the world 'flat' .* Give the entry point"):
        said = fault("+world=crater")
    assert re.search(r"the packages [\w-]+ and [\w-]+ both bring a world 'crater': uninstall one", said)
    with pytest.warns(WorldWarning):
        assert type(compose(Conf, ["+world=flat"]).world).__module__ == "dune_rl.worlds.flat"


def test_listing_and_other_worlds_import_no_package(user: Path) -> None:
    (user / "my_worlds.py").write_text("raise SystemExit('imported')")
    assert "crater" in WORLDS.names()
    compose(Conf, ["+world=flat"])
    assert "my_worlds" not in sys.modules


@pytest.mark.slow
def test_a_registered_function_travels_to_other_processes(user: Path) -> None:
    dune_rl.register_world(dish)
    conf = compose(Conf, ["+world=dish", "world.depth_m=2"]).world
    assert build_world(conf).terrain.height([0.0, 0.0]) == -2.0
    assert fault("+world=dish", "world.depth_m=-1") == "world.depth_m must be above 0.0 (got -1)"
    sent = pickle.dumps(conf)
    del WORLDS._user_parts["dish"]
    # As in a worker, which knows only what it is sent.
    there = pickle.loads(sent)
    assert build_world(there).terrain.height([0.0, 0.0]) == -2.0
    assert there.model_dump() == {"name": "dish", "depth_m": 2.0, "posts_m": [1.0, 2.0]}
    dune_rl.register_world(dish)
    del gymnasium.registry["dune_rl/Dish-v0"]


def test_a_program_cannot_take_a_name(user: Path) -> None:
    def flat() -> World:
        return plain()

    with pytest.raises(WorldError, match="cannot be the world 'flat', which dune_rl has"):
        WORLDS.register(flat)
    WORLDS.register(dish, "bowl")
    with pytest.raises(WorldError, match="cannot be the world 'bowl', which test_user_worlds:dish is"):
        WORLDS.register(flat, "bowl")
    with pytest.raises(WorldError, match="a world cannot be called 'a/b'"):
        WORLDS.register(flat, "a/b")


@pytest.mark.parametrize(
    ("world", "said"),
    [
        (plain(region=(-5, 15, -5, 5)), "region (-5, 15, -5, 5) reaches outside the terrain, which covers"),
        (plain(region=(5, -5, -5, 5)), "region must be (xmin, xmax, ymin, ymax) with min < max"),
        (plain(region=(np.nan, 5, -5, 5)), "region must be"),
        (plain(friction=0.0), "friction must be above 0 and at most 5, not 0.0"),
        (plain(replace(CUBE, vertices=CUBE.vertices.tolist())), "'cube': vertices and faces must be NumPy"),
        (
            plain(replace(CUBE, vertices=CUBE.vertices[:, :2])),
            "'cube': vertices must be floats of shape (V, 3)",
        ),
        (plain(replace(CUBE, vertices=CUBE.vertices * np.nan)), "'cube': vertices must be finite"),
        (plain(replace(CUBE, faces=CUBE.faces[:0])), "'cube': faces must be integers of shape (F, 3), F > 0"),
        (plain(replace(CUBE, faces=CUBE.faces + 1)), "'cube': faces must index vertices 0 to 7, not 1 to 8"),
        (plain(replace(CUBE, colour=(255, 0, 0))), "'cube': colour must be three numbers from 0 to 1"),
    ],
)
def test_an_unsound_world_is_refused(world: World, said: str) -> None:
    with pytest.raises(WorldError, match=re.escape(said)):
        check_world(world)


def test_weak_props_are_warned_of_and_sound_ones_are_not() -> None:
    check_world(plain(CUBE, replace(CUBE, faces=CUBE.faces[1:], solid=False)))
    with pytest.warns(WorldWarning, match=r"'cube' is not closed \(3 edges have one face only\)"):
        check_world(plain(replace(CUBE, faces=CUBE.faces[1:])))
    with pytest.warns(WorldWarning, match="'cube' is inside out"):
        check_world(plain(replace(CUBE, faces=CUBE.faces[:, ::-1])))


@pytest.mark.slow(all_but=["flat"])
@pytest.mark.parametrize(
    "name", ["flat", "inspection", "construction", "rubicon", "island", "obstacle_course"]
)
def test_our_own_worlds_are_sound(name: str) -> None:
    check_world(build_world(compose_environment(name).world))
