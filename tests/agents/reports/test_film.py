"""Films show the episode that was evaluated."""

import numpy as np
import pytest

from agents.evaluation.drives import Driver
from agents.evaluation.episodes import ExploreArguments
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
    assert 30 <= len(frames) - filming.RATE <= 31
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
