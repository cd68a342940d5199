"""The parts of a step."""

import numpy as np
import pytest

from slam_gym.bench.runner import main
from slam_gym.bench.speed.step import ON_THE_PAGE, PARTS, by_part, by_size, timed_parts


def test_parts_are_timed_while_asked_for_and_left_as_they_were():
    before = {(owner, name): getattr(owner, name) for calls in PARTS.values() for owner, name in calls}
    spent = dict.fromkeys(PARTS, 0.0)
    with pytest.raises(ZeroDivisionError), timed_parts(spent):
        assert all(getattr(owner, name) is not function for (owner, name), function in before.items())
        raise ZeroDivisionError
    assert all(getattr(owner, name) is function for (owner, name), function in before.items())


def test_classes_of_size_hold_their_steps():
    steps = [{"µs": float(k), "features": k} for k in range(1, 121)]
    rows = {row["mapped features"]: row for row in by_size(steps)}
    assert set(rows) == {"all", "up to 100"}
    assert rows["up to 100"]["steps"] == 100 and rows["all"]["median µs"] == 60.5
    rows = {row["mapped features"]: row for row in by_size(steps * 2)}
    assert rows["26 – 50"]["median µs"] == 38.0 and rows["26 – 50"]["steps/s"] == pytest.approx(1e6 / 38.0)


def test_parts_add_up_to_the_whole():
    rows = by_part({"scan": 30.0, "physics": 50.0}, [{"µs": 60.0, "features": 1}, {"µs": 40.0, "features": 1}])
    assert sum(row["of the step"] for row in rows) == pytest.approx(1.0)
    assert {row["part"]: row["µs a step"] for row in rows}["the rest"] == 10.0


def test_every_part_of_a_step_is_met(monkeypatch, tmp_path, capsys):
    """A part whose call has another name by now would cost nothing."""
    import csv

    main(["step", "--episodes", "1", "--scenario", "hall", "--out", str(tmp_path)])
    with (tmp_path / "step_parts.csv").open(encoding="utf-8") as file:
        parts = {row["part"]: float(row["µs a step"]) for row in csv.DictReader(file)}
    assert PARTS.keys() <= parts.keys() <= (PARTS | ON_THE_PAGE).keys() | {"the rest"}
    assert np.min(list(parts.values())) > 0.0
