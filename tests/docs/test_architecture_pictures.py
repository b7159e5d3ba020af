"""The pictures of the documentation are those of the script that draws them, and of the package's layers."""

import importlib.util
import tomllib
from types import ModuleType
from xml.etree import ElementTree

import pytest
from documents import DOCS, ROOT

PICTURES = DOCS / "pictures"


@pytest.fixture(scope="module")
def draw() -> ModuleType:
    spec = importlib.util.spec_from_file_location("draw", PICTURES / "draw.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", ["architecture", "control_step"])
def test_a_picture_is_what_the_script_draws(name: str, draw: ModuleType) -> None:
    text = (PICTURES / f"{name}.svg").read_text()
    assert text == getattr(draw, name)()
    root = ElementTree.fromstring(text)
    _, _, width, height = (float(number) for number in root.attrib["viewBox"].split())
    space = "{http://www.w3.org/2000/svg}"
    for box in root.iter(f"{space}rect"):
        place = {key: float(box.get(key, 0)) for key in ("x", "y", "width", "height")}
        assert place["x"] + place["width"] <= width and place["y"] + place["height"] <= height
    # One palette for light systems, and one for dark.
    assert "prefers-color-scheme: dark" in text and set(draw.LIGHT) == set(draw.DARK)


def test_the_layers_are_those_that_are_checked(draw: ModuleType) -> None:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    rows = [
        {module.strip().removeprefix("dune_rl.") for module in row.replace(":", "|").split("|")}
        for row in contracts[0]["layers"]
    ]
    assert [{name for name, _ in modules} for _, modules in draw.LAYERS] == rows
    folders = {path.name for path in (ROOT / "dune_rl").iterdir() if (path / "__init__.py").exists()}
    assert folders == {name for row in rows for name in row}
