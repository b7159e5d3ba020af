"""Settings of agents that come and go."""

from typing import Any

# They come within the first seven steps.
SOON = {"arrive_s": [0.0, 0.35], "stay_s": [0.1, 0.5]}


def visitors(body: str, count: int, **presence: Any) -> dict[str, Any]:
    """A group of external agents that come and go."""
    return {"body": body, "count": count, "controller": "external", "presence": presence or SOON}


def visited(presence: dict[str, Any], body: str = "person", count: int = 2, **more: Any) -> dict[str, Any]:
    """Settings of a rover that is visited by others."""
    return {"actors": {"guest": visitors(body, count, **presence) | more}}
