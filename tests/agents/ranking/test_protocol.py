"""The protocol is frozen: whatever changes it changes its hash, and this test."""

import pytest

from agents.ranking.entries import BASELINES, read_entries
from agents.ranking.protocol import FIRST, PARTS, QUICK, VERSION, Part, protocol

FROZEN = {"agent": "b930349a74f6e4e4", "associator": "f7ae93942374f611", "relocator": "9bd00330e723e870"}
"""Hashes of version 2. Another protocol is another version, and old entries are then ranked apart."""


@pytest.mark.parametrize("role", PARTS)
def test_it_is_what_it_was(role):
    assert VERSION == 2 and protocol(role).hash == FROZEN[role]


def test_the_quick_form_and_every_role_have_hashes_of_their_own():
    assert len({protocol(role, quick).hash for role in PARTS for quick in (False, True)}) == 6


def test_parts_without_data_are_left_out_and_change_no_hash(monkeypatch):
    monkeypatch.delenv("SLAM_GYM_DATA", raising=False)
    without = protocol("associator")
    assert not any(part.needs_data for part in without.parts)
    assert without.hash == protocol("associator").hash and {part.column for part in without.parts} >= {
        "closure",
        "drift-2",
    }


@pytest.mark.parametrize("role", PARTS)
def test_the_rows_that_ship_are_of_the_worlds_that_there_are(role):
    rows = [entry for entry in read_entries([BASELINES]) if entry.role == role]
    assert rows and {entry.worlds for entry in rows} == {protocol(role).worlds_hash()}


def test_the_hash_of_worlds_is_that_of_the_floors():
    quick = protocol("agent", quick=True)
    assert quick.worlds_hash() == protocol("agent", quick=True).worlds_hash()
    assert quick.parts[0].worlds == range(FIRST, FIRST + 1)
    other = quick._replace(parts=(Part("drive", "office-small", 3),))
    assert quick.worlds_hash() != other.worlds_hash()
    assert all(part.count == 1 for parts in QUICK.values() for part in parts)
