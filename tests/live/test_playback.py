"""The clock of a live view."""

from dune_rl.env.live.playback import SPEEDS, Playback


class Clock:
    """A clock that is set by hand."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def steps_in(playback: Playback, clock: Clock, seconds: float, step_s: float = 0.05) -> int:
    """Steps that are due while the clock runs for some time, looked at each millisecond."""
    taken = 0
    for _ in range(round(seconds * 1000)):
        clock.now_s += 0.001
        taken += playback.is_due(step_s)
    return taken


def test_steps_are_due_in_real_time_times_the_speed() -> None:
    clock = Clock()
    playback = Playback(clock)
    steps_in(playback, clock, 1.0)
    assert steps_in(playback, clock, 2.0) == 40
    playback.faster()
    assert playback.speed == 2.0 and abs(steps_in(playback, clock, 2.0) - 80) <= 1
    playback.slower()
    playback.slower()
    assert playback.speed == 0.5 and abs(steps_in(playback, clock, 2.0) - 20) <= 1


def test_a_pause_stops_time_and_single_steps_are_taken_in_it() -> None:
    clock = Clock()
    playback = Playback(clock)
    playback.toggle_pause()
    assert steps_in(playback, clock, 1.0) == 0
    playback.step_once()
    playback.step_once()
    assert steps_in(playback, clock, 1.0) == 2
    playback.toggle_pause()
    # Time that has passed in the pause is not made up for.
    assert steps_in(playback, clock, 1.0) <= 25


def test_a_step_from_running_time_pauses_it() -> None:
    clock = Clock()
    playback = Playback(clock)
    playback.step_once()
    assert playback.is_paused and steps_in(playback, clock, 1.0) == 1


def test_the_speed_stays_within_its_range() -> None:
    playback = Playback()
    for _ in range(20):
        playback.faster()
    assert playback.speed == SPEEDS[-1]
    for _ in range(20):
        playback.slower()
    assert playback.speed == SPEEDS[0]
