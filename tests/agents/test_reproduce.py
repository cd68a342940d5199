"""The command that trains what ships from nothing."""

import math

import numpy as np
import pytest
from typer.testing import CliRunner

from agents.reproduce import app, compared, verdict
from slam_gym import weights
from slam_gym.association.tracking.network import INPUTS, VERSION, load_network
from slam_gym.weights import Card, Weights, figure


def test_the_associator_is_trained_from_nothing(tmp_path):
    done = CliRunner().invoke(app, ["associator", "--quick", "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    said = done.output
    assert "seed 1: cross-entropy" in said and "wrote" in said
    shipped = weights.card_of("associator")
    found = weights.load(tmp_path / "associator.npz", shipped.version, shipped.inputs, shipped.shapes)
    metrics = found.card.metrics
    ours, model = (metrics[f"cross-entropy held out{of}"]["estimate"] for of in ("", ", the model alone"))
    assert ours < model  # a few scans, and it is better than the model already
    assert load_network(tmp_path / "associator.npz", VERSION, INPUTS).first.shape[1] == len(shipped.inputs)


def test_figures_are_held_against_the_card():
    card = {"loss": figure([1.0, 1.1, 0.9])}
    assert card["loss"]["low"] == pytest.approx(0.7) and card["loss"]["high"] == pytest.approx(1.3)
    inside, outside, new = compared({"loss": {"estimate": 1.2}, "other": {"estimate": 3.0}}, card)[0], compared(
        {"loss": {"estimate": 1.4}}, card
    )[0], compared({"other": {"estimate": 3.0}}, card)[0]  # fmt: skip
    assert "OUTSIDE" not in inside and "OUTSIDE" in outside and new == "other: 3"


def test_the_verdict_tells_figures_and_arrays_apart():
    def trained(loss, weight):
        card = Card(1, ("range",), {}, ("office",), (0,), "python -m …", {"loss": figure([loss, loss + 0.1])})
        return Weights(card, {"first": np.full(2, weight)})

    shipped = trained(1.0, 0.5)
    within = "verdict: all figures within the card; "
    assert verdict(shipped, shipped) == (within + "the arrays that ship, bit for bit", True)
    assert verdict(trained(1.1, 0.25), shipped) == (within + "other arrays, by up to 0.25", True)
    for loss in (2.0, math.nan):
        said, good = verdict(trained(loss, 0.5), shipped)
        assert not good and said.startswith("verdict: 1 of 1 figures OUTSIDE the card")


def test_the_recordings_have_to_be_there(monkeypatch, tmp_path):
    monkeypatch.delenv("SLAM_GYM_DATA", raising=False)
    done = CliRunner().invoke(app, ["associator", "--out", str(tmp_path)])
    assert done.exit_code == 2 and "SLAM_GYM_DATA is not set" in done.output
