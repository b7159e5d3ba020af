"""Episodes on a live page: their driver, resets, and driving by hand."""

import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase

from dune_rl.config.commands import BUILT_IN_POLICIES
from dune_rl.core.errors import ConfigError
from dune_rl.env.live.panel import STATE_ORDER
from dune_rl.env.live.view import LivePage
from dune_rl.evaluation.policies import checkpoint_name
from dune_rl.learning.group_policy import Policy
from dune_rl.reporting.views.episode import EpisodeView

BY_HAND = "by hand"
_NAP_S = 0.005
# The end of an episode is shown this long before the next one begins.
_END_S = 2.0
# A key changes an action by this share of its range.
_KEY_SHARE = 1 / 16
# Keys of driving: they leave those to viser that move its camera.
_KEYS = {"I": (0, 1), "K": (0, -1), "J": (1, 1), "L": (1, -1)}
_NAMES = ("speed [m/s]", "turn [rad]", "climb [m/s]")


class HandDriver:
    """Actions of one agent by hand; other agents stand still. `action` (A,) is in physical units."""

    def __init__(self, view: EpisodeView) -> None:
        self._view = view
        self.low, self.high = view.group.action_bounds
        self.rest = view.group.rest_action.astype(np.float32)
        self.action = self.rest.copy()

    def __call__(self, observation: TensorDictBase) -> TensorDictBase:
        view = self._view
        for group in view.simulation.external:
            actions = np.tile(group.rest_action.astype(np.float32), (1, group.count, 1))
            if group is view.group:
                actions[0, view.row] = self.action
            observation.set((group.name, "action"), torch.from_numpy(actions))
        return observation


class LiveSession:
    """Runs episodes of `view` on a `page`, one after another, as its controls say. `url` is its address.

    `driver` is the name of what drives: a built-in policy, the checkpoint, or a hand on the page.
    """

    def __init__(self, view: EpisodeView) -> None:
        conf = self._conf = view.conf
        self.view = view
        self._hand = HandDriver(view)
        self._trained = f"checkpoint {checkpoint_name(Path(conf.checkpoint))}" if conf.checkpoint else None
        self.driver = self._trained or conf.policy or "go_to_goal"
        # Before there is a page: it may not fit.
        self._policy: Policy | None = self._load(self.driver)
        self.page = LivePage(
            view.simulation,
            view.group,
            view.row,
            host=conf.host,
            port=conf.port,
            title=f"{conf.world.name} - dune_rl",
        )
        self.url = self.page.url
        self._seed, self._episode = conf.seed, conf.episode
        self._requests: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._steps: Iterator[bool] = iter(())
        self._ticks_left, self._is_done = 0, False
        self._add_controls()

    # -- the page's controls ----------------------------------------------------------------------

    def _add_controls(self) -> None:
        gui, ask = self.page.server.gui, self._requests.put
        names = [*([self._trained] if self._trained else []), *BUILT_IN_POLICIES]
        if self.view.group.is_external:
            names.append(BY_HAND)
        with gui.add_folder("Episode", order=STATE_ORDER - 2):
            self.drivers = gui.add_dropdown("Driver", names, initial_value=self.driver)
            self.drivers.on_update(lambda _: ask(lambda: self.choose(self.drivers.value)))
            # A set has one seed, and the settings are those of one of its episodes.
            is_free = self._conf.set is None
            most = max(self._seed, 2**31 - 1)
            self.seed_input = gui.add_number(
                "Seed", self._seed, min=0, max=most, step=1, disabled=not is_free
            )
            reset = gui.add_button("Reset")
            reset.on_click(lambda _: ask(self.reset))
            if is_free:
                following = gui.add_button("Next episode")
                following.on_click(lambda _: ask(self.begin_next))
        self.page.panel.add_key("Reset", "R", partial(ask, self.reset))
        if not self.view.group.is_external:
            return
        with gui.add_folder("Drive by hand", order=STATE_ORDER - 1, expand_by_default=False):
            gui.add_markdown("Keys: **I** faster, **K** slower, **J** left, **L** right, **O** stop")
            self._sliders = [self._add_slider(gui, part) for part in range(len(self._hand.action))]
        for key, (part, sign) in _KEYS.items():
            if part < len(self._sliders):
                self.page.panel.add_key(f"Drive: {key}", key, partial(ask, partial(self.nudge, part, sign)))
        self.page.panel.add_key("Stop", "O", partial(ask, self.stop))

    def _add_slider(self, gui: Any, part: int) -> Any:
        low, high = float(self._hand.low[part]), float(self._hand.high[part])
        named = self.view.group.has_speed_and_heading or len(self._hand.action) == len(_NAMES)
        name = _NAMES[part] if named else f"action {part}"
        start = float(self._hand.action[part])
        slider = gui.add_slider(name, low, high, (high - low) / 200, start)
        slider.on_update(lambda event: self._requests.put(partial(self._slide, event)))
        return slider

    def _slide(self, event: Any) -> None:
        self._hand.action = np.array([slider.value for slider in self._sliders], np.float32)
        # What the program moves has no client.
        if event.client is not None:
            self._take_over()

    def nudge(self, part: int, sign: int) -> None:
        """Change an action of the agent by a key."""
        low, high = self._hand.low[part], self._hand.high[part]
        value = self._hand.action[part] + sign * _KEY_SHARE * (high - low)
        self._set_action(part, float(np.clip(value, low, high)))
        self._take_over()

    def stop(self) -> None:
        """Let the agent stand still."""
        for part, value in enumerate(self._hand.rest.tolist()):
            self._set_action(part, value)
        self._take_over()

    def _set_action(self, part: int, value: float) -> None:
        self._hand.action[part] = value
        self._sliders[part].value = value

    def _take_over(self) -> None:
        if self.driver != BY_HAND:
            self.drivers.value = BY_HAND
            self.choose(BY_HAND)

    def choose(self, name: str) -> None:
        """Let another driver drive; where it cannot, the page says why, and the last one goes on."""
        if name == self.driver:
            return
        try:
            self._policy = self._load(name)
        except ConfigError as error:
            self._say(f"{name} cannot drive here", str(error))
            self.drivers.value = self.driver
            return
        self.driver = name

    def _load(self, name: str) -> Policy:
        if name == BY_HAND:
            return self._hand
        return self.view.make_policy() if name == self._trained else self.view.load_policy(name)

    def _say(self, title: str, text: str) -> None:
        for client in self.page.server.get_clients().values():
            client.add_notification(title, text, color="red", auto_close_seconds=8.0)

    # -- episodes ---------------------------------------------------------------------------------

    def reset(self) -> None:
        """Begin the first episode of the seed on the page or, without a change of it, the present one."""
        seed = int(self.seed_input.value)
        if seed != self._seed:
            self._seed, self._episode = seed, 0
        self.begin()

    def begin_next(self) -> None:
        """Begin the next episode of the seed, or the same one of a set."""
        self._episode += self._conf.set is None
        self.begin()

    def begin(self) -> None:
        """Begin the present episode."""
        self._policy = None
        self._steps = self.view.run(self._seed, self._episode, self._drive)
        next(self._steps)
        self._is_done = False
        self.page.show(self._rows())

    def _drive(self, observation: TensorDictBase) -> TensorDictBase:
        if self._policy is None:
            self._policy = self._load(self.driver)
        return self._policy(observation)

    def _rows(self) -> list[tuple[str, str]]:
        of = f"seed {self._seed}" if self._conf.set is None else Path(self._conf.set).stem
        return [("episode", f"{self._episode} of {of}"), ("driver", self.driver)]

    def run(self, is_over: Callable[[], bool] = lambda: False) -> None:
        """Run episodes until `is_over`; time stands still while nobody looks."""
        step_s = 1.0 / self._conf.physics.decision_hz
        self.begin()
        while not is_over():
            while not self._requests.empty():
                self._requests.get()()
            if not self.page.is_watched or not self.page.playback.is_due(step_s):
                time.sleep(_NAP_S)
            elif not self._is_done:
                self.step()
            elif self._ticks_left and not self.page.playback.is_paused:
                self._ticks_left -= 1
            else:
                self.begin_next()

    def step(self) -> None:
        """Take a step of the episode."""
        self._is_done = next(self._steps)
        self.page.show(self._rows(), self.view.ending())
        self._ticks_left = round(_END_S * self._conf.physics.decision_hz * self.page.playback.speed)

    def close(self) -> None:
        """Close the page."""
        self.page.close()
