"""Playing without a display: keys drive the robot, and end the game."""

import numpy as np
import pytest

from agents.evaluation.episodes import ExploreArguments
from agents.play import Keyboard, main, play

pygame = pytest.importorskip("pygame")


@pytest.fixture
def env(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = ExploreArguments("office-small", split="train").make("twist", render_mode="human")
    yield env
    env.close()


class Script(Keyboard):
    """A keyboard on which keys go down and up at given polls."""

    def __init__(self, *events):
        super().__init__()
        self._events = dict(events)
        self.actions = []
        self._polls = 0

    def poll(self):
        for kind, key in self._events.get(self._polls, ()):
            pygame.event.post(pygame.event.Event(kind, key=key))
        self._polls += 1
        return super().poll()

    def act(self, observation, info):
        self.actions.append(super().act(observation, info))
        return self.actions[-1]


DOWN, UP = pygame.KEYDOWN, pygame.KEYUP


def test_held_keys_drive_the_robot(env):
    keyboard = Script(
        (1, [(DOWN, pygame.K_UP)]), (3, [(DOWN, pygame.K_a)]), (5, [(UP, pygame.K_UP)]), (7, [(UP, pygame.K_a)])
    )
    assert play(env, keyboard, keyboard, 0, steps=8) == "quit"
    expected = [[0, 0], [1, 0], [1, 0], [1, 1], [1, 1], [0, 1], [0, 1], [0, 0]]
    np.testing.assert_array_equal(keyboard.actions, expected)
    assert np.hypot(*env.unwrapped.episode.slam.map.pose[:2]) > 0.05


@pytest.mark.parametrize(("key", "wish"), [(pygame.K_n, "next"), (pygame.K_r, "again"), (pygame.K_ESCAPE, "quit")])
def test_keys_end_the_world(env, key, wish):
    keyboard = Script((2, [(DOWN, key)]))
    assert play(env, keyboard, keyboard, 0, steps=50) == wish
    assert len(keyboard.actions) == 2


def test_closing_the_window_ends_the_game(env):
    keyboard = Script((1, [(pygame.QUIT, 0)]))
    assert play(env, keyboard, keyboard, 0, steps=50) == "quit"


class Spinner:
    name, action = "spinner", "twist"

    def reset(self, seed):
        pass

    def act(self, observation, info):
        return np.array([0.0, 1.0], np.float32)


def test_an_agent_is_watched(monkeypatch, capsys):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    assert main(["--scenario", "office-small", "--agent", f"{__name__}:Spinner", "--steps", "3"]) == 0
    said = capsys.readouterr().out
    assert "spinner" in said and "no display" in said
