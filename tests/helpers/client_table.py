"""The table of clients in `docs/how_to/clients.md`: rows from the marks of tests, results from running them.

`pytest.mark.client(CLIENT, PURPOSE, INTERFACE)` makes a row. To write the table anew:
`python -m pytest tests/clients --clients-table docs/how_to/clients.md`
"""

import ast
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

BEGIN, END = "<!-- clients: begin -->", "<!-- clients: end -->"
PASSED = "passes"

# The clients, in the table's order, and their distributions.
CLIENTS = {
    "Gymnasium": "gymnasium",
    "PettingZoo": "pettingzoo",
    "TorchRL": "torchrl",
    "Stable-Baselines3": "stable_baselines3",
    "SuperSuit": "SuperSuit",
    "BenchMARL": "benchmarl",
    "MoviePy": "moviepy",
    "viser": "viser",
    "Hydra: joblib": "hydra-joblib-launcher",
    "Hydra: submitit": "hydra-submitit-launcher",
    "Hydra: Ray": "hydra-ray-launcher",
    "Hydra: Optuna": "hydra-optuna-sweeper",
}


@dataclass(frozen=True)
class Row:
    """What is done with a client, and by which interface of ours."""

    client: str
    purpose: str
    interface: str


def installed_version(client: str) -> str | None:
    """Version of a client; None where it is not installed."""
    try:
        return version(CLIENTS[client])
    except PackageNotFoundError:
        return None


def marked_rows(folder: Path) -> list[Row]:
    """The rows of all tests in a folder, in the table's order."""
    rows = []
    for path in sorted(folder.glob("test_*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "pytest.mark.client":
                rows.append((node.lineno, path, Row(*(ast.literal_eval(each) for each in node.args))))
    return _in_order(row for *_, row in sorted(rows, key=lambda each: (each[1], each[0])))


def _in_order(rows: Iterable[Row]) -> list[Row]:
    return sorted(dict.fromkeys(rows), key=lambda row: list(CLIENTS).index(row.client))


def write_table(path: Path, results: Mapping[Row, str], folder: Path) -> None:
    """Write new results into the table between the two comments of a Markdown file.

    Rows of tests in `folder` that were not run stay as they are; those without a test go.
    """
    found = read_table(path) | {
        row: (installed_version(row.client) or "none", result) for row, result in results.items()
    }
    lines = ["| client | version | what is done | by | result |", "|---|---|---|---|---|"]
    for row in marked_rows(folder):
        if row in found:
            used, result = found[row]
            lines.append(f"| {row.client} | {used} | {row.purpose} | `{row.interface}` | {result} |")
    before, rest = path.read_text().split(BEGIN)
    after = rest.split(END)[1]
    path.write_text("\n".join([before + BEGIN, *lines, END + after]))


def read_table(path: Path) -> dict[Row, tuple[str, str]]:
    """Version and result of each row of a written table."""
    inside = path.read_text().split(BEGIN)[1].split(END)[0]
    lines = [line for line in inside.splitlines() if line.startswith("| ")][1:]
    cells = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]
    return {
        Row(client, purpose, interface.strip("`")): (used, result)
        for client, used, purpose, interface, result in cells
    }
