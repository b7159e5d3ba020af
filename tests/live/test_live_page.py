"""The live page in a browser: it is drawn, and its buttons, keys and menus do what they say."""

import io
import threading
from collections.abc import Callable, Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest
from PIL import Image

from dune_rl.config.commands import ViewConf
from dune_rl.reporting.views.episode import EpisodeView
from dune_rl.reporting.views.live import BY_HAND, LiveSession

pytestmark = pytest.mark.slow

ConfOf = Callable[..., ViewConf]
# A browser without a GPU, on a machine with other work, may take this long.
PATIENCE_MS = 240_000


class Page:
    """A page of the browser, and what its console says."""

    def __init__(self, browser: Any) -> None:
        self.tab = browser.new_page(viewport={"width": 820, "height": 480})
        self.tab.set_default_timeout(PATIENCE_MS)
        self.errors: list[str] = []
        self.tab.on("pageerror", lambda error: self.errors.append(str(error)))
        self.tab.on(
            "console", lambda message: self.errors.append(message.text) if message.type == "error" else None
        )

    def wait_for(self, text: str) -> None:
        """Wait until a text stands on the page."""
        self.tab.get_by_text(text, exact=True).first.wait_for()

    def row(self, name: str) -> str:
        """The value of a row of the state's table."""
        return str(self.tab.locator(f"tr:has(td:text-is('{name}')) td").nth(1).inner_text())

    def wait_for_row(self, name: str, accepts: Callable[[str], bool]) -> str:
        """The value of a row once it is accepted."""
        for _ in range(PATIENCE_MS // 200):
            value = self.row(name)
            if accepts(value):
                return value
            self.tab.wait_for_timeout(200)
        raise AssertionError(f"{name} stayed at {value}")

    def click(self, button: str) -> None:
        self.tab.get_by_role("button", name=button, exact=True).click()

    def scene(self) -> np.ndarray:
        """The scene's pixels (rows, columns, 3), left of the panel."""
        png = self.tab.screenshot(timeout=PATIENCE_MS)
        picture = Image.open(io.BytesIO(png)).convert("RGB")
        return np.asarray(picture.crop((0, 170, 440, 480)), int)

    def wait_until_drawn(self) -> np.ndarray:
        """The scene once it has many colours."""
        for _ in range(60):
            scene = self.scene()
            if len(np.unique(scene.reshape(-1, 3), axis=0)) > 500 and scene.std() > 15.0:
                return scene
            self.tab.wait_for_timeout(1_000)
        raise AssertionError("the scene stayed blank")


@pytest.fixture(name="page")
def _page(browser: Any) -> Page:
    return Page(browser)


@pytest.fixture(name="session")
def _session(conf_of: ConfOf) -> Iterator[LiveSession]:
    view = EpisodeView(conf_of("policy=go_to_goal", "seed=4"))
    session = LiveSession(view)
    # Most of the time is the browser's, where it draws without a GPU.
    session.page.playback.speed = 0.1
    over = threading.Event()
    runner = threading.Thread(target=session.run, args=(over.is_set,), daemon=True)
    runner.start()
    yield session
    over.set()
    runner.join()
    session.close()
    view.close()


def test_the_page_is_drawn_and_its_controls_work(page: Page, session: LiveSession) -> None:
    page.tab.goto(session.url)
    page.wait_for("Pause")
    page.click("Pause")
    page.wait_for("Go on")
    before = page.wait_until_drawn()
    paused = float(page.row("time").split()[0])
    page.click("Step")
    page.click("Step")
    # Two steps are 0.1 s.
    page.wait_for_row("time", lambda value: float(value.split()[0]) > paused + 0.09)
    page.tab.get_by_label("Seed").fill("7")
    page.tab.get_by_label("Seed").press("Enter")
    page.click("Reset")
    page.wait_for_row("episode", lambda value: value == "0 of seed 7")
    assert page.row("time") == "0.00 s"
    page.click("Next episode")
    page.wait_for_row("episode", lambda value: value == "1 of seed 7")
    after = page.wait_until_drawn()
    assert np.abs(after - before).mean() > 2.0
    page.tab.get_by_label("Driver").click()
    page.tab.get_by_role("option", name="random", exact=True).click()
    page.click("Step")
    page.wait_for_row("driver", lambda value: value == "random")
    assert session.driver == "random"
    page.click("Faster")
    page.click("Step")
    page.wait_for_row("time runs at", lambda value: value == "0.25 x real time")
    page.tab.mouse.click(200, 300)
    for _ in range(6):
        page.tab.keyboard.press("i")
    page.click("Step")
    page.wait_for_row("driver", lambda value: value == BY_HAND)
    page.click("Go on")
    page.wait_for_row("speed", lambda value: float(value.split()[0]) > 0.3)
    page.tab.get_by_text("Metrics", exact=True).first.click()
    assert float(page.wait_for_row("min_clearance", lambda value: value != "-")) > 0.0
    assert page.tab.locator(".uplot").count() == 2
    assert not page.errors


def test_a_gymnasium_environment_opens_a_page(_viser: None, page: Page) -> None:
    env = gymnasium.make("dune_rl:dune_rl/Flat-v0", render_mode="human", actors="none")
    env.reset(seed=4)
    page.tab.goto(env.unwrapped.page.url)
    page.wait_for("Pause")
    for _ in range(5):
        env.step(np.array([0.5, 0.0], np.float32))
    assert env.render() is None
    env.unwrapped.page.playback.step_once()
    env.step(np.array([0.5, 0.0], np.float32))
    page.wait_until_drawn()
    page.wait_for_row("time", lambda value: value == "0.30 s")
    env.close()
    assert not page.errors
