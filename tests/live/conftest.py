"""A browser without a screen, and settings of small live views."""

import random
import shutil
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from dune_rl.config.commands import ViewConf
from dune_rl.config.compose import compose
from dune_rl.core.errors import ConfigError
from dune_rl.rendering.web.server import free_port, require_viser

_BROWSERS = ("chromium", "chromium-browser", "google-chrome")
# Drawn by the processor, where a machine may have no display and no GPU.
_ARGUMENTS = ("--no-sandbox", "--enable-unsafe-swiftshader", "--use-gl=angle", "--use-angle=swiftshader")


@pytest.fixture(name="_viser")
def _needs_viser() -> None:
    try:
        require_viser("this test")
    except ConfigError as error:
        pytest.skip(str(error))


@pytest.fixture
def conf_of(_viser: None) -> Callable[..., ViewConf]:
    """Settings of a view with few sensors, on a port that is free."""

    def make(*words: str) -> ViewConf:
        # Tests beside this one hardly look for theirs from the same port on.
        port = free_port(first=random.SystemRandom().randrange(8_400, 32_000))
        few = ("+world=flat", "sensors=[lidar,goal]", "actors=none", f"port={port}")
        return compose(ViewConf, [*few, *words])

    return make


@pytest.fixture
def browser() -> Iterator[Any]:
    """Chromium under Playwright; the test is skipped where either is missing."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    program = next((path for name in _BROWSERS if (path := shutil.which(name))), None)
    if program is None:
        pytest.skip("no Chromium is installed")
    with playwright.sync_playwright() as running:
        found = running.chromium.launch(executable_path=program, args=list(_ARGUMENTS))
        yield found
        found.close()
