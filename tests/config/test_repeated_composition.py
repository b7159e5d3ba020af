"""Settings that are composed again: read anew where a file, a package or a registered part has changed."""

from pathlib import Path

import pytest
from user_packages import install_package, packages_on_path, registries_restored

import dune_rl
from dune_rl.config import hydra_session
from dune_rl.config.compose import compose, compose_environment
from dune_rl.config.schema import Conf
from dune_rl.worlds import World
from dune_rl.worlds.registry import WORLDS


@pytest.mark.slow
def test_a_file_that_changes_is_read_again(folder: Path) -> None:
    (folder / "my" / "world").mkdir(parents=True)
    file = folder / "my" / "world" / "icy.yaml"
    for friction in (0.25, 0.125):
        file.write_text(f"defaults: [flat, _self_]\nfriction: {friction}\n")
        assert compose(Conf, ["+world=icy"], ["my"]).world.model_dump()["friction"] == friction
    # A file more may stand in front of one that has been read.
    (folder / "my" / "world" / "flat.yaml").write_text("name: flat\nfriction: 0.75\n")
    assert compose(Conf, ["+world=flat"], ["my"]).world.model_dump()["friction"] == 0.75
    assert compose(Conf, ["+world=flat"]).world.model_dump()["friction"] != 0.75


def test_a_folder_that_is_found_from_elsewhere_is_another(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for place, friction in (("one", 0.25), ("two", 0.75)):
        (folder / place / "my" / "world").mkdir(parents=True)
        (folder / place / "my" / "world" / "icy.yaml").write_text(f"name: flat\nfriction: {friction}\n")
        monkeypatch.chdir(folder / place)
        assert compose(Conf, ["+world=icy"], ["my"]).world.model_dump()["friction"] == friction


@pytest.mark.slow
def test_a_part_that_is_registered_again_has_its_new_defaults() -> None:
    def register(depth: float) -> None:
        def bowl(depth_m: float = depth) -> World:
            raise NotImplementedError

        WORLDS.register(bowl)

    with registries_restored():
        for depth in (1.0, 2.0):
            register(depth)
            assert compose(Conf, ["+world=bowl"]).world.model_dump()["depth_m"] == depth
    with pytest.raises(dune_rl.ConfigError, match="no world 'bowl'"):
        compose(Conf, ["+world=bowl"])


def test_a_package_that_is_installed_later_is_found(tmp_path: Path) -> None:
    with packages_on_path(tmp_path):
        assert "dune" not in WORLDS.names()
        install_package(tmp_path, "dune-worlds", {"dune_rl.worlds": {"dune": "nowhere:dune"}})
        assert "dune" in WORLDS.names()
    assert "dune" not in WORLDS.names()


def test_settings_that_are_changed_do_not_change_the_next_ones() -> None:
    agents = {"rover": {"body": "leo_rover", "sensors": {"lidar": {"n_beams": 64}}}}
    one = compose_environment("inspection", (), {"agents": agents})
    expected = one.model_dump()
    dumped = one.model_dump()
    dumped["world"].clear()
    dumped["agents"]["rover"]["sensors"].clear()
    assert compose_environment("inspection", (), {"agents": agents}).model_dump() == expected


def test_equal_words_are_composed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    compose(Conf, ["+world=island", "world.seed=3"])

    def refuse(*_given: object, **_named: object) -> None:
        raise AssertionError("composed twice")

    monkeypatch.setattr(hydra_session, "hydra_compose", refuse)
    assert compose(Conf, ["+world=island", "world.seed=3"]).world.model_dump()["seed"] == 3
    with pytest.raises(AssertionError, match="composed twice"):
        compose(Conf, ["+world=island", "world.seed=4"])
