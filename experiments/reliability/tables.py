"""Prints the tables of the pages of this folder (`experiments/reliability/*.md`)."""

import operator
from dataclasses import astuple, fields
from pathlib import Path

from combinations import DESIGNS, Combination

from dune_rl.core.files import read_csv

_COMPARED = ("again", "scenes", "restored")
_COUNTS = ("steps", *_COMPARED, *(f"{name}_of" for name in _COMPARED))
# Of a run of kills.py.
_TOTAL_FRAMES = 3072
_OF_STRANGERS = ("mutants", "attacks", "accepted", "refused", "defects")
# Of the segments that compare rounds.
_FEW_SCENES = 8
_SUMS = ("steps", "episodes", "cpu_s", "nan", "fallen", "diverged")


def determinism_table(folder: Path) -> str:
    """A Markdown table with a row for each design that was driven."""
    lines = [
        "| design | combinations | no room in their world | driven in `flat` instead | steps "
        "| differ in the same process | in another one, three scenes | after a restored state |",
        "|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for design in DESIGNS:
        rows = read_csv(folder / f"determinism_{design}.csv")
        total = {name: sum(int(row[name]) for row in rows) for name in _COUNTS}
        drawn = {astuple(each) for each in DESIGNS[design]()}
        is_drawn = [tuple(row[each.name] for each in fields(Combination)) in drawn for row in rows]
        has_fault = [bool(row["fault"]) for row in rows]
        cells = [f"{sum(is_drawn)} of {len(drawn)}"]
        cells += [sum(map(operator.and_, is_drawn, has_fault)), sum(map(operator.not_, is_drawn))]
        cells += [f"{total['steps']:,}"]
        cells += [f"{total[name]} of {total[name + '_of']:,}" for name in _COMPARED]
        if rows:
            lines.append(f"| `{design}` | {' | '.join(map(str, cells))} |")
    return "\n".join(lines)


def evaluations_table(folder: Path) -> str:
    """A Markdown table with a row for each evaluation of the same policies on the same set."""
    lines = [
        "| `processes` | nodes | CPUs for it | rows | minutes | SHA-256 of `episodes.csv` |",
        "|---|---:|---:|---:|---:|---|",
    ]
    for row in read_csv(folder / "evaluations.csv"):
        cells = [f"`{row['processes']}`", row["nodes"], row["cpus"], f"{int(row['rows']):,}"]
        cells += [f"{int(row['seconds']) / 60:.0f}", f"`{row['sha256'][:12]}`"]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def soak_table(folder: Path) -> str:
    """A Markdown table with a row for each segment."""
    rows = read_csv(folder / "soak.csv")
    lines = [
        "| segment | turns | refused | steps | episodes | memory after a tenth, or the first turn "
        "| at the end | open files | child processes "
        "| not finite | below the ground | diverged | steps per s of processor time |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for number in dict.fromkeys(row["segment"] for row in rows):
        own = [row for row in rows if row["segment"] == number]
        total = {name: sum(float(row[name]) for row in own) for name in _SUMS}
        held = [float(row["held_mib"] or row["rss_mib"]) for row in own]
        cells = [f"{number}, {own[0]['engine']}", len(own), sum(bool(row["fault"]) for row in own)]
        cells += [f"{total['steps']:,.0f}", f"{total['episodes']:,.0f}"]
        cells += [f"{held[len(held) // 10]:.0f} MiB", f"{held[-1]:.0f} MiB"]
        cells += [_range(own, "files"), _range(own, "processes")]
        cells += [f"{total[name]:.0f}" for name in ("nan", "fallen", "diverged")]
        cells += [f"{total['steps'] / max(total['cpu_s'], 1e-9):.0f}"]
        lines.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join(lines)


def kills_table(folder: Path) -> str:
    """A Markdown table with a row for each way in which runs were ended.

    A run ends "as the unbroken one" with code 0, its weights, metrics, curve and policies bit for bit, and
    neither a file too many nor one too few.
    """
    lines = [
        "| ended by | exit code | runs | before the first save | amid a file "
        "| longest time to the exit | went on from the save | had come to its end | as the unbroken one |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    rows = read_csv(folder / "kills.csv")
    for ending in dict.fromkeys(row["ending"] for row in rows):
        own = [row for row in rows if row["ending"] == ending]
        codes = " or ".join(dict.fromkeys(row["exit_code"] for row in own))
        cells: list[object] = [codes, len(own), sum(row["saved_frames"] == "0" for row in own)]
        cells += [sum(bool(row["temporary"]) for row in own)]
        cells += [
            f"{max(float(row['took_s']) for row in own):.1f} s",
            sum(0 < int(row["saved_frames"]) == int(row["resumed_at"]) < _TOTAL_FRAMES for row in own),
            sum(int(row["saved_frames"]) == _TOTAL_FRAMES for row in own),
            sum(_is_as_unbroken(row) for row in own),
        ]
        lines.append(f"| {ending} | {' | '.join(map(str, cells))} |")
    return "\n".join(lines)


def _is_as_unbroken(row: dict[str, str]) -> bool:
    is_equal = all(row[name] == "1" for name in ("weights_equal", "metrics_equal", "files_equal"))
    return row["resumed"] == "0" and is_equal and not row["left"] and not row["missing"]


def faults_table(folder: Path) -> str:
    """A Markdown table with a row for each fault."""
    lines = [
        "| fault | exit code | seconds from the fault to the end | last line | called again |",
        "|---|---:|---:|---|---|",
    ]
    for row in read_csv(folder / "faults.csv"):
        again = {"": "", "0": "goes on to its end"}.get(row["resumed"], f"exit code {row['resumed']}")
        said = f"`{row['said']}`" if row["said"] else ""
        # What went on had the rest of its training before it.
        after_s = row["after_s"] if row["exit_code"] != "0" else ""
        lines.append(f"| {row['fault']} | {row['exit_code']} | {after_s} | {said} | {again} |")
    return "\n".join(lines)


def strangers_table(folder: Path) -> str:
    """A Markdown table with a row for each format, and one of all."""
    lines = [
        "| format | damaged files | of them attacks | accepted | refused | defects | slowest | most memory |",
        "|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    rows = read_csv(folder / "strangers.csv")
    for row in rows:
        cells = [f"{int(row[name]):,}" for name in _OF_STRANGERS]
        cells += [f"{row['most_s']} s", f"{row['most_mib']} MiB"]
        lines.append(f"| {row['format'].replace('_', ' ')} | {' | '.join(cells)} |")
    sums = [f"{sum(int(row[name]) for row in rows):,}" for name in _OF_STRANGERS]
    lines.append(f"| **all** | {' | '.join(sums)} | | |")
    return "\n".join(lines)


def rounds_table(folder: Path) -> str:
    """A Markdown table of the memory in each round of few scenes [MiB], with a column for each segment.

    It is that after the round's first turn, which all rounds have alike, and in brackets the mean of a
    complete round. The last rows have the means of the second tenth of the turns and of the last fifth.
    """
    rows = [row for row in read_csv(folder / "soak.csv") if int(row["scenes"]) == _FEW_SCENES]
    held: dict[str, dict[int, list[float]]] = {}
    for row in rows:
        title = f"{row['segment']}, {row['engine']} ({row['commit'][:8]})"
        held.setdefault(title, {}).setdefault(int(row["round"]), []).append(float(row["held_mib"]))
    whole = max(len(turns) for segment in held.values() for turns in segment.values())
    lines = [f"| round | {' | '.join(held)} |", f"|---|{'---:|' * len(held)}"]
    for number in range(1 + max(int(row["round"]) for row in rows)):
        cells = []
        for segment in held.values():
            turns = segment.get(number, [])
            mean = f" ({sum(turns) / len(turns):.0f})" if len(turns) == whole else ""
            cells.append(f"{turns[0]:.0f}{mean}" if turns else "")
        lines.append(f"| {number + 1} | {' | '.join(cells)} |")
    means: list[tuple[float, float] | None] = []
    for segment in held.values():
        turns = [each for number in segment.values() for each in number]
        tenth = len(turns) // 10
        # Of fewer rounds, the second tenth is of the first one, which loads everything.
        is_long = tenth >= whole
        late = sum(turns[-2 * tenth :]) / (2 * tenth)
        means.append((sum(turns[tenth : 2 * tenth]) / tenth, late) if is_long else None)
    for title, text in (
        ("second tenth of the turns", "{0:.0f}"),
        ("last fifth", "{1:.0f}"),
        ("growth", "{2:+.1f} %"),
    ):
        cells = [text.format(*pair, 100 * (pair[1] / pair[0] - 1)) if pair else "" for pair in means]
        lines.append(f"| {title} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _range(rows: list[dict[str, str]], name: str) -> str:
    numbers = [int(row[name]) for row in rows]
    return f"{min(numbers)} to {max(numbers)}" if min(numbers) < max(numbers) else str(numbers[0])


if __name__ == "__main__":
    folder = Path(__file__).parent
    tables = (
        determinism_table,
        evaluations_table,
        soak_table,
        rounds_table,
        kills_table,
        faults_table,
        strangers_table,
    )
    print(*(make(folder) for make in tables), sep="\n\n")
