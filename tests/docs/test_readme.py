"""The README: short, and its first two blocks of commands set themselves up."""

from documents import DOCS, ROOT, code_blocks

README = ROOT / "README.md"


def test_readme_opens_with_two_blocks_that_set_themselves_up() -> None:
    (first, run), (second, test) = code_blocks(README)[:2]
    assert (first, second) == ("sh", "sh")
    for block in (run, test):
        assert "-m venv" in block
        assert "-c constraints.txt" in block
    _, film, training = run.strip().splitlines()
    # What takes two minutes and ends with a film, and then the main command.
    assert "dune_rl.view" in film and "view=video" in film
    assert "dune_rl.train +experiment=all_worlds" in training
    assert "-m pytest" in test


def test_readme_is_short() -> None:
    assert len(README.read_text().splitlines()) < 200


def test_readme_leads_to_every_guide() -> None:
    text = README.read_text()
    guides = {path.name for path in (DOCS / "how_to").glob("*.md")} - {"index.md"}
    # The kinds of parts are listed by the page that all of them share.
    missing = {name for name in guides if f"docs/how_to/{name}" not in text and not name.startswith("add_a")}
    assert not missing
