"""Playing without a display: keys drive the robot, switch what helps it, and end the game."""

from collections import deque

import numpy as np
import pytest

from agents.evaluation.episodes import ExploreArguments
from agents.play import Controls, Game, app, play
from tests.agents import typed

pygame = pytest.importorskip("pygame")
DOWN, UP = pygame.KEYDOWN, pygame.KEYUP


class Script(Controls):
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


@pytest.fixture
def play_with():
    """Play a script for some steps: the wish that ended it, the game and its environment."""
    open_now = []

    def run(controls, steps, budget=300):
        arguments = ExploreArguments("office-small", (("budget", budget),), split="train")
        game = Game(arguments, controls, controls, deque(["jcbb", "nearest_neighbour"]), relocating=True)
        env = game.make()
        open_now.append(env)
        return play(game, env, 0, steps), game, env

    yield run
    for each in open_now:
        each.close()


def test_held_keys_drive_the_robot(play_with):
    controls = Script(
        (1, [(DOWN, pygame.K_UP)]), (3, [(DOWN, pygame.K_a)]), (5, [(UP, pygame.K_UP)]), (7, [(UP, pygame.K_a)]),
        (8, [(DOWN, pygame.K_r)]),
    )  # fmt: skip
    wish, _, env = play_with(controls, 50)
    expected = [[0, 0], [1, 0], [1, 0], [1, 1], [1, 1], [0, 1], [0, 1], [0, 0]]
    assert wish == "again"
    np.testing.assert_array_equal(controls.actions, expected)
    assert np.hypot(*env.unwrapped.episode.slam.map.pose[:2]) > 0.05


def test_associator_and_relocation_are_switched_while_the_robot_drives(play_with):
    controls = Script((2, [(DOWN, pygame.K_c)]), (3, [(DOWN, pygame.K_l)]))
    wish, game, env = play_with(controls, 6)
    assert wish == "quit" and game.associators[0] == "nearest_neighbour" and not game.relocating
    assert "nearest_neighbour, relocation off" in pygame.display.get_caption()[0]
    assert len(controls.actions) == 6 == env.unwrapped.episode.ticks


def test_at_the_end_the_player_is_held_against_information_gain(play_with, capsys):
    wish, game, env = play_with(Script((9, [(DOWN, pygame.K_n)])), 50, budget=5)
    said = capsys.readouterr().out
    assert wish == "next" and "world 0: map error" in said and f"information gain {game.rivals[0]:.3f}:" in said
    own = env.unwrapped.episode.map_error()
    assert ("it beat you" if own > game.rivals[0] else "you beat it" if own < game.rivals[0] else "a draw") in said


class Spinner:
    name, action = "spinner", "twist"

    def reset(self, seed):
        pass

    def act(self, observation, info):
        return np.array([0.0, 1.0], np.float32)


def test_an_agent_is_watched():
    line = ["--scenario", "office-small", "--associator", "true_association", "--steps", "3"]
    result = typed(app, *line, "--agent", f"{__name__}:Spinner")
    assert result.exit_code == 0 and "spinner" in result.output and "no display" in result.output
