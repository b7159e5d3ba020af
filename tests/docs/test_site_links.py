"""The check of a built site's links finds what is broken, and what would be loaded from elsewhere."""

from pathlib import Path

from check_links import broken_links


def write_site(folder: Path, **pages: str) -> Path:
    for name, body in pages.items():
        (folder / f"{name}.html").write_text(f"<html><body>{body}</body></html>")
    return folder


def test_a_sound_site_has_none(tmp_path: Path) -> None:
    (tmp_path / "a picture.png").write_bytes(b"")
    links = '<a href="two.html#part">x</a><a href="#here">x</a><p id="here"><img src="a%20picture.png">'
    site = write_site(
        tmp_path, one=links + '<a href="https://example.org/">x</a>', two='<h2 id="part">x</h2>'
    )
    assert broken_links(site) == []


def test_faults_are_named(tmp_path: Path) -> None:
    links = '<a href="gone.html">x</a><a href="two.html#gone">x</a><img src="gone.png">'
    site = write_site(tmp_path, one=links + '<script src="https://example.org/x.js"></script>', two="")
    assert broken_links(site) == [
        "one.html leads to gone.html, which is not there",
        "one.html leads to two.html#gone, which has no such anchor",
        "one.html leads to gone.png, which is not there",
        "one.html loads https://example.org/x.js",
    ]
