"""Prints the table of this folder's page."""

from pathlib import Path

from dune_rl.core.files import read_csv


def scaling_table(folder: Path) -> str:
    """A Markdown table with a row for each training, and the workers at which its driver is always busy."""
    lines = [
        "| training | workers | frames/s | driver, µs a frame | workers, µs a frame | driver's share "
        "| workers that keep a driver busy | driver | a worker |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for row in read_csv(folder / "scaling.csv"):
        driver, worker = float(row["driver_us"]), float(row["worker_us"])
        cells = [f"`{row['training']}`", row["workers"], f"{float(row['frames_per_s']):.0f}"]
        cells += [f"{driver:.0f}", f"{worker:.0f}", f"{100 * driver / (driver + worker):.0f} %"]
        cells += [f"{worker / driver:.1f}"]
        cells += [f"{float(row[name]):.0f} MiB" for name in ("driver_mib", "worker_mib")]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    print(scaling_table(Path(__file__).parent))
