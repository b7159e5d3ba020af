"""Gazebo files that lead out of their folder, loop or are no world: refused in words."""

import os
import warnings
from pathlib import Path

import pytest
from gazebo import GROUND, include, model, sdf, write_model
from pydantic import ValidationError
from world_files import write_yard

from dune_rl.core.errors import WorldError
from dune_rl.core.untrusted_files import WorldWarning
from dune_rl.worlds.importing.sdf.build import SdfConf, build_sdf


@pytest.fixture(autouse=True)
def _no_resources(monkeypatch):
    monkeypatch.delenv("GZ_SIM_RESOURCE_PATH", raising=False)


def refused(path: Path, match: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", WorldWarning)
        with pytest.raises(WorldError, match=match) as caught:
            build_sdf(SdfConf(path=str(path)))
    assert len(str(caught.value).splitlines()) <= 2


def refused_text(folder: Path, text: str, match: str) -> None:
    (folder / "w.sdf").write_text(text)
    refused(folder / "w.sdf", match)


@pytest.fixture
def secret(tmp_path):
    """A world's folder, and a model and a mesh beside it that must not be read."""
    folder = tmp_path / "world"
    folder.mkdir()
    outside = write_model(tmp_path, "secret", model("secret", "<box><size>9 9 9</size></box>"))
    write_yard(outside, "obj")
    (folder / "linked").symlink_to(outside)
    (folder / "link.obj").symlink_to(outside / "yard.obj")
    own = write_model(folder, "own", model("own", "<box/>"))
    (own / "link.obj").symlink_to(outside / "yard.obj")
    return folder


@pytest.mark.parametrize(
    "uri",
    [
        "model://../secret",
        "model://..",
        "model://",
        "model://own/../../secret",
        "model://own/../../secret/model.sdf",
        "../secret",
        "../secret/model.sdf",
        "file://../secret",
        "linked",
        "model://linked",
        "own/../../secret",
    ],
)
def test_includes_that_lead_out_are_refused(secret, uri):
    refused_text(secret, sdf(GROUND, include(uri)), "leads out of|names no model|is missing|plane")


@pytest.mark.parametrize(
    "uri",
    [
        "../secret/yard.obj",
        "model://own/../../secret/yard.obj",
        "link.obj",
        "model://own/link.obj",
        "model://linked/yard.obj",
    ],
)
def test_meshes_that_lead_out_are_refused(secret, uri):
    refused_text(secret, sdf(GROUND, model("m", f"<mesh><uri>{uri}</uri></mesh>")), "leads out of")


def test_absolute_paths_are_refused(secret):
    outside = secret.parent / "secret"
    for uri in (outside, f"file://{outside}", f"model://own/{outside}"):
        refused_text(secret, sdf(GROUND, include(str(uri))), "leads out of")
    (secret / "model.sdf").symlink_to(outside / "model.sdf")
    refused(secret, "leads out of")


def test_a_model_folder_is_read_by_its_config(tmp_path):
    own = write_model(tmp_path, "thing", GROUND)
    assert build_sdf(SdfConf(path=str(own))).extent == pytest.approx((-20, 20, -15, 15), abs=0.1)
    (own / "model.config").write_text("<model><sdf>../../x.sdf</sdf></model>")
    refused(own, "leads out of")
    empty = tmp_path / "empty"
    empty.mkdir()
    refused(empty, "has no model.sdf or world.sdf")


@pytest.mark.slow
def test_includes_in_a_loop_or_too_many_are_refused(tmp_path):
    write_model(tmp_path, "a", f'<model name="a"><static>1</static>{include("model://b")}</model>')
    write_model(tmp_path, "b", f'<model name="b"><static>1</static>{include("model://a")}</model>')
    refused_text(
        tmp_path,
        sdf(GROUND, include("model://a")),
        r"includes itself \(a/model.sdf > b/model.sdf > a/model.sdf\)",
    )
    refused_text(tmp_path, sdf(GROUND, include("w.sdf")), "includes itself")
    for level in range(12):
        inner = include(f"model://m{level - 1}") * 10 if level else GROUND
        write_model(tmp_path, f"m{level}", f'<model name="m"><static>1</static>{inner}</model>')
    refused_text(tmp_path, sdf(GROUND, include("model://m11")), "more than 2,000 <include>s")
    for level in range(30):
        inner = include(f"model://d{level - 1}") if level else GROUND
        write_model(tmp_path, f"d{level}", f'<model name="m"><static>1</static>{inner}</model>')
    refused_text(tmp_path, sdf(include("model://d29")), "more than 16 deep")


@pytest.mark.parametrize(
    "before",
    [
        '<!DOCTYPE x [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;">]>',
        '<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]>',
    ],
)
def test_xml_entities_are_refused(tmp_path, before):
    text = sdf(GROUND, '<model name="&a;"/>').replace("?>", "?>" + before, 1)
    refused_text(tmp_path, text, "declares XML entities or refers to external ones")
    own = write_model(tmp_path, "bomb", "<model/>")
    (own / "model.sdf").write_text(text)
    refused_text(tmp_path, sdf(GROUND, include("model://bomb")), "model.sdf declares XML entities")


def test_files_that_are_no_world_are_refused_in_words(tmp_path):
    refused_text(tmp_path, "", "no valid XML")
    refused_text(tmp_path, "<sdf>", "no valid XML")
    refused_text(tmp_path, "<urdf/>", "no SDF file: its root is <urdf>")
    refused_text(tmp_path, "<a>" * 9000 + "</a>" * 9000, "nested more than 128 deep")
    refused_text(tmp_path, sdf(), "has nothing that a robot could stand on")
    refused_text(
        tmp_path, sdf(GROUND, model("a", "<box><size>1 2</size></box>")), "<size> must hold 3 numbers"
    )
    refused_text(
        tmp_path, sdf(GROUND, model("a", "<box><size>1 2 nan</size></box>")), "<size> must hold 3 numbers"
    )
    refused_text(
        tmp_path,
        sdf(GROUND, model("a", "<box><size>1 2 -3</size></box>")),
        "<size> of a <box> must be above 0",
    )
    refused_text(tmp_path, sdf(GROUND, model("a", "<box/>", "0 0 0 up 0 0")), "<pose> must hold 6 numbers")
    refused_text(tmp_path, sdf(GROUND, model("a", "<mesh><uri>w.sdf</uri></mesh>")), "has the ending .sdf")
    refused(tmp_path / "none.sdf", "there is no file")
    os.mkfifo(tmp_path / "pipe.sdf")
    refused(tmp_path / "pipe.sdf", "no plain file")
    with (tmp_path / "large.sdf").open("wb") as file:
        file.truncate(5 * 2**30)
    refused(tmp_path / "large.sdf", "has 5,120 MiB")


@pytest.mark.parametrize("wrong", [{"path": ""}, {"spacing_m": 0}, {"friction": 0}, {"size_m": 3}])
def test_bad_settings_are_refused(wrong):
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        SdfConf(**({"path": "x"} | wrong))
