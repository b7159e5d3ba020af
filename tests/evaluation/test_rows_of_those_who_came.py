"""Groups whose agents come and go: nobody may come in some episodes, and who comes differs by policy."""

from pathlib import Path
from typing import Any

from dune_rl.evaluation.blocks import FinishedEpisode
from dune_rl.evaluation.columns import describe_columns, measured_columns
from dune_rl.evaluation.folder import ResultsFolder
from dune_rl.evaluation.run_plan import rows_in_common
from dune_rl.evaluation.verify import RowDifference, difference_size
from dune_rl.metrics.catalogue import CATALOGUE


def row(group: str, policy: str, episode: int) -> dict[str, Any]:
    """A row of the first agent of a group."""
    return {"policy": policy, "agent": f"{group}_0", "episode": episode, "success": 1.0}


def test_groups_that_some_episodes_lack_have_their_rows(tmp_path: Path) -> None:
    with ResultsFolder(tmp_path, {}) as folder:
        for episode, groups in enumerate((["rover"], ["rover", "guest"], ["rover"], ["guest"])):
            rows = {group: [row(group, "x", episode)] for group in groups}
            folder.add(FinishedEpisode(0, episode, rows, []))
        found = [(one["agent"], one["episode"]) for one in folder.rows()]
    assert found == [("rover_0", 0), ("rover_0", 1), ("rover_0", 2), ("guest_0", 1), ("guest_0", 3)]


def test_policies_are_compared_on_what_all_have() -> None:
    rows = {name: [row("rover", name, episode) for episode in found] for name, found in FOUND.items()}
    common = rows_in_common(rows)
    assert {name: [one["episode"] for one in found] for name, found in common.items()} == {
        "x": [1, 3],
        "y": [3, 1],
    }
    assert rows_in_common({"x": rows["x"], "z": []}) == {}


FOUND = {"x": [0, 1, 3], "y": [3, 2, 1]}


def test_columns_that_a_measure_divides_are_described_as_they_are() -> None:
    divided = [measure.metric for measure in CATALOGUE if measure.per is not None]
    meanings = {measure.metric: measure.meaning for measure in CATALOGUE if measure.per is not None}
    for column in describe_columns(divided):
        assert column["meaning"] not in ("", meanings[column["column"]])
    # What they are divided by is there for reports.
    per = {measure.per for measure in CATALOGUE if measure.per is not None}
    assert per <= set(measured_columns([*per, "episode", "agent"]))


def test_what_is_unknown_on_one_side_differs_most() -> None:
    def size(stored: str, repeated: str) -> float:
        return difference_size(RowDifference("x", 0, "rover_0", "time_to_goal", stored, repeated))

    assert size("nan", "12.3") == size("12.3", "nan") == size("a", "b") == float("inf")
    assert size("1.0", "2.0") == 0.5
