"""Settings that several behaviours share."""

from typing import Annotated

from pydantic import AfterValidator, Field


def _rising(limits: tuple[float, float]) -> tuple[float, float]:
    if not 0.0 <= limits[0] <= limits[1]:
        raise ValueError(f"give the least, at least 0, and then the greatest (got {list(limits)})")
    return limits


Speed = Annotated[float, Field(gt=0.0, le=50.0, description="speed at which it goes [m/s]")]
Who = Annotated[str, Field(min_length=1, description="robots, or the name of a group")]
Range = Annotated[
    float, Field(ge=2.0, le=1_000.0, description="how far from where it started, along x and y [m]")
]
Places = Annotated[
    tuple[tuple[float, float], ...],
    Field(description="points [x, y] [m] in turn; none: random places within range_m"),
]
PauseRange = Annotated[
    tuple[float, float],
    AfterValidator(_rising),
    Field(description="shortest and longest pause at a place [s]"),
]
