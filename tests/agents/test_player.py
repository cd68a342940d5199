"""Keys, sticks, switches and the screen, without a display."""

import numpy as np
import pytest

from agents.player import WISHES, Controls, Screen, SearchSwitch, Switch
from slam_gym.association import jcbb, nearest_neighbour
from slam_gym.slam.slam import Slam
from slam_gym.types import UNPAIRED, Odometry, Scan
from tests.rollouts import differences, relocate

pygame = pytest.importorskip("pygame")


@pytest.fixture
def screen(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    screen = Screen(1000.0)
    screen.show(np.zeros((60, 300, 3), np.uint8), ["first", "last"])
    yield screen
    screen.window.close()


def post(kind, **fields):
    pygame.event.post(pygame.event.Event(kind, **fields))


@pytest.mark.usefixtures("screen")
def test_keys_and_sticks_drive_and_ask():
    controls = Controls()
    post(pygame.KEYDOWN, key=pygame.K_w)
    assert controls.poll() is None
    np.testing.assert_array_equal(controls.act({}, {}), [1.0, 0.0])
    post(pygame.KEYUP, key=pygame.K_w)
    post(pygame.JOYAXISMOTION, axis=1, value=-0.5)
    post(pygame.JOYAXISMOTION, axis=0, value=0.1)  # hardly moved: at rest
    controls.poll()
    np.testing.assert_allclose(controls.act({}, {}), [0.5, 0.0])
    for wish, key in WISHES.items():
        post(pygame.KEYDOWN, key=getattr(pygame, key))
        assert controls.poll() == wish
    post(pygame.QUIT)
    assert controls.poll() == "quit"
    controls.reset(0)
    np.testing.assert_array_equal(controls.act({}, {}), [0.0, 0.0])


def test_the_picture_has_lines_below_it(screen):
    screen.show(np.full((60, 300, 3), 200, np.uint8), ["tick 3 of 10", "keys"])
    shown = pygame.surfarray.array3d(pygame.display.get_surface())
    assert shown.shape[0] == 300 and shown.shape[1] > 60 + 2 * 13
    assert (shown[:, :60] == 200).all() and shown[:, 70:].max() > 150 > shown[:, 70:].min()


def test_an_associator_is_switched_from_one_scan_to_the_next():
    switch, slam = Switch(["nearest_neighbour", "jcbb", "nearest_neighbour"]), Slam()
    scan = Scan.from_points([[3.0, 0.0], [3.0, 0.4], [5.0, 1.0]], sigma=0.3)
    slam.step(Odometry.from_motion([0, 0, 0], 0.1), scan, "jcbb")
    prediction = slam.map.prediction(10.0)
    for name, same in (("nearest_neighbour", nearest_neighbour), ("jcbb", jcbb), ("nearest_neighbour", None)):
        assert switch.name == name
        if same:
            assert not differences(switch(scan, prediction).features, same(scan, prediction).features)
        switch.next()


def test_a_search_finds_nothing_while_it_is_off():
    env, search = relocate(outside=0.0), SearchSwitch(None)
    env.reset(seed=0)
    problem = env.kidnapped.scan, env.mapped.landmarks, env.mapped.locality("covisibility")
    assert not search.on and not search(*problem).accepted and (search(*problem).features == UNPAIRED).all()
    search.on = True
    assert search(*problem).pairings > 2
