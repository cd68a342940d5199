"""The command that trains what ships from nothing."""

import math

import pytest
from typer.testing import CliRunner

from agents.learning.cloning import figure
from agents.reproduce import app, compared
from slam_gym import weights
from slam_gym.association.tracking.network import load_network


def test_the_associator_is_trained_from_nothing(tmp_path):
    done = CliRunner().invoke(app, ["associator", "--quick", "--output", str(tmp_path)])
    assert done.exit_code == 0, done.output
    said = done.output
    assert "seed 1: cross-entropy" in said and "wrote" in said
    shipped = weights.card_of("associator")
    found = weights.load(tmp_path / "associator.npz", shipped.version, shipped.inputs, shipped.shapes)
    metrics = found.card.metrics
    ours, model = (metrics[f"cross-entropy held out{of}"]["estimate"] for of in ("", ", the model alone"))
    assert ours < model  # a few scans, and it is better than the model already
    assert load_network(tmp_path / "associator.npz").first.shape[1] == len(shipped.inputs)


def test_figures_are_held_against_the_card():
    card = {"loss": figure([1.0, 1.1, 0.9])}
    assert card["loss"]["low"] == pytest.approx(0.7) and card["loss"]["high"] == pytest.approx(1.3)
    found = {"loss": {"estimate": 1.2}, "other": {"estimate": 3.0}}
    lines, outside = compared(found, card)
    assert "OUTSIDE" not in lines[0] and lines[1] == "other: 3" and outside == 0
    for loss in (1.4, math.nan):
        lines, outside = compared(found | {"loss": {"estimate": loss}}, card)
        assert "OUTSIDE" in lines[0] and outside == 1


def test_the_recordings_have_to_be_there(monkeypatch, tmp_path):
    monkeypatch.delenv("SLAM_GYM_DATA", raising=False)
    done = CliRunner().invoke(app, ["associator", "--output", str(tmp_path)])
    assert done.exit_code == 2 and "SLAM_GYM_DATA is not set" in done.output
    (tmp_path / "file").touch()
    done = CliRunner().invoke(app, ["driver", "--quick", "--output", str(tmp_path / "file")])
    assert done.exit_code == 2 and "File exists" in done.output and "epoch" not in done.output
