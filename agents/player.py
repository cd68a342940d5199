"""What a player has at hand: keys or a gamepad, and a screen."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.drivers.base import ActionKind, Info, Observation

WISHES = {"quit": "K_ESCAPE", "next": "K_n", "again": "K_r", "associator": "K_c", "relocation": "K_l"}
"""What can be asked for, and its key, as pygame calls it."""

_IDLE = 0.15  # of a gamepad's stick: less is its rest position
_BAR, _INK, _PALE = (28, 32, 38), (240, 240, 240), (170, 178, 188)
_LINE = 18  # [pixels]


class Controls:
    """The human's hands: which keys are down or where the sticks are, and what they ask for."""

    name = "you"
    action: ActionKind = "twist"

    def __init__(self) -> None:
        import pygame  # extra `render`; the window delivers the keys

        self._pygame = pygame
        self._keys = {
            "forward": (pygame.K_UP, pygame.K_w), "backward": (pygame.K_DOWN, pygame.K_s),
            "left": (pygame.K_LEFT, pygame.K_a), "right": (pygame.K_RIGHT, pygame.K_d),
        }  # fmt: skip
        self._wishes = {getattr(pygame, key): wish for wish, key in WISHES.items()}
        self._down: set[int] = set()
        self._sticks: dict[int, float] = {}
        self._pads: list[Any] = []

    def reset(self, seed: int) -> None:
        self._down.clear()
        self._sticks.clear()

    def act(self, observation: Observation, info: Info) -> NDArray[np.float32]:
        held = {name: bool(self._down.intersection(keys)) for name, keys in self._keys.items()}
        forward, turn = float(held["forward"] - held["backward"]), float(held["left"] - held["right"])
        return np.clip([forward - self._stick(1), turn - self._stick(0)], -1.0, 1.0).astype(np.float32)

    def poll(self) -> str | None:
        """Take in what happened since the last call; one of `WISHES` where that was asked for."""
        pygame, wish = self._pygame, None
        for event in pygame.event.get():
            if event.type == pygame.QUIT:
                return "quit"
            if event.type == pygame.KEYDOWN:
                self._down.add(event.key)
                wish = self._wishes.get(event.key, wish)
            elif event.type == pygame.KEYUP:
                self._down.discard(event.key)
            elif event.type == pygame.JOYDEVICEADDED:
                self._pads.append(pygame.joystick.Joystick(event.device_index))
            elif event.type == pygame.JOYAXISMOTION:
                self._sticks[event.axis] = event.value
        return wish

    def _stick(self, axis: int) -> float:
        """Where a stick is, in [−1, 1]: right and down are positive."""
        value = self._sticks.get(axis, 0.0)
        return value if abs(value) > _IDLE else 0.0


class Screen:
    """The environment's picture, and lines of text below it, in a window of any size."""

    def __init__(self, fps: float) -> None:
        from slam_gym.rendering.canvas import Window  # extra `render`

        self.window = Window("slam_gym", fps, resizable=True)

    def show(self, pixels: NDArray[np.uint8], lines: Sequence[str]) -> None:
        """Show a picture (h, w, 3); the last line is pale."""
        from slam_gym.rendering.canvas import pygame, text

        height, width, _ = pixels.shape
        surface = pygame.Surface((width, height + _LINE * (len(lines) + 1)), depth=32)
        surface.fill(_BAR)
        surface.blit(pygame.image.frombuffer(pixels.tobytes(), (width, height), "RGB"), (0, 0))
        for k, line in enumerate(lines):
            colour = _PALE if k == len(lines) - 1 else _INK
            surface.blit(text(line, 13, colour), (_LINE // 2, height + _LINE // 2 + k * _LINE))
        self.window.show(surface)
