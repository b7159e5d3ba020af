"""The panel of a live view: its controls, the agent's state, its rewards and metrics, and its camera."""

from base64 import b64encode
from collections.abc import Mapping, Sequence
from html import escape
from io import BytesIO
from typing import Any

import numpy as np
from PIL import Image

from dune_rl.env.live.playback import Playback
from dune_rl.geometry.arrays import Array, Bytes
from dune_rl.rendering.web.server import Server

_COLOURS = (
    "#2f80ed", "#eb5757", "#27ae60", "#f2994a", "#9b51e0", "#00a6a6", "#c2185b", "#8d6e63", "#607d8b",
)  # fmt: skip
# The metric that is plotted first.
_PLOTTED = "clearance"
# Folders before the state have lower numbers.
STATE_ORDER = 10
_WIDTH_PX, _PLOT_PX = 340, 190
_JPEG_QUALITY = 90
# Pictures of cameras are small: no smoothing between their pixels.
_PICTURE = "display:block;width:75%;margin:6px auto;image-rendering:pixelated;border-radius:4px"
_TABLE = "font-size:13px;line-height:1.55;width:100%;border-collapse:collapse"


class Panel:
    """The controls of a `playback`, and what the page says about the agent that it follows."""

    def __init__(self, server: Server, playback: Playback) -> None:
        gui = server.gui
        self._server, self._playback = server, playback
        gui.main_panel.dock_right()
        gui.main_panel.set_width(_WIDTH_PX)
        self._headline = gui.add_markdown("", order=1)
        self._pause = gui.add_button("Pause", order=2)
        self._pause.on_click(lambda _: self._act(playback.toggle_pause))
        step = gui.add_button("Step", order=3)
        step.on_click(lambda _: self._act(playback.step_once))
        speed = gui.add_button_group("Speed", ("Slower", "Faster"), order=4)
        speed.on_click(lambda _: self._act(playback.slower if speed.value == "Slower" else playback.faster))
        self.add_key("Pause or go on", "space", playback.toggle_pause)
        self.add_key("Step", "N", playback.step_once)
        with gui.add_folder("State", order=STATE_ORDER):
            self._state = gui.add_html("")
        self._plot: Any = None
        self._metric_plot: Any = None
        self._reward_folder = gui.add_folder("Rewards so far", visible=False, order=STATE_ORDER + 1)
        self._camera_folder = gui.add_folder("Camera", visible=False, order=STATE_ORDER + 2)
        with self._camera_folder:
            self._picture = gui.add_html("")
        self._metric_folder = gui.add_folder(
            "Metrics", visible=False, expand_by_default=False, order=STATE_ORDER + 3
        )
        with self._metric_folder:
            self._metrics = gui.add_html("", order=1)
            self._plotted = gui.add_dropdown("Plot", ("-",), order=2)
        with gui.add_folder("Show", order=STATE_ORDER + 4):
            self._beams = gui.add_checkbox("LiDAR", True, hint="yellow rays in a plane, blue points of rings")
            self._ways = gui.add_checkbox("Ways of actors", True, hint="grey; that of the agent is orange")
            self._follows = gui.add_checkbox("Follow the agent", True)
        self._act(lambda: None)

    @property
    def shows_beams(self) -> bool:
        return bool(self._beams.value)

    @property
    def shows_ways(self) -> bool:
        return bool(self._ways.value)

    @property
    def follows(self) -> bool:
        return bool(self._follows.value)

    def add_key(self, label: str, key: Any, act: Any) -> None:
        """Call `act` when a key is pressed in the page."""
        self._server.gui.add_command(label, hotkey=key).on_trigger(lambda _: self._act(act))

    def _act(self, act: Any) -> None:
        act()
        self._pause.label = "Go on" if self._playback.is_paused else "Pause"

    def show_state(self, headline: str, rows: Sequence[tuple[str, str]]) -> None:
        """Show a line, and a table of names and values."""
        speed = self._playback.speed
        _assign(self._headline, f"**{headline}**" if headline else "")
        _assign(self._state, _table([*rows, ("time runs at", f"{speed:g} x real time")]))

    def show_metrics(self, times_s: Array, values: Mapping[str, Array]) -> None:
        """Show the metrics (T,) of the episode so far at `times_s` (T,), and the curve of one."""
        self._metric_folder.visible = bool(values)
        if not values:
            return
        _assign(self._metrics, _table([(name, _number(curve[-1])) for name, curve in values.items()]))
        if self._plotted.options != (names := tuple(values)):
            self._plotted.options = names
            self._plotted.value = _PLOTTED if _PLOTTED in names else names[0]
        curve = values[str(self._plotted.value)]
        # Until a metric is defined, it is not a number.
        is_known = np.isfinite(curve)
        data = times_s[is_known], curve[is_known]
        if self._metric_plot is None:
            with self._metric_folder:
                self._metric_plot = self._add_plot(data, ("so far",), order=3)
        else:
            self._metric_plot.data = data

    def show_picture(self, picture: Bytes) -> None:
        """Show a camera's picture (rows, columns, 3)."""
        file = BytesIO()
        Image.fromarray(picture).save(file, format="jpeg", quality=_JPEG_QUALITY)
        data = b64encode(file.getvalue()).decode()
        self._camera_folder.visible = True
        _assign(self._picture, f'<img src="data:image/jpeg;base64,{data}" alt="" style="{_PICTURE}">')

    def show_rewards(self, times_s: Array, sums: Mapping[str, Array]) -> None:
        """Plot the sums (T,) of each reward term over `times_s` (T,)."""
        data = (times_s, *sums.values())
        if self._plot is None and sums:
            self._reward_folder.visible = True
            with self._reward_folder:
                self._plot = self._add_plot(data, tuple(sums))
        elif self._plot is not None:
            self._plot.data = data

    def _add_plot(self, data: tuple[Array, ...], names: tuple[str, ...], order: float | None = None) -> Any:
        from viser import uplot

        lines = (
            uplot.Series(label=name, stroke=_COLOURS[number % len(_COLOURS)], width=1.5)
            for number, name in enumerate(names)
        )
        return self._server.gui.add_uplot(
            data,
            (uplot.Series(label="time [s]"), *lines),
            scales={"x": uplot.Scale(time=False), "y": uplot.Scale(auto=True)},
            axes=(uplot.Axis(size=28), uplot.Axis(size=44)),
            legend=uplot.Legend(live=False),
            height=_PLOT_PX,
            padding=(8, 8, 0, 0),
            order=order,
        )


def _assign(element: Any, content: str) -> None:
    if element.content != content:
        element.content = content


def _number(value: float) -> str:
    return "-" if np.isnan(value) else f"{value:.4g}"


def _table(rows: Sequence[tuple[str, str]]) -> str:
    lines = "".join(
        f"<tr><td style='color:#777'>{escape(name)}</td>"
        f"<td style='text-align:right'>{escape(value)}</td></tr>"
        for name, value in rows
    )
    return f'<table style="{_TABLE}">{lines}</table>'
