"""The learning curve as a picture."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, PercentFormatter

from dune_rl.core.files import write_atomically

_EVALUATION, _TRAINING = "#1f5fa8", "#d9822b"
_KINDS = (
    ("train", _TRAINING, {"lw": 1.2, "alpha": 0.9}, "training (last 100 episodes)"),
    ("eval", _EVALUATION, {"lw": 2.0, "marker": "o", "ms": 4}, "evaluation (unseen episodes)"),
)
_ROWS = (("SR", "success rate"), ("return", "return per episode"))
History = Sequence[Mapping[str, object]]


def draw_curve(history: History, path: Path, title: str) -> None:
    """Success rate and return over frames, from the rows of `metrics.csv`, as a PNG at `path`.

    There is a column for each group, and no success rate where none has one.
    It needs no display, and no state of pyplot's.
    """
    groups = list(dict.fromkeys(str(row.get("group", "")) for row in history))
    shown = [(key, label) for key, label in _ROWS if any(key in row for row in history)]
    size = (1 + 6 * len(groups), 3 * len(shown))
    figure = Figure(figsize=size, dpi=130, layout="constrained")
    grid = figure.subplots(len(shown), len(groups), sharex=True, squeeze=False)
    for column, group in zip(grid.T, groups, strict=True):
        rows = [row for row in history if str(row.get("group", "")) == group]
        for axes, (key, label) in zip(column, shown, strict=True):
            _draw(axes, rows, key, label)
        column[0].set_title(f"{title}: {group}" if group else title, loc="left", fontsize=11)
        column[0].legend(loc="best" if len(shown) == 1 else "lower right", frameon=False, fontsize=9)
        column[-1].set_xlabel("frames")
        column[-1].xaxis.set_major_formatter(EngFormatter(sep=""))
        column[-1].set_xlim(left=0)
    FigureCanvasAgg(figure)
    with write_atomically(path) as temporary:
        figure.savefig(temporary, format="png")


def _draw(axes: Axes, rows: History, key: str, label: str) -> None:
    for kind, colour, style, name in _KINDS:
        points = [row for row in rows if row["kind"] == kind]
        frames = np.array([row["frames"] for row in points], float)
        values = np.array([row.get(key, np.nan) for row in points], float)
        axes.plot(frames, values, color=colour, label=name, **style)
    axes.set_ylabel(label)
    axes.grid(color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    if key == "SR":
        axes.set_ylim(-0.02, 1.02)
        axes.yaxis.set_major_formatter(PercentFormatter(1, decimals=0))
