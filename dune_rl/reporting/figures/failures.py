"""A gallery of failures: for each method, pictures of the last seconds before some of each kind."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from textwrap import wrap

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from dune_rl.reporting.comparisons.comparison import EvaluatedPolicy
from dune_rl.reporting.figures.failure_replay import BEFORE_S, Replay, WantedFailure, replay_failures
from dune_rl.reporting.figures.results import COLLISION, FAILURES, failures_of
from dune_rl.reporting.figures.style import FAINT, PAGE_IN, RC, SMALL, new_figure, note_figure
from dune_rl.reporting.figures.track_data import TrackSite, track_of
from dune_rl.reporting.figures.tracks import draw_track_map

KINDS = ("collision", *FAILURES)
MOST_FAILURES, EACH = 12, 1
_SIZE = (320, 240)
_MAP_S = 20.0
_FASTEST_MPS = 1.0
_LABEL_IN = 1.25
# Characters that fit on a line beside pictures, and above a map.
_NAME_WIDTH, _MAP_WIDTH = 21, 32
_MAP_IN, _MAPS_ACROSS = 2.6, 4


@dataclass(frozen=True, eq=False)
class ShownFailure:
    """A failure of a method: with pictures (`replay`), or else its track on a map (`track`) and why."""

    cases: str
    method: str
    kind: str
    episode: int
    agent: str
    replay: Replay | None
    track: TrackSite | None
    reason: str

    @property
    def kind_name(self) -> str:
        """What the kind is called."""
        return COLLISION.name if self.kind == COLLISION.name else FAILURES[self.kind].name


@dataclass(frozen=True, eq=False)
class FailureGallery:
    """Failures that can be shown; `left_out` says what others there are, and why they are not shown.

    `counts` has the number of episodes with each kind by (cases, method, kind), shown or not.
    """

    shown: list[ShownFailure] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    counts: dict[tuple[str, str, str], int] = field(default_factory=dict)


def choose_failures(
    methods: Sequence[EvaluatedPolicy], each: int = EACH, most: int = MOST_FAILURES
) -> list[tuple[EvaluatedPolicy, WantedFailure]]:
    """The first `each` failures of each kind of each method, at most `most`; all methods get their share.

    An episode is chosen for one kind alone, if the kind has another.
    """
    queues: list[list[tuple[EvaluatedPolicy, WantedFailure]]] = []
    for method in methods:
        mine: list[tuple[EvaluatedPolicy, WantedFailure]] = []
        used: set[tuple[int, str]] = set()
        # Rare endings first: a collision, which most failures have as well, is found in other episodes, too.
        for kind in reversed(KINDS):
            found = [WantedFailure(kind, row) for row in method.rows if kind in failures_of(row)]
            found = [one for one in found if one.key not in used]
            used |= {one.key for one in found[:each]}
            mine = [(method, one) for one in found[:each]] + mine
        queues.append(mine)
    # In turn, so that none is left out because others come first.
    chosen = [
        queue[at] for at in range(max(map(len, queues), default=0)) for queue in queues if at < len(queue)
    ]
    kept = {(id(method), one.key) for method, one in chosen[:most]}
    return [pair for queue in queues for pair in queue if (id(pair[0]), pair[1].key) in kept]


def collect_failures(
    methods: Sequence[EvaluatedPolicy],
    each: int = EACH,
    most: int = MOST_FAILURES,
    progress: Callable[[int, int], None] = lambda done, total: None,
    *,
    simulate: bool = True,
) -> FailureGallery:
    """Pictures of the failures that `choose_failures` chooses, by running their episodes again.

    Where that is not possible, or not wanted (`simulate`), the recorded steps of the last 20 s before it are
    shown on a map. `progress` is called with the number of failures done, and of all.
    """
    chosen = choose_failures(methods, each, most)
    gallery = FailureGallery(counts=_counts(methods))
    done = 0

    def advance() -> None:
        nonlocal done
        done += 1
        progress(done, len(chosen))

    for method in methods:
        wanted = [one for owner, one in chosen if owner is method]
        if not wanted:
            continue
        replays: dict[tuple[int, str], Replay | str]
        if simulate:
            replays = replay_failures(method, wanted, _SIZE, advance)
        else:
            replays = {one.key: "its episode was not run again" for one in wanted}
        for one in wanted:
            found = replays[one.key]
            replay, reason = (None, found) if isinstance(found, str) else (found, "")
            track = None if replay is not None else track_of(method, one.row, one.kind, _MAP_S)
            episode, agent = one.key
            if replay is None and track is None:
                gallery.left_out.append(
                    f"{method.name} on {method.cases}, episode {episode} ({one.kind}): {reason}, and its "
                    "evaluation has no steps"
                )
                continue
            gallery.shown.append(
                ShownFailure(method.cases, method.name, one.kind, episode, agent, replay, track, reason)
            )
    return gallery


def _counts(methods: Sequence[EvaluatedPolicy]) -> dict[tuple[str, str, str], int]:
    found: dict[tuple[str, str, str], int] = {}
    for method in methods:
        for row in method.rows:
            for kind in failures_of(row):
                key = (method.cases, method.name, kind)
                found[key] = found.get(key, 0) + 1
    return found


def draw_failures(gallery: FailureGallery) -> Figure:
    """The failures of a gallery: rows of pictures that go on in time to the right, and maps below them.

    Maps stand for failures without pictures, with the reason.
    """
    filmed = [one for one in gallery.shown if one.replay is not None]
    mapped = [one for one in gallery.shown if one.track is not None]
    if not gallery.shown:
        return note_figure("no failure to show" + (": the list below says why" if gallery.left_out else ""))
    with rc_context(RC):
        side = (PAGE_IN - _LABEL_IN) / len(BEFORE_S)
        heights = [
            (side * _SIZE[1] / _SIZE[0] + 0.17) * len(filmed),
            _MAP_IN * -(-len(mapped) // _MAPS_ACROSS),
        ]
        figure = new_figure(PAGE_IN, sum(heights) + 0.05)
        ratios = [max(height, 1e-3) for height in heights]
        above, below = figure.subfigures(2, 1, height_ratios=ratios, squeeze=False).reshape(-1)
        if filmed:
            grid = above.subplots(
                len(filmed),
                1 + len(BEFORE_S),
                squeeze=False,
                width_ratios=[_LABEL_IN / side, *[1] * len(BEFORE_S)],
            )
            for row, failure in zip(grid, filmed, strict=True):
                _label(row[0], failure, gallery)
                assert failure.replay is not None
                _draw_pictures(list(row[1:]), failure.replay)
        if mapped:
            rows = -(-len(mapped) // _MAPS_ACROSS)
            panels = list(below.subplots(rows, _MAPS_ACROSS, squeeze=False).reshape(-1))
            for axes in panels[len(mapped) :]:
                axes.remove()
            for axes, failure in zip(panels, mapped, strict=False):
                _draw_map(axes, failure)
            below.supxlabel(
                f"colours of the ways: 0 (dark) to {_FASTEST_MPS:g} m/s (light)", fontsize=SMALL, color=FAINT
            )
    return figure


def _label(axes: Axes, failure: ShownFailure, gallery: FailureGallery) -> None:
    axes.set_axis_off()
    count = gallery.counts.get((failure.cases, failure.method, failure.kind), 0)
    told = "the only one" if count == 1 else f"one of {count}"
    when = "" if failure.replay is None else f"\nafter {failure.replay.time_s:.1f} s"
    lines = wrap(failure.method, _NAME_WIDTH)
    below = [failure.kind_name + when, failure.cases, f"episode {failure.episode}", f"({told})"]
    for text, top, weight in (
        ("\n".join(lines), 1.0, "bold"),
        ("\n" * len(lines) + "\n".join(below), 1.02, "normal"),
    ):
        axes.text(
            0.0,
            top,
            text,
            transform=axes.transAxes,
            va="top",
            fontsize=SMALL,
            fontweight=weight,
            linespacing=1.3,
        )


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
            f"{before:.1f} s before" if before else "the failure", fontsize=SMALL, loc="left", pad=2
        )


def _draw_map(axes: Axes, failure: ShownFailure) -> None:
    assert failure.track is not None
    draw_track_map(axes, failure.track, Normalize(0.0, _FASTEST_MPS))
    lines = wrap(failure.method, _MAP_WIDTH)
    lines += [
        f"{failure.kind_name}, episode {failure.episode}",
        failure.cases,
        f"last {_MAP_S:g} s on the map",
    ]
    axes.set_title("\n".join(lines), fontsize=SMALL, loc="left", pad=2)
    reason = "\n".join(wrap(f"no pictures: {failure.reason}", _MAP_WIDTH))
    axes.set_xlabel(reason, fontsize=SMALL - 1, color=FAINT, loc="left")
