"""Prints the table of the datasets (`experiments/datasets/README.md`)."""

from pathlib import Path

from dune_rl.core.files import read_csv


def datasets_table(folder: Path) -> str:
    """A Markdown table with a row for each dataset."""
    lines = [
        "| dataset | driver | episodes | transitions | successful | MiB | SHA-256 of its arrays |",
        "|---|---|---:|---:|---:|---:|---|",
    ]
    for row in read_csv(folder / "datasets.csv"):
        cells = [f"`{row['dataset']}`", f"`{row['driver']}`", row["episodes"], f"{int(row['transitions']):,}"]
        cells += [f"{100 * float(row['success']):.1f} %", row["mib"], f"`{row['sha256'][:12]}`"]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    print(datasets_table(Path(__file__).parent))
