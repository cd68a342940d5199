"""Episodes are written for Rerun's viewer, where it is there; where not, one sentence says what to install."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from agents import evaluate, evaluate_association, play
from agents.drivers.base import make_agent
from agents.evaluation.episodes import ExploreArguments
from agents.reports.rerun_log import Drive, RerunLog, ellipses, log_drives

WORLD = ExploreArguments("office-small", (("budget", 12),))
INSTALLED = importlib.util.find_spec("rerun") is not None


def test_ellipses_hold_95_percent():
    outline = ellipses(np.array([[1.0, 2.0]]), np.array([[[4.0, 0.0], [0.0, 1.0]]]))[0]
    assert outline.shape == (25, 2) and np.ptp(outline[:, 0]) == pytest.approx(2 * 2.4477 * 2.0, rel=0.02)
    np.testing.assert_allclose(0.5 * (outline.max(axis=0) + outline.min(axis=0)), [1.0, 2.0], atol=0.05)


@pytest.mark.skipif(not INSTALLED, reason="rerun-sdk is not installed: pip install 'slam_gym[rerun]'")
def test_every_drive_gets_a_recording(tmp_path):
    drives = [Drive(name, WORLD, make_agent("nearest_frontier"), name) for name in ("jcbb", "true_association")]
    written = log_drives(str(tmp_path / "runs" / "first.rrd"), 0, drives)
    files = sorted(path.name for path in (tmp_path / "runs").iterdir())
    assert files == ["first_jcbb.rrd", "first_true_association.rrd"] == [Path(name).name for name in written]
    assert all((tmp_path / "runs" / name).stat().st_size > 10_000 for name in files)


@pytest.mark.skipif(INSTALLED, reason="rerun-sdk is installed")
def test_what_is_missing_is_said_in_one_sentence(tmp_path):
    with pytest.raises(ImportError, match=r"^--rerun needs rerun-sdk: pip install 'slam_gym\[rerun\]'$"):
        RerunLog(tmp_path / "a.rrd", "nobody")


@pytest.mark.skipif(INSTALLED, reason="rerun-sdk is installed")
@pytest.mark.parametrize("command", [evaluate, evaluate_association, play])
def test_a_command_says_so_before_it_drives(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ImportError, match="rerun-sdk"):
        command.main(["--rerun", "a.rrd"])
    assert not list(tmp_path.iterdir())
