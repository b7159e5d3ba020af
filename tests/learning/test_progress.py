"""What a run says of its progress: to a terminal, to a pipe, and how long it thinks it will take."""

import io
import math

import pytest
from rich.console import Console
from training import small, trainer

from dune_rl.learning.run.progress import (
    BarReporter,
    LineReporter,
    Reporter,
    SpeedMeter,
    TrainingStatus,
    describe_duration,
    format_duration,
    show_episodes,
)

STATUS = TrainingStatus(500_000, 1_000_000, 2500.0, 120.0, 0.734, 0.15, 3723.0)


class Clock:
    """A clock that a test sets."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def test_lines_are_spaced_in_time() -> None:
    told: list[str] = []
    lines = LineReporter(told.append, interval_s=1000)
    lines.update(STATUS)
    lines.update(STATUS)
    counts, speeds = "training  500,000 of 1,000,000 frames", "2,500 frames/s  120 updates/s"
    assert told == [f"{counts}  1:02:03 left  {speeds}  success in training 73 %  evaluated 15 %"]


def test_what_is_unknown_is_left_out() -> None:
    line = TrainingStatus(0, 10, 0.0, 0.0, activity="scripted warm-up").statistics()
    assert line == "? left"


@pytest.mark.parametrize("width", [80, 150])
@pytest.mark.parametrize("activity", ["training", "scripted warm-up", "evaluating 100/100"])
def test_the_bar_fits_the_terminal(width: int, activity: str) -> None:
    console = Console(width=width, file=io.StringIO(), force_terminal=True, color_system=None)
    with BarReporter(console) as bar:
        bar.update(TrainingStatus(1_500_000, 2_500_000, 12_345.0, 120.0, 1.0, 1.0, 36_000.0, activity))
    last = [line for line in console.file.getvalue().replace("\r", "\n").split("\n") if "%" in line][-1]  # type: ignore[attr-defined]
    assert activity in last and "10:00:00 left" in last and "evaluated 100 %" in last
    assert "…" not in last
    assert last.count("━") >= 3
    assert ("success in training 100 %" in last) == (width >= 150)


def test_the_speed_is_known_35_s_after_the_second_mark() -> None:
    clock = Clock()
    meter = SpeedMeter(clock)
    meter.mark(0, 0)
    # Until then processes start, and what a warm-up tells is learnt.
    clock.now += 45.0
    meter.mark(2000, 10)
    clock.now += 34.0
    meter.mark(19_000, 100)
    assert math.isnan(meter.seconds_left(5000, 0))
    clock.now += 1.0
    meter.mark(19_500, 110)
    assert meter.seconds_left(5000, 0) == pytest.approx(5000 / 500)
    meter.restart()
    assert math.isnan(meter.seconds_left(5000, 0))


def test_time_left_counts_evaluations_which_are_no_part_of_the_speed() -> None:
    clock = Clock()
    meter = SpeedMeter(clock)
    for frames in (0, 1000):
        meter.mark(frames, 0)
        clock.now += 2.0
    clock.now += 30.0
    meter.pause(evaluation_s=30.0)
    meter.mark(1000, 0)
    # 35 s have passed since the second mark, 30 of which were an evaluation.
    clock.now += 3.0
    meter.mark(2500, 0)
    assert math.isnan(meter.seconds_left(5000, 3))
    clock.now += 30.0
    meter.mark(17_500, 90)
    clock.now += 7.0
    meter.pause(evaluation_s=7.0)
    assert meter.seconds_left(5000, 3) == pytest.approx(5000 / 500 + 3 * 7.0)


def test_the_estimate_of_a_run_has_its_length_and_its_end() -> None:
    assert "about 11 minutes, until " in describe_duration(61.0, 599.0)
    assert "about 2.5 hours, until " in describe_duration(1800.0, 7200.0)


def test_episodes_are_counted_in_lines_where_there_is_no_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    console = Console(file=io.StringIO())
    with show_episodes(console, "go_to_goal", 100, interval_s=0.0) as show:
        show(25)
    assert capsys.readouterr().out.startswith("go_to_goal: 25 of 100 episodes  0:00 left")


def test_durations() -> None:
    assert [format_duration(s) for s in (5.4, 65.0, 3600.0, math.nan)] == ["0:05", "1:05", "1:00:00", "?"]


class Recording(Reporter):
    """Keeps every status."""

    def __init__(self) -> None:
        self.seen: list[TrainingStatus] = []

    def update(self, status: TrainingStatus) -> None:
        self.seen.append(status)


@pytest.mark.slow
def test_success_is_that_of_the_policy_which_is_trained(tmp_path) -> None:
    recording = Recording()
    trainer(tmp_path / "run", small(), total_frames=2048, reporter=recording).train()
    warmup = [status for status in recording.seen if status.activity == "random warm-up"]
    assert warmup and all(math.isnan(status.success_rate) for status in warmup)
    assert all(status.frames < small().learning_starts for status in warmup)
    training = [status for status in recording.seen if status.activity == "training"]
    assert training and any(not math.isnan(status.success_rate) for status in training)
    evaluating = [status for status in recording.seen if status.activity.startswith("evaluating")]
    assert evaluating[0].activity == "evaluating 0/10"
    assert evaluating[-1].activity == "evaluating 10/10"
    # Only after an evaluation there is one to tell of.
    assert math.isnan(evaluating[0].evaluated) and not math.isnan(recording.seen[-1].evaluated)
