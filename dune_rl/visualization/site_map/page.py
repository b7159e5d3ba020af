"""The page of a map: positions in inches, text, scale bars and arrows."""

from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle as Box

from dune_rl.visualization.site_map import colours
from dune_rl.worlds.world import Rectangle

WIDTH_IN, HEIGHT_IN = 13.0, 8.0
_SCALES_M = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0)
# Narrower panels have no room above them for a scale bar, or for arrows besides.
_SCALE_BAR_IN, _ARROWS_IN = 1.9, 3.4


@dataclass(frozen=True)
class PageRectangle:
    """A rectangle on the page [in], given by its lower left corner and size."""

    left: float
    bottom: float
    width: float
    height: float

    @property
    def top(self) -> float:
        """The position of its upper side [in]."""
        return self.bottom + self.height


def fit_rectangle(rectangle: Rectangle, room: PageRectangle) -> PageRectangle:
    """The largest page rectangle with the proportions of `rectangle` at the top left of `room`."""
    width, height = rectangle[1] - rectangle[0], rectangle[3] - rectangle[2]
    scale = min(room.width / width, room.height / height)
    return PageRectangle(room.left, room.top - scale * height, scale * width, scale * height)


def panel_axes(figure: Figure, place: PageRectangle) -> Axes:
    """Axes in a rectangle of the page."""
    return figure.add_axes(
        (place.left / WIDTH_IN, place.bottom / HEIGHT_IN, place.width / WIDTH_IN, place.height / HEIGHT_IN)
    )


def page_axes(figure: Figure) -> Axes:
    """Axes over the whole page, with coordinates in inches; created at the first call."""
    for axes in figure.axes:
        if axes.get_label() == "page":
            return axes
    axes = figure.add_axes((0, 0, 1, 1), label="page", zorder=-1)
    axes.set_xlim(0, WIDTH_IN)
    axes.set_ylim(0, HEIGHT_IN)
    axes.set_axis_off()
    return axes


def draw_text(
    figure: Figure, x: float, y: float, text: str, size: float, *, weight: str = "normal",
    colour: str = colours.INK, ha: str = "left",
) -> None:  # fmt: skip
    """Draw a line of text at (x, y) [in]; `size` is in points."""
    page_axes(figure).text(x, y, text, fontsize=size, fontweight=weight, color=colour, ha=ha, va="baseline")


def draw_scale_bar(figure: Figure, place: PageRectangle, per_m: float) -> None:
    """Draw a bar of a round length above the right end of a panel; `per_m` is the scale [in/m]."""
    if place.width < _SCALE_BAR_IN:
        return
    longest = 0.24 * place.width / per_m
    length = max((scale for scale in _SCALES_M if scale <= longest), default=_SCALES_M[0])
    right, y = place.left + place.width - 0.62, place.top + 0.13
    left = right - length * per_m
    page = page_axes(figure)
    half = (right - left) / 2
    for start, colour in ((left, colours.INK), (left + half, colours.PAPER)):
        page.add_patch(
            Box((start, y - 0.025), half, 0.05, facecolor=colour, edgecolor=colours.INK, linewidth=0.6)
        )
    draw_text(figure, right + 0.06, y - 0.045, f"{length:g} m", 7.5)


def draw_axis_arrows(figure: Figure, place: PageRectangle) -> None:
    """Draw the directions of x and y above the middle of a panel."""
    if place.width < _ARROWS_IN:
        return
    page = page_axes(figure)
    x, y = place.left + 0.45 * place.width, place.top + 0.07
    for dx, dy, name, at in ((0.24, 0.0, "x", (0.28, -0.03)), (0.0, 0.24, "y, N", (-0.32, 0.14))):
        page.annotate(
            "", (x + dx, y + dy), (x, y),
            arrowprops={"arrowstyle": "-|>,head_length=4,head_width=2", "color": colours.INK,
                        "mutation_scale": 1, "linewidth": 0.9, "shrinkA": 0, "shrinkB": 0},
        )  # fmt: skip
        draw_text(figure, x + at[0], y + at[1], name, 7)


def frame_panel(axes: Axes) -> None:
    """Label and frame the axes of a panel."""
    axes.set_xlabel("x [m], east", fontsize=7.5, color=colours.INK, labelpad=2)
    axes.set_ylabel("y [m], north", fontsize=7.5, color=colours.INK, labelpad=2)
    axes.tick_params(labelsize=7, colors=colours.INK, length=3, width=0.6)
    for spine in axes.spines.values():
        spine.set_color(colours.INK)
        spine.set_linewidth(0.8)
        spine.set_zorder(9)


def frame_map(
    figure: Figure, axes: Axes, place: PageRectangle, rectangle: Rectangle, caption: str, *, arrows: bool
) -> None:
    """Frame the map of `rectangle` [m] in `axes`, with caption, scale bar and, with `arrows`, the axes."""
    frame_panel(axes)
    draw_text(figure, place.left, place.top + 0.1, caption, 9, weight="bold")
    draw_scale_bar(figure, place, place.width / (rectangle[1] - rectangle[0]))
    if arrows:
        draw_axis_arrows(figure, place)
