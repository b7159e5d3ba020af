"""The render modes of environments, and the window of `render_mode="human"`."""

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from dune_rl.core.errors import ConfigError

RenderMode = Literal["human", "rgb_array"] | None


def check_render_mode(mode: str | None, modes: Sequence[str]) -> None:
    """Raise ConfigError unless `mode` is None or one of `modes`."""
    if mode is not None and mode not in modes:
        raise ConfigError(f"render_mode must be {', '.join(map(repr, modes))} or None (got {mode!r})")


class Window:
    """Shows RGB pictures (H, W, 3), at most `fps` in a second; it opens with the first one.

    Raises ConfigError if pygame, which draws it, is not installed.
    """

    def __init__(self, title: str, fps: int) -> None:
        try:
            import pygame
        except ModuleNotFoundError as error:
            raise ConfigError(
                "render_mode='human' needs pygame: pip install pygame, or take render_mode='rgb_array'"
            ) from error
        self._pygame: Any = pygame
        self._title, self._fps = title, fps
        self._surface: Any = None
        self._clock: Any = None

    def show(self, picture: NDArray[np.uint8]) -> None:
        """Show a picture."""
        pygame = self._pygame
        if self._surface is None:
            pygame.display.init()
            pygame.display.set_caption(self._title)
            self._surface = pygame.display.set_mode(picture.shape[1::-1])
            self._clock = pygame.time.Clock()
        self._surface.blit(pygame.surfarray.make_surface(picture.swapaxes(0, 1)), (0, 0))
        # The system takes a window that answers no events for one that hangs.
        pygame.event.pump()
        pygame.display.flip()
        self._clock.tick(self._fps)

    def close(self) -> None:
        """Close the window, if it is open."""
        if self._surface is not None:
            self._pygame.display.quit()
            self._surface = None
