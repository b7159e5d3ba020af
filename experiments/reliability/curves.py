"""Draws `soak.png`, the curves of the soak: `python experiments/reliability/curves.py`."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import accumulate
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from dune_rl.core.files import read_csv, write_atomically

Row = Mapping[str, str]

_COLOURS = {"bullet": "#1f5fa8", "dart": "#d9822b"}
# Shorter segments are dots beside the curves of longer ones.
_LEAST_TURNS = 12
# Of the segments that compare rounds.
_FEW_SCENES = 8
_PANELS = (
    ("memory after a turn [MiB]", lambda row: float(row["held_mib"] or row["rss_mib"])),
    ("steps per s of processor time", lambda row: int(row["steps"]) / float(row["cpu_s"])),
)


def main() -> None:
    """Draw each segment over the steps that its process had driven; those of few scenes over their turns."""
    folder = Path(__file__).parent
    rows = [row for row in read_csv(folder / "soak.csv") if int(row["steps"])]
    figure, grid = plt.subplots(1, len(_PANELS) + 1, figsize=(13, 3.6), dpi=130, layout="constrained")
    for axes, (label, value) in zip(grid, _PANELS, strict=False):
        for number, own in _segments(row for row in rows if int(row["scenes"]) != _FEW_SCENES):
            millions = [steps / 1e6 for steps in accumulate(int(row["steps"]) for row in own)]
            _draw(axes, number, own, millions, [value(row) for row in own])
        axes.set_xlabel("control steps of the process [millions]")
        axes.set_title(label, loc="left", fontsize=10)
    for number, own in _segments(row for row in rows if int(row["scenes"]) == _FEW_SCENES):
        turns = [float(turn) for turn in range(1, len(own) + 1)]
        _draw(grid[-1], number, own, turns, [float(row["held_mib"]) for row in own])
    grid[-1].set_xlabel("short turns of the process, 22 in a round")
    grid[-1].set_title(f"memory after a turn of {_FEW_SCENES} scenes [MiB]", loc="left", fontsize=10)
    for axes in grid:
        axes.set_ylim(bottom=0)
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(axis="y", linewidth=0.4)
    lines = dict(zip(*reversed(grid[0].get_legend_handles_labels()), strict=True))
    figure.legend(lines.values(), lines.keys(), frameon=False, loc="outside lower center", ncols=2)
    with write_atomically(folder / "soak.png") as temporary:
        figure.savefig(temporary, format="png", metadata={"Software": None})


def _segments(rows: Iterable[Row]) -> Iterator[tuple[str, list[Row]]]:
    """The rows of each segment by its number."""
    every = list(rows)
    for number in dict.fromkeys(row["segment"] for row in every):
        yield number, [row for row in every if row["segment"] == number]


def _draw(
    axes: Axes, number: str, own: Sequence[Row], places: Sequence[float], values: Sequence[float]
) -> None:
    engine, is_long = own[0]["engine"], len(own) >= _LEAST_TURNS
    axes.plot(
        places,
        values,
        color=_COLOURS[engine],
        marker="." if is_long else "x",
        linestyle="-" if is_long else "",
        linewidth=1.2,
        markersize=4,
        alpha=1.0 if is_long else 0.5,
        label=engine,
    )
    if is_long:
        axes.annotate(number, (places[-1], values[-1]), (4, 0), textcoords="offset points")


if __name__ == "__main__":
    main()
