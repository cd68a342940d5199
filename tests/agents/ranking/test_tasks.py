"""Tasks of the protocol give one loss for each world."""

import pytest

from agents.evaluation.records import Key
from agents.ranking.protocol import Part, protocol
from agents.ranking.tasks import EntryTask, leaderboard_evaluation


@pytest.mark.parametrize(
    ("role", "entry", "part"),
    [
        ("associator", "true_association", Part("suite", "closure/0", 1)),
        ("relocator", "gcbb", Part("suite", "kidnapped/0", 1)),
        ("associator", "jcbb", Part("suite", "closure/0", 1)),
    ],
)
def test_losses_lie_between_none_and_all(role, entry, part):
    (world,) = part.worlds
    task = EntryTask(entry, role, part, world)
    (record,) = task.run(task.keys)
    assert task.keys == (Key(entry, part.setting, world),) and record["column"] == part.column
    assert 0.0 <= record["loss"] <= 1.0 and (entry != "true_association" or record["loss"] == 0.0)


def test_an_evaluation_is_the_whole_protocol():
    chosen = protocol("agent", quick=True)
    evaluation = leaderboard_evaluation("random", chosen)
    assert len(evaluation.tasks) == sum(part.count for part in chosen.parts)
    assert evaluation.conditions["hash"] == chosen.hash and evaluation.conditions["entry"] == "random"
