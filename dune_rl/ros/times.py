"""Times of messages, in nanoseconds."""

from typing import Any

NS_PER_S = 1_000_000_000


def time_ns_of(steps: int, step_s: float) -> int:
    """The time after `steps` control steps of `step_s`, rounded to a nanosecond."""
    return round(steps * step_s * NS_PER_S)


def stamp_ns(stamp: Any) -> int:
    """The time of a `builtin_interfaces/Time`."""
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def header_ns(message: Any) -> int | None:
    """The time of a message's header; None without one, and for 0, which is unknown."""
    return stamp_ns(message.header.stamp) or None if hasattr(message, "header") else None
