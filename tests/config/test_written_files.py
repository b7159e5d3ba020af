"""Files that are written whole or not at all: their rights, links to them, and what a fault leaves."""

import os
from pathlib import Path

import pytest

from dune_rl.core.errors import ConfigError
from dune_rl.core.files import check_free, write_atomically


@pytest.mark.skipif(os.name == "nt", reason="rights of Unix")
@pytest.mark.parametrize(("mask", "rights"), [(0o022, 0o644), (0o077, 0o600), (0o002, 0o664)])
def test_rights_are_those_that_a_new_file_has(mask: int, rights: int, tmp_path: Path) -> None:
    before = os.umask(mask)
    try:
        with write_atomically(tmp_path / "a.csv") as temporary:
            temporary.write_text("new")
    finally:
        os.umask(before)
    assert (tmp_path / "a.csv").stat().st_mode & 0o777 == rights


def test_a_link_stays_one(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "disk" / "a.csv").write_text("old")
    (tmp_path / "a.csv").symlink_to("disk/a.csv")
    with write_atomically(tmp_path / "a.csv") as temporary:
        temporary.write_text("new")
    assert (tmp_path / "a.csv").is_symlink() and (tmp_path / "disk" / "a.csv").read_text() == "new"
    assert [path.name for path in (tmp_path / "disk").iterdir()] == ["a.csv"]


def test_a_fault_leaves_the_file_as_it_was(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("old")
    with pytest.raises(RuntimeError), write_atomically(tmp_path / "a.csv") as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert [path.read_text() for path in tmp_path.iterdir()] == ["old"]
    (tmp_path / "file").write_text("")
    with pytest.raises(NotADirectoryError) as caught, write_atomically(tmp_path / "file" / "b.csv"):
        pass
    assert caught.value.filename == str(tmp_path / "file" / "b.csv")


def test_a_device_is_not_replaced_by_a_file() -> None:
    with pytest.raises(ConfigError, match="/dev/null is no ordinary file; choose another name"):
        check_free(Path(os.devnull), overwrite=True)
