"""Draws `architecture.svg` and `control_step.svg`: `python docs/pictures/draw.py`.

Each picture has its own background, light or dark with the viewer's system, so that its text can be read on
any page.
"""

from collections.abc import Iterable
from html import escape
from pathlib import Path

FOLDER = Path(__file__).parent
# Two palettes of the same names: background, text, muted text, lines, and fills of boxes.
LIGHT = {"page": "#ffffff", "ink": "#1b1f24", "soft": "#57606a", "line": "#8c959f"}
DARK = {"page": "#16191d", "ink": "#e6edf3", "soft": "#b4bdc7", "line": "#6e7681"}
FILLS = {
    "command": ("#e7e3f4", "#3a3357"),
    "learn": ("#dbe9f8", "#22395a"),
    "env": ("#d6efe2", "#1d4534"),
    "part": ("#fbeccb", "#524018"),
    "base": ("#eceef1", "#2b3036"),
    "user": ("#f9dcd7", "#5a2c26"),
}


def palette() -> str:
    """The style sheet with both palettes."""
    lines = [
        *(f".{name} {{ fill: {colour}; }}" for name, colour in LIGHT.items()),
        *(f".{name} {{ fill: {light}; }}" for name, (light, _) in FILLS.items()),
        f".arrow {{ stroke: {LIGHT['soft']}; fill: none; stroke-width: 1.6; marker-end: url(#head); }}",
        f".edge {{ stroke: {LIGHT['line']}; stroke-width: 1; }}",
        "text { font-family: system-ui, 'DejaVu Sans', Arial, sans-serif; }",
        "@media (prefers-color-scheme: dark) {",
        *(f"  .{name} {{ fill: {colour}; }}" for name, colour in DARK.items()),
        *(f"  .{name} {{ fill: {dark}; }}" for name, (_, dark) in FILLS.items()),
        f"  .arrow {{ stroke: {DARK['soft']}; }}",
        f"  .edge {{ stroke: {DARK['line']}; }}",
        "}",
    ]
    return "\n".join(lines)


def text(
    x: float,
    y: float,
    words: str,
    size: int = 14,
    *,
    kind: str = "ink",
    bold: bool = False,
    at: str = "middle",
) -> str:
    """A line of text."""
    weight = ' font-weight="600"' if bold else ""
    return (
        f'<text x="{x:g}" y="{y:g}" font-size="{size}" text-anchor="{at}" class="{kind}"{weight}>'
        f"{escape(words)}</text>"
    )


def box(x: float, y: float, width: float, height: float, fill: str, title: str, *lines: str) -> str:
    """A box with a title and smaller lines below it, centred."""
    middle = x + width / 2
    top = y + height / 2 - 8.5 * len(lines) + 5
    parts = [
        f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="7" class="{fill} edge"/>',
        text(middle, top, title, 15, bold=True),
    ]
    parts += [text(middle, top + 18 * (row + 1), line, 12, kind="soft") for row, line in enumerate(lines)]
    return "\n".join(parts)


def arrow(*points: tuple[float, float]) -> str:
    """A line through the points with a head at its end."""
    return f'<path d="M {" L ".join(f"{x:g} {y:g}" for x, y in points)}" class="arrow"/>'


def picture(width: int, height: int, title: str, parts: Iterable[str]) -> str:
    """The whole drawing."""
    head = (
        '<marker id="head" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" markerHeight="7" '
        'orient="auto-start-reverse"><path d="M 0 0 L 10 5 L 0 10 z" class="soft"/></marker>'
    )
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img">',
            f"<title>{escape(title)}</title>",
            f"<style>\n{palette()}\n</style>",
            f"<defs>{head}</defs>",
            f'<rect width="{width}" height="{height}" rx="10" class="page"/>',
            *parts,
            "</svg>",
            "",
        ]
    )


# The ten layers of pyproject.toml, highest first: fill, and the title and explanation of each package.
LAYERS: tuple[tuple[str, tuple[tuple[str, str], ...]], ...] = (
    ("command", (("commands", "the command lines: train, evaluate, report, view, sets, benchmark, ..."),)),
    ("learn", (("reporting", "pages, tables, figures"), ("clients", "environments for other libraries"))),
    ("learn", (("evaluation", "sets, protocols, results"), ("trajectories", "planned ways of actors"))),
    ("learn", (("config", "schema and checks; the one place that names concrete classes"),)),
    (
        "learn",
        (
            ("learning", "algorithms, checkpoints"),
            ("visualization", "sheets, films, maps"),
            ("ros", "bags, topics of ROS 2"),
            ("gazebo", "files for Gazebo"),
        ),
    ),
    (
        "env",
        (
            ("env", "simulation of agent groups; Gymnasium, PettingZoo"),
            ("statistics", "intervals, paired tests, measures"),
        ),
    ),
    (
        "part",
        (
            ("tasks", "rewards, terminations"),
            ("metrics", "values of an episode"),
            ("behaviours", "scripted control"),
        ),
    ),
    (
        "part",
        (
            ("robots", "actions to motors"),
            ("bodies", "people, vehicles, ..."),
            ("sensors", "readings and faults"),
            ("worlds", "terrain and objects"),
        ),
    ),
    (
        "base",
        (
            ("state", "arrays of one step"),
            ("physics", "PyBullet, DART"),
            ("rendering", "light, scenery, pictures"),
        ),
    ),
    ("base", (("geometry", "frames, height fields, rays on Embree"), ("core", "files, registry, seeding"))),
)


def architecture() -> str:
    """The layers of the package."""
    width, height, gap = 700, 48, 8
    parts = []
    y = 20.0
    for fill, modules in LAYERS:
        each = (width - gap * (len(modules) - 1)) / len(modules)
        for column, (name, said) in enumerate(modules):
            parts.append(
                box(20 + column * (each + gap), y, each, height, fill, name, *([said] if said else []))
            )
        y += height + gap
    bottom = y - gap
    parts.append(arrow((742, 24), (742, bottom - 4)))
    middle = (24 + bottom) / 2
    words = text(756, middle, "imports only downward", 13, kind="soft")
    parts.append(f'<g transform="rotate(90 756 {middle:g})">{words}</g>')
    return picture(780, int(bottom + 20), "Layers of dune_rl", parts)


def control_step() -> str:
    """The way of the data through a control step."""
    column, wide, tall = (30, 285, 540), 210, 74
    rows = (20, 130, 240, 350)
    middle = [x + wide / 2 for x in column]
    parts = [
        box(column[0], rows[0], wide, tall, "user", "caller", "a policy, a learner, a user"),
        box(column[1], rows[0], wide, tall, "env", "actions (N, A)", "an array for each group"),
        box(column[2], rows[0], wide, tall, "part", "behaviours", "actions of the other groups"),
        box(
            column[1],
            rows[1],
            wide,
            tall,
            "part",
            "robots and bodies",
            "commands: wheel speeds,",
            "joint angles, steps",
        ),
        box(
            column[2],
            rows[1],
            wide,
            tall,
            "base",
            "physics",
            "M scenes, ten steps each;",
            "contacts of every step",
        ),
        box(
            column[2],
            rows[2],
            wide,
            tall,
            "base",
            "state",
            "read-only: poses, contacts,",
            "clearances, goals",
        ),
        box(
            column[1],
            rows[2],
            wide,
            tall,
            "part",
            "functions of the state",
            "sensors, rewards,",
            "terminations, metrics",
        ),
        box(column[1], rows[3], wide, tall, "env", "results", "observations, rewards,", "ends, infos"),
        box(
            column[2],
            rows[3],
            wide,
            tall,
            "env",
            "next episodes",
            "start, goal and actors where",
            "an episode has ended",
        ),
        arrow((column[0] + wide, rows[0] + tall / 2), (column[1] - 3, rows[0] + tall / 2)),
        arrow((middle[1], rows[0] + tall), (middle[1], rows[1] - 3)),
        arrow(
            (middle[2], rows[0] + tall),
            (middle[2], rows[1] - 18),
            (middle[1] + 60, rows[1] - 18),
            (middle[1] + 60, rows[1] - 3),
        ),
        arrow((column[1] + wide, rows[1] + tall / 2), (column[2] - 3, rows[1] + tall / 2)),
        arrow((middle[2], rows[1] + tall), (middle[2], rows[2] - 3)),
        arrow((column[2], rows[2] + tall / 2), (column[1] + wide + 3, rows[2] + tall / 2)),
        arrow((middle[1], rows[2] + tall), (middle[1], rows[3] - 3)),
        arrow((column[1] + wide, rows[3] + tall / 2), (column[2] - 3, rows[3] + tall / 2)),
        arrow(
            (column[1], rows[3] + tall / 2), (middle[0], rows[3] + tall / 2), (middle[0], rows[0] + tall + 3)
        ),
        arrow(
            (column[2] + wide, rows[2] + tall / 2),
            (column[2] + wide + 24, rows[2] + tall / 2),
            (column[2] + wide + 24, rows[0] + tall / 2),
            (column[2] + wide + 3, rows[0] + tall / 2),
        ),
        text(
            middle[0] + 8, (rows[0] + tall + rows[3] + tall / 2) / 2, "next step", 13, kind="soft", at="start"
        ),
    ]
    return picture(800, 444, "A control step of dune_rl", parts)


if __name__ == "__main__":
    (FOLDER / "architecture.svg").write_text(architecture())
    (FOLDER / "control_step.svg").write_text(control_step())
