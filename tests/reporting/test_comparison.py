"""Methods of several evaluations of the same episodes."""

import math

import pytest

from dune_rl.reporting.comparison import EvaluatedPolicy, average_methods, estimate_rows

NAN = math.nan


def method(key: str = "a", **metrics: list[float]) -> EvaluatedPolicy:
    columns = {"episode": [0.0, 1.0], **metrics}
    rows = [dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)]
    return EvaluatedPolicy("x", "x", [row | {"agent": "rover_0"} for row in rows], key=key)


def test_metrics_are_averaged_in_each_episode() -> None:
    some = method(success=[1.0, 0.0], time_to_goal=[10.0, NAN])
    none = method(success=[0.0, 0.0], time_to_goal=[NAN, NAN])
    more = method(success=[2.0, 1.0], time_to_goal=[30.0, 40.0])
    for methods in ([some, none, more], [none, more, some]):
        found = average_methods(methods)
        assert [row["success"] for row in found.rows] == pytest.approx([2 / 3, 1 / 3])
        assert [row["time_to_goal"] for row in found.rows] == [20.0, 40.0]
        assert estimate_rows(found.rows)["MTT"].value == 30.0
    assert math.isnan(none.rows[0]["time_to_goal"]) and some.rows[1]["success"] == 0.0


def test_other_episodes_have_no_mean() -> None:
    one = method(success=[1.0, 0.0])
    for other in (method("b", success=[1.0, 0.0]), EvaluatedPolicy("x", "x", one.rows[:1], key="a")):
        with pytest.raises(ValueError, match="different episodes"):
            average_methods([one, other])
