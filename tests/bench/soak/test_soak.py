"""The soak in its shortest form: some episodes with extreme settings, and what is said where something breaks."""

import math
from dataclasses import replace

import pytest

from slam_gym.bench.report import Report
from slam_gym.bench.runner import FailedError, main
from slam_gym.bench.soak.cases import EXTREMES
from slam_gym.bench.soak.soak import growth, run, soak

EXTREME = (0, 1, 5, 8, 14, 29)  # numbers of cases: all three environments, five kinds of settings


@pytest.mark.parametrize("number", EXTREME)
def test_nothing_breaks(number):
    outcome = soak(number, 0, 24)
    assert not outcome.broken, f"{outcome.case}: {outcome.broken}"
    assert outcome.steps > 0 and outcome.functions > 0


def test_the_command_tells_what_was_driven(capsys, tmp_path):
    assert main(["soak", "--ticks", "1", "--length", "10", "--first", "2", "--out", str(tmp_path)]) == 0
    shown = capsys.readouterr().out
    assert "By extreme" in shown and "1 episodes" in shown and "0 broken" in shown
    assert "case 2: Explore" in (tmp_path / "soak.csv").read_text()


def test_what_breaks_is_named_and_fails_the_command(capsys, monkeypatch):
    monkeypatch.setattr("slam_gym.bench.soak.checks._SUM", -1.0)  # no sum is that near
    with pytest.raises(FailedError, match="1 of 1 episodes"):
        run(Report(), ticks=1, minutes=0.01, length=10, first=2)
    assert "BROKEN case 2: Explore" in capsys.readouterr().out


def test_an_episode_that_does_not_begin_is_named_too(monkeypatch):
    def nowhere(rng):
        raise OSError("no floor")

    monkeypatch.setitem(EXTREMES, "as it is", lambda scenario: replace(scenario, generator=nowhere))
    outcome = soak(0, 0, 20)
    assert outcome.broken.startswith("OSError: no floor") and outcome.ticks == 0


def test_growth_is_that_of_the_level_not_of_the_start():
    assert growth([10.0, 50.0, *([100.0] * 8)]) == pytest.approx(100.0 / 100.0 - 1.0, abs=0.01)
    assert growth([100.0] * 5 + [120.0] * 5) == pytest.approx(0.2) and math.isnan(growth([1.0]))
