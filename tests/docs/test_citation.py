"""CITATION.cff is of this version, and names the paper that the README names."""

import tomllib

import yaml
from documents import ROOT

import dune_rl

CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text())
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def test_it_has_what_the_format_requires() -> None:
    assert {"cff-version", "message", "title", "authors"} <= set(CITATION)
    assert CITATION["cff-version"] == "1.2.0" and CITATION["type"] == "software"


def test_it_is_of_this_project() -> None:
    assert CITATION["title"] == PROJECT["name"]
    assert CITATION["version"] == PROJECT["version"] == dune_rl.__version__
    assert CITATION["license"] == PROJECT["license"]
    assert [author["name"] for author in CITATION["authors"]] == [each["name"] for each in PROJECT["authors"]]


def test_it_cites_the_paper_of_the_task() -> None:
    (paper,) = CITATION["references"]
    readme = (ROOT / "README.md").read_text()
    for name in ("doi", "year", "volume", "journal"):
        assert f"{{{paper[name]}}}" in readme
    assert paper["title"].removeprefix("DUnE: ") in readme
    assert all(author["family-names"] in readme for author in paper["authors"])
