"""Searches with a prior, side by side."""

import numpy as np
import pytest

from slam_gym.bench.runner import main
from slam_gym.bench.speed.loop_closure import mapped_field
from slam_gym.bench.speed.prior import DENSITY, DIFFICULTIES, associate, associators, difficult_scan, summary
from slam_gym.types import UNPAIRED, Effort, Hypothesis


@pytest.fixture(scope="module")
def field():
    return mapped_field(100, np.random.default_rng(0), DENSITY)


@pytest.mark.parametrize("difficulty", DIFFICULTIES, ids=lambda d: d.name)
def test_scans_are_as_difficult_as_they_say(field, difficulty):
    rng, strays, mapped = np.random.default_rng(1), [], []
    for _ in range(40):
        one = difficult_scan(field, 10, difficulty, rng)
        strays.append((one.truth == UNPAIRED).sum())
        mapped.append(len(one.prediction))
        visibility = one.prediction.visibility()
        assert visibility is not None and ((visibility >= 0.0) & (visibility <= 1.0)).all()
        assert (one.scan.points[:, 0] > -0.5).all()
    unmapped = difficulty.unmapped * (1.0 - difficulty.spurious)
    assert np.mean(strays) == pytest.approx(10 * (difficulty.spurious + unmapped), abs=0.6)
    assert field.map.n > 90


def test_answers_are_counted_by_measurement_and_by_scan(field):
    rng = np.random.default_rng(2)
    scans = [difficult_scan(field, 10, DIFFICULTIES[2], rng) for _ in range(6)]
    truths = iter([one.truth for one in scans] * 2)
    perfect = associate(lambda scan, _: Hypothesis(next(truths), 0.0, 0, Effort()), scans)
    assert all(r["exact"] and r["right"] == r["paired"] == r["mapped"] for r in perfect)
    assert summary(perfect)["recall"] == "1.000±0.000" and summary(perfect)["limit hit"] == 0
    nothing = associate(lambda scan, _: Hypothesis(np.full(len(scan), UNPAIRED), 0.0, 0, Effort(limit_hit=True)), scans)
    assert summary(nothing)["recall"] == "0.000±0.000" and summary(nothing)["limit hit"] == 6


def test_only_one_of_the_associators_is_told_the_view(field):
    one, told = difficult_scan(field, 10, DIFFICULTIES[0], np.random.default_rng(3)), []
    prediction = one.prediction
    view = prediction.view
    object.__setattr__(prediction, "view", lambda *where: told.append(1) or view(*where))
    for name, associator in associators().items():
        associator(one.scan, prediction)
        assert bool(told) == (name == "MAP + field of view")


def test_the_command_has_a_table_for_each_difficulty(tmp_path, capsys):
    main(f"prior --features 40 --measurements 5 --scans 2 --out {tmp_path}".split())
    shown = capsys.readouterr().out
    assert all(f"{difficulty.name}: 2 scans" in shown for difficulty in DIFFICULTIES)
    assert {path.name for path in tmp_path.iterdir()} == {"prior_0.csv", "prior_30.csv", "prior_50.csv"}
