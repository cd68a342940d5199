"""Records that are quick to make are the dataclasses that they were."""

from __future__ import annotations

import copy
import pickle
from dataclasses import FrozenInstanceError, dataclass, field, fields, replace

import pytest

from slam_gym.types._records import quick


@quick
@dataclass(frozen=True, slots=True)
class Record:
    first: int
    second: str = "two"
    third: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        if self.first < 0:
            raise ValueError("first: negative")


def test_a_record_is_made_by_position_by_name_and_by_default() -> None:
    record = Record(1, third=[3])
    assert (record.first, record.second, record.third) == (1, "two", [3])
    assert Record(1) == Record(first=1, second="two", third=[])
    assert Record(1).third is not Record(1).third
    assert repr(record) == "Record(first=1, second='two', third=[3])"
    assert [one.name for one in fields(record)] == ["first", "second", "third"]


def test_a_record_cannot_be_changed_and_has_no_further_attributes() -> None:
    record = Record(1)
    for name in ("first", "fourth"):
        with pytest.raises((FrozenInstanceError, TypeError, AttributeError)):
            setattr(record, name, 2)
    with pytest.raises(TypeError, match="first"):
        Record()  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="fifth"):
        Record(1, fifth=5)  # type: ignore[call-arg]
    with pytest.raises(ValueError, match="negative"):
        Record(-1)


def test_copies_replacements_and_pickles_are_of_the_same_class_and_equal() -> None:
    record = Record(1, "b", [2])
    for other in (copy.copy(record), copy.deepcopy(record), pickle.loads(pickle.dumps(record)), replace(record)):
        assert type(other) is Record and other == record
    assert copy.deepcopy(record).third is not record.third
    assert replace(Record(1, third=[2]), first=3) == Record(3, third=[2])
