"""A gallery of failures: for each method, pictures of the last seconds before some of each kind."""

from collections.abc import Callable, Sequence
from textwrap import wrap

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from dune_rl.reporting.comparison import EvaluatedPolicy
from dune_rl.reporting.figures import style
from dune_rl.reporting.figures.failure_replay import BEFORE_S, Failure, Replay, replay_failures
from dune_rl.reporting.figures.results import FAILURES, failures_of
from dune_rl.reporting.figures.track_data import track_of
from dune_rl.reporting.figures.tracks import draw_track_map

KINDS = ("collision", *FAILURES)
MOST_FAILURES = 12
_SIZE = (320, 240)
_MAP_S = 20.0
_FASTEST_MPS = 1.0
_LABEL_IN = 1.25
# Characters that fit on a line beside pictures, and above a map.
_NAME_WIDTH, _MAP_WIDTH = 21, 32
_MAP_IN, _MAPS_ACROSS = 2.6, 4


def choose_failures(
    methods: Sequence[EvaluatedPolicy], each: int = 1, most: int = MOST_FAILURES
) -> list[Failure]:
    """The first `each` failures of each kind of each method, at most `most`; all methods get their share.

    An episode is chosen for one kind alone, if the kind has another.
    """
    queues: list[list[Failure]] = []
    for method in methods:
        mine: list[Failure] = []
        used: set[tuple[int, str]] = set()
        # Rare endings first: a collision, which most failures have as well, is found in other episodes, too.
        for kind in reversed(KINDS):
            rows = [row for row in method.rows if kind in failures_of(row)]
            found = [Failure(method, kind, row, len(rows)) for row in rows]
            first = [one for one in found if one.key not in used][:each]
            used |= {one.key for one in first}
            mine = first + mine
        queues.append(mine)
    # In turn, so that none is left out because others come first.
    longest = max(map(len, queues), default=0)
    in_turn = [queue[at] for at in range(longest) for queue in queues if at < len(queue)]
    return [one for queue in queues for one in queue if one in in_turn[:most]]


def show_failures(
    failures: Sequence[Failure], progress: Callable[[int], None] | None = None
) -> Sequence[Failure]:
    """The `failures` with pictures, which are taken by running their episodes again.

    Where that is not possible, or not wanted (no `progress`), they have the recorded steps of the last 20 s;
    without steps only the reason. `progress` is called with the number of failures done, from 0 on.
    """
    done = 0

    def advance() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done)

    if progress is not None:
        progress(0)
        for method in dict.fromkeys(one.method for one in failures):
            replay_failures([one for one in failures if one.method is method], _SIZE, advance)
    for one in failures:
        if one.replay is not None:
            continue
        one.reason = one.reason or "its episode was not run again"
        one.track = track_of(one.method, one.row, one.kind, _MAP_S)
        if one.track is None:
            one.reason = (
                f"{one.method.name} on {one.method.cases}, episode {one.key[0]} ({one.kind}): {one.reason}, "
                "and its evaluation has no steps"
            )
    return failures


def draw_failures(failures: Sequence[Failure]) -> Figure:
    """Rows of pictures that go on in time to the right; below them maps of the failures without pictures."""
    filmed = [one for one in failures if one.replay is not None]
    mapped = [one for one in failures if one.track is not None]
    if not filmed and not mapped:
        return style.note_figure("no failure to show" + (": the list below says why" if failures else ""))
    with rc_context(style.RC):
        side = (style.PAGE_IN - _LABEL_IN) / len(BEFORE_S)
        rows = -(-len(mapped) // _MAPS_ACROSS)
        heights = [(side * _SIZE[1] / _SIZE[0] + 0.17) * len(filmed), _MAP_IN * rows]
        figure = style.new_figure(style.PAGE_IN, sum(heights) + 0.05)
        ratios = [max(height, 1e-3) for height in heights]
        above, below = figure.subfigures(2, 1, height_ratios=ratios, squeeze=False).reshape(-1)
        if filmed:
            widths = [_LABEL_IN / side, *[1] * len(BEFORE_S)]
            grid = above.subplots(len(filmed), 1 + len(BEFORE_S), squeeze=False, width_ratios=widths)
            for row, failure in zip(grid, filmed, strict=True):
                assert failure.replay is not None
                _label(row[0], failure, failure.replay)
                _draw_pictures(list(row[1:]), failure.replay)
        if mapped:
            panels = list(below.subplots(rows, _MAPS_ACROSS, squeeze=False).reshape(-1))
            for axes in panels[len(mapped) :]:
                axes.remove()
            for axes, failure in zip(panels, mapped, strict=False):
                _draw_map(axes, failure)
            below.supxlabel(
                f"colours of the ways: 0 (dark) to {_FASTEST_MPS:g} m/s (light)",
                fontsize=style.SMALL,
                color=style.FAINT,
            )
    return figure


def _label(axes: Axes, failure: Failure, replay: Replay) -> None:
    axes.set_axis_off()
    told = "the only one" if failure.count == 1 else f"one of {failure.count}"
    lines = wrap(failure.method.name, _NAME_WIDTH)
    below = [
        f"{failure.kind_name}\nafter {replay.time_s:.1f} s",
        failure.method.cases,
        f"episode {failure.key[0]}",
        f"({told})",
    ]
    for text, top, weight in (
        ("\n".join(lines), 1.0, "bold"),
        ("\n" * len(lines) + "\n".join(below), 1.02, "normal"),
    ):
        axes.text(
            0.0, top, text, transform=axes.transAxes, va="top", fontsize=style.SMALL, fontweight=weight,
            linespacing=1.3,
        )  # fmt: skip


def _draw_pictures(panels: Sequence[Axes], replay: Replay) -> None:
    # The failure is always in the last column.
    empty = len(panels) - len(replay.pictures)
    for axes in panels[:empty]:
        axes.set_axis_off()
    for axes, picture, before in zip(panels[empty:], replay.pictures, replay.before_s, strict=True):
        axes.imshow(picture, interpolation="bilinear")
        axes.set_xticks([])
        axes.set_yticks([])
        axes.set_title(
            f"{before:.1f} s before" if before else "the failure", fontsize=style.SMALL, loc="left", pad=2
        )


def _draw_map(axes: Axes, failure: Failure) -> None:
    assert failure.track is not None
    draw_track_map(axes, failure.track, Normalize(0.0, _FASTEST_MPS))
    lines = wrap(failure.method.name, _MAP_WIDTH)
    lines += [f"{failure.kind_name}, episode {failure.key[0]}", failure.method.cases]
    lines.append(f"last {_MAP_S:g} s on the map")
    axes.set_title("\n".join(lines), fontsize=style.SMALL, loc="left", pad=2)
    reason = "\n".join(wrap(f"no pictures: {failure.reason}", _MAP_WIDTH))
    axes.set_xlabel(reason, fontsize=style.SMALL - 1, color=style.FAINT, loc="left")
