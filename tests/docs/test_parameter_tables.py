"""The tables of parameters in the reference of the Python interface."""

from collections.abc import Iterable

import pytest

pytest.importorskip("sphinx", reason="the documentation's tools are not installed")
from parameter_tables import parameter_table


def drive(speed_mps: float, *, names: Iterable[str] = (), **settings: object) -> None:
    """Drive at `speed_mps` [m/s]. The `names` are those of robots; `settings` is ignored."""


def test_a_row_has_type_default_and_the_sentence_that_names_the_parameter() -> None:
    cells = [line.strip(" *-") for line in parameter_table(drive, [drive.__doc__ or ""])[3:-1]]
    assert cells[4:8] == ["``speed_mps``", "``float``", "required", "Drive at `speed_mps` [m/s]."]
    assert cells[8:12] == ["``names``", "``Iterable[str]``", "``()``", "The `names` are those of robots"]
    assert cells[12] == "``**settings``"


def test_there_is_none_for_a_single_parameter() -> None:
    assert parameter_table(len, ["Length of an object."]) == []
