"""Rectangles of a world that are suited to starts and goals, as an importer finds them."""

from dataclasses import dataclass

Rectangle = tuple[float, float, float, float]

BETWEEN_OBJECTS, OPEN_GROUND = "between objects", "open ground"


@dataclass(frozen=True)
class RegionCandidate:
    """A rectangle (xmin, xmax, ymin, ymax) [m] in which a robot can drive from one place to another.

    `place` says what is around it: `BETWEEN_OBJECTS` or `OPEN_GROUND`. `free_m2` is the area of the positions
    that the middle of a robot can take.
    """

    rectangle: Rectangle
    place: str
    free_m2: float

    def describe(self) -> str:
        """Where the rectangle is and why it was chosen, as part of a sentence."""
        xmin, xmax, ymin, ymax = self.rectangle
        where = f"x {xmin:.4g} to {xmax:.4g}, y {ymin:.4g} to {ymax:.4g} m"
        share = self.free_m2 / ((xmax - xmin) * (ymax - ymin))
        return f"{where}: {self.place}, {min(share, 1.0):.0%} of it free and connected"


def describe_choice(region: Rectangle, candidates: tuple[RegionCandidate, ...]) -> str | None:
    """One line about the chosen region and how to choose another; None if it is none of the candidates."""
    numbers = [number for number, each in enumerate(candidates, start=1) if each.rectangle == region]
    if not numbers:
        return None
    number, count = numbers[0], len(candidates)
    if count == 1:
        ways = "world.region=[xmin,xmax,ymin,ymax] chooses another"
    else:
        ways = f"world.region={1 if number > 1 else 2} chooses another of {count}; view=map shows them"
    return f"Starts and goals: {candidates[number - 1].describe()} ({ways})"
