"""Folders of sweeps with characters that mean something to Hydra."""

from collections.abc import Callable

import pytest

from dune_rl import train


@pytest.mark.slow(all_but=["hydra.sweep.dir=runs/${nope}"])
@pytest.mark.parametrize(
    "word", ["hydra.sweep.dir=runs/${nope}", 'hydra.sweep.dir="runs/${x"', "hydra.sweep.dir=a,b"]
)
def test_a_folder_that_hydra_cannot_read_is_named(
    word: str, call: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(train.main, "-m", "+world=flat", word, "seed=1,2") == 2
    told = capsys.readouterr().err
    assert told.startswith("hydra.sweep.dir=") and "quote a value" in told and r"write \${ for ${" in told
