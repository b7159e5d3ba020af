"""The learning curve as a picture."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, PercentFormatter

from dune_rl.files import write_atomically

_EVALUATION, _TRAINING = "#1f5fa8", "#d9822b"


def draw_curve(history: Sequence[Mapping[str, object]], path: Path, title: str) -> None:
    """Success rate and return over frames, from the rows of `metrics.csv`, as a PNG at `path`.

    It needs no display, and no state of pyplot's.
    """
    figure = Figure(figsize=(7, 6), dpi=130, layout="constrained")
    success, reward = figure.subplots(2, 1, sharex=True)
    for axes, key, label in ((success, "SR", "success rate"), (reward, "return", "return per episode")):
        for kind, colour, style, name in (
            ("train", _TRAINING, {"lw": 1.2, "alpha": 0.9}, "training (last 100 episodes)"),
            ("eval", _EVALUATION, {"lw": 2.0, "marker": "o", "ms": 4}, "evaluation (unseen episodes)"),
        ):
            rows = [row for row in history if row["kind"] == kind]
            frames = np.array([row["frames"] for row in rows], float)
            values = np.array([row[key] for row in rows], float)
            axes.plot(frames, values, color=colour, label=name, **style)
        axes.set_ylabel(label)
        axes.grid(color="#dddddd", linewidth=0.6)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    success.set_ylim(-0.02, 1.02)
    success.yaxis.set_major_formatter(PercentFormatter(1, decimals=0))
    success.set_title(title, loc="left", fontsize=11)
    success.legend(loc="lower right", frameon=False, fontsize=9)
    reward.set_xlabel("frames")
    reward.xaxis.set_major_formatter(EngFormatter(sep=""))
    reward.set_xlim(left=0)
    FigureCanvasAgg(figure)
    with write_atomically(path) as temporary:
        figure.savefig(temporary, format="png")
