"""What a player has at hand: keys or a gamepad, switches for who associates and who finds a lost robot, a screen."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.drivers.base import ActionKind, Info, Observation
from agents.evaluation.associators import find_associator
from slam_gym.association import resolve_relocator
from slam_gym.association.prediction import Prediction
from slam_gym.slam.relocate import SEARCH
from slam_gym.types import UNPAIRED, Effort, Hypothesis, Landmarks, Locality, Relocation, Scan

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


class Switch:
    """An associator that is another one as soon as it is switched."""

    def __init__(self, names: Sequence[str]) -> None:
        self.names = list(dict.fromkeys(names))
        self._found = [find_associator(name) for name in self.names]
        self._at = 0

    @property
    def name(self) -> str:
        """Who associates now."""
        return self.names[self._at]

    def next(self) -> None:
        """On to the next one."""
        self._at = (self._at + 1) % len(self.names)

    def __call__(self, scan: Scan, prediction: Prediction) -> Hypothesis:
        return self._found[self._at](scan, prediction)


class SearchSwitch:
    """A search that finds nothing while it is off."""

    def __init__(self, name: str | None) -> None:
        self._search, self.on = resolve_relocator(name or SEARCH), name is not None

    def __call__(self, scan: Scan, landmarks: Landmarks, locality: Locality | None) -> Relocation:
        if self.on:
            return self._search(scan, landmarks, locality)
        nowhere = np.full(len(scan), UNPAIRED)
        return Relocation(nowhere, np.full(3, np.nan), np.full((3, 3), np.nan), 0.0, 0, 1, False, 0, Effort())


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
