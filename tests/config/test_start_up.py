"""What the command lines load before they have to."""

import subprocess
import sys

import pytest

_HEAVY = (
    *("torch", "torchrl", "tensordict", "trimesh", "scipy", "numba", "pybullet", "matplotlib", "pydantic"),
    # `scipy` alone is light: it loads its parts when they are used.
    *(
        "scipy.ndimage",
        "scipy.special",
        "scipy.interpolate",
        "scipy.spatial",
        "scipy.optimize",
        "scipy.sparse",
    ),
)


def loaded_packages(code: str) -> set[str]:
    """Those of the heavy packages that a new process has loaded after `code`."""
    report = f"import sys; print('loaded:', *[name for name in {_HEAVY!r} if name in sys.modules])"
    wrapped = f"import atexit; atexit.register(lambda: exec({report!r})); {code}"
    ran = subprocess.run([sys.executable, "-c", wrapped], capture_output=True, text=True, check=False)
    last = ran.stdout.splitlines()[-1]
    assert last.startswith("loaded:"), ran.stderr
    return set(last.split()[1:])


@pytest.mark.slow(all_but=["train", "report"])
@pytest.mark.parametrize(
    "module",
    [
        "train",
        "evaluate",
        "drive",
        "export",
        "forecast",
        "report",
        "view",
        "benchmark",
        "engines",
        "trajectory",
    ],
)
def test_help_loads_none_of_the_heavy_packages(module: str) -> None:
    code = f"import sys; sys.argv = ['x', '--help']; from dune_rl.{module} import main; main()"
    assert loaded_packages(code) == set()


def test_a_misspelt_key_is_found_without_packages_that_simulate_or_learn() -> None:
    words = ["x", "+world=flat", "total_frame=1", "actors=walkers"]
    heavy = loaded_packages(f"import sys; from dune_rl.train import main; sys.argv = {words}; main()")
    assert "pydantic" in heavy
    assert heavy <= {"pydantic", "scipy", "numba"}


def test_a_misspelt_world_is_found_without_the_settings() -> None:
    code = "import sys; from dune_rl.train import main; sys.argv = ['x', '+world=inspektion']; main()"
    assert not loaded_packages(code)


@pytest.mark.slow
@pytest.mark.parametrize("words", [["nothing"], ["tests", "out=docs"]])
def test_wrong_folders_of_a_report_are_found_without_packages_that_draw(words: list[str]) -> None:
    code = f"import sys; from dune_rl.report import main; sys.argv = {['x', *words]}; main()"
    assert loaded_packages(code) <= {"pydantic"}
