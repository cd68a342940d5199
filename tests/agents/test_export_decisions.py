"""The export of decisions: states, masks and right answers, the same to the last byte."""

import json

import numpy as np
import pytest

from agents import export_decisions
from agents.evaluation.episodes import AssociateArguments
from agents.export_decisions import UNKNOWN_ACTION
from slam_gym.association.tracking.observation import lengths


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    file = tmp_path_factory.mktemp("export") / "decisions.npz"
    assert export_decisions.main([str(file), "--scenario", "corridor", "--episodes", "2", "--candidates", "4"]) == 0
    return file


def test_an_export_holds_states_masks_and_right_answers(exported):
    with np.load(exported, allow_pickle=False) as file:
        content = {name: file[name] for name in file.files}
    count = len(content["right"])
    assert str(content["format"]) == export_decisions.FORMAT
    assert json.loads(str(content["setting"]))["scenario"] == "corridor"
    for name, length in (lengths(4) | {"budget": 1}).items():
        assert content[name].shape == (count, length)
        assert content[name].dtype == np.float32
    assert content["mask"].shape == (count, 5)
    assert content["mask"].dtype == bool
    rows = np.arange(count)
    known = content["right"] != UNKNOWN_ACTION
    assert content["mask"][rows[known], content["right"][known]].all()
    assert content["mask"][rows, content["taken"]].all()
    assert set(content["episode"].tolist()) == {0, 1}
    assert (content["right"] == content["taken"]).mean() > 0.8
    assert (content["right"] != content["taken"]).sum() > 20
    assert (known & (content["right"] < 4)).mean() > 0.8


def test_an_export_is_the_same_to_the_last_byte(exported, tmp_path):
    again = tmp_path / "again.npz"
    export_decisions.main([str(again), "--scenario", "corridor", "--episodes", "2", "--candidates", "4"])
    assert again.read_bytes() == exported.read_bytes()


def test_without_mistakes_the_map_is_that_of_right_decisions(tmp_path):
    arrays = export_decisions.decisions(AssociateArguments("corridor"), 5, 1, 0.0)
    assert (arrays["taken"] == np.where(arrays["right"] == UNKNOWN_ACTION, 5, arrays["right"])).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--episodes", "0"], "--episodes"),
        (["--mistakes", "2"], "--mistakes"),
        (["--scenario", "atlantis"], "corridor"),
        (["--order", "any"], "as_scanned"),
    ],
)
def test_bad_exports_are_refused_and_leave_no_file(arguments, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        export_decisions.main([str(tmp_path / "file.npz"), *arguments])
    assert not list(tmp_path.iterdir())


def test_an_export_into_nowhere_is_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="folder"):
        export_decisions.main([str(tmp_path / "none" / "file.npz")])
