"""Films show the episode that was evaluated."""

import numpy as np
import pytest

from agents.evaluation.episodes import Driver, ExploreArguments
from agents.reports import film as filming

SMALL = ExploreArguments("office-small")


@pytest.fixture(autouse=True)
def few_frames(monkeypatch):
    pytest.importorskip("pygame")
    monkeypatch.setattr(filming, "FRAMES", 30)


def test_a_film_shows_the_episode_that_was_evaluated(tmp_path):
    imageio = pytest.importorskip("imageio.v2")
    picture = filming.film(SMALL, Driver("random"), 0, tmp_path / "random.mp4")
    frames = [frame for frame in imageio.get_reader(tmp_path / "random.mp4")]
    pause = filming.RATE  # at the first wrong pairing
    assert 30 <= len(frames) - filming.RATE - pause <= 31
    shown = imageio.imread(picture)
    assert shown.shape == frames[-1].shape
    assert np.abs(shown.astype(int) - frames[-1].astype(int)).mean() < 6.0
    assert np.abs(frames[0].astype(int) - frames[-1].astype(int)).mean() > 1.0


def test_films_that_are_there_stay(tmp_path):
    path = filming.film_path(tmp_path, "agents.drivers.baselines:RandomAgent")
    assert path.name == "agents-drivers-baselines-RandomAgent.mp4"
    path.parent.mkdir()
    path.with_suffix(".png").write_bytes(b"before")
    drivers = [Driver("agents.drivers.baselines:RandomAgent"), Driver("nearest_frontier")]
    picture = filming.film_path(tmp_path, "nearest_frontier").with_suffix(".png")
    assert [call() for call in filming.films_of(drivers, SMALL, 0, tmp_path)] == [picture]
    assert path.with_suffix(".png").read_bytes() == b"before" and not path.exists()
    assert filming.film_path(tmp_path, "nearest_frontier").exists()


def test_associators_are_filmed_side_by_side_and_stop_at_the_first_wrong_pairing(tmp_path):
    imageio = pytest.importorskip("imageio.v2")
    drifting = ExploreArguments("drift-3", (("budget", 90),))
    driver, names = [Driver("nearest_frontier")], ["nearest_neighbour", "true_association"]
    (film,) = filming.films_of(driver, drifting, 0, tmp_path, names)
    picture = imageio.imread(film())
    frames = imageio.get_reader(filming.film_path(tmp_path, filming.BESIDE))
    height, width, _ = picture.shape
    assert frames.get_data(0).shape == picture.shape and width == 2 * 960 and height == 720 + 32
    pauses = 2 * filming.RATE  # where nearest neighbour first errs, and at the end
    assert frames.count_frames() >= 30 + pauses
    left, right = picture[32:, :960].astype(int), picture[32:, 960:].astype(int)
    assert np.abs(left - right).mean() > 0.1
    assert len(filming.films_of(driver, drifting, 0, tmp_path, ["jcbb", "marginal"])) == 1  # this film is of others
