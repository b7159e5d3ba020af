"""The figures that the DUnE paper publishes, which reports show beside ours."""

from collections.abc import Mapping

SOURCE = "Vice & Sukthankar 2025, Rover Zero with SAC"
NAME = "DUnE paper"
CAVEAT = (
    "The paper's figures come from another simulator, robot model and metrics code, without intervals: they "
    "give the order of size, not a ranking."
)

# By world and measure, as the paper states them. Its TC is a total over an evaluation of 10 minutes.
PAPER_FIGURES: Mapping[str, Mapping[str, str]] = {
    "flat": {"SR": "100", "TC": "0 in all", "VORT": "0.78", "TSR": "12.82"},
    "inspection": {"SR": "75", "TC": "52 in all", "VORT": "0.44", "TSR": "12.43"},
    "island": {"SR": "73", "TC": "0 in all", "VORT": "0.61", "TSR": "14.46"},
}
