"""Draws `soak.png`, the curves of the soak: `python experiments/reliability/curves.py`."""

from itertools import accumulate
from pathlib import Path

import matplotlib.pyplot as plt

from dune_rl.core.files import read_csv, write_atomically

_COLOURS = {"bullet": "#1f5fa8", "dart": "#d9822b"}
# Shorter segments are dots beside the curves of longer ones.
_LEAST_TURNS = 12
_PANELS = (
    ("memory after a turn [MiB]", lambda row: float(row["held_mib"] or row["rss_mib"])),
    ("steps per s of processor time", lambda row: int(row["steps"]) / float(row["cpu_s"])),
)


def main() -> None:
    """Draw each segment over the steps that its process had driven."""
    folder = Path(__file__).parent
    rows = [row for row in read_csv(folder / "soak.csv") if int(row["steps"])]
    figure, grid = plt.subplots(1, len(_PANELS), figsize=(10, 3.6), dpi=130, layout="constrained")
    for axes, (label, value) in zip(grid, _PANELS, strict=True):
        for number in dict.fromkeys(row["segment"] for row in rows):
            own = [row for row in rows if row["segment"] == number]
            millions = [steps / 1e6 for steps in accumulate(int(row["steps"]) for row in own)]
            engine, is_long = own[0]["engine"], len(own) >= _LEAST_TURNS
            axes.plot(
                millions,
                [value(row) for row in own],
                color=_COLOURS[engine],
                marker="." if is_long else "x",
                linestyle="-" if is_long else "",
                linewidth=1.2,
                markersize=4,
                alpha=1.0 if is_long else 0.5,
                label=engine,
            )
            if is_long:
                axes.annotate(number, (millions[-1], value(own[-1])), (4, 0), textcoords="offset points")
        axes.set_xlabel("control steps of the process [millions]")
        axes.set_title(label, loc="left", fontsize=10)
        axes.set_ylim(bottom=0)
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(axis="y", linewidth=0.4)
    lines = dict(zip(*reversed(grid[0].get_legend_handles_labels()), strict=True))
    figure.legend(lines.values(), lines.keys(), frameon=False, loc="outside lower center", ncols=2)
    with write_atomically(folder / "soak.png") as temporary:
        figure.savefig(temporary, format="png", metadata={"Software": None})


if __name__ == "__main__":
    main()
