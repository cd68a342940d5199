"""JCBB in exploration, with and without locality."""

from slam_gym.bench.locality.tracking import track
from slam_gym.bench.runner import main


def test_locality_tests_no_more_pairings_and_maps_as_well():
    local, everything = (track("office", locality, 1, 60) for locality in ("covisibility", None))
    assert (local["locality"], everything["locality"]) == ("covisibility", "everything")
    assert 0.0 < local["pairing tests"] <= everything["pairing tests"]
    for row in (local, everything):
        assert row["precision"] > 0.95 and 0.0 < row["map_error"] < 1.0 and row["limits hit"] == 0


def test_the_command_is_a_variant_of_locality(capsys):
    main(["locality", "--tracking", "--episodes", "1", "--budget", "20", "--scenarios", "hall"])
    *_, first, second = capsys.readouterr().out.splitlines()
    assert first.split()[:2] == ["hall", "covisibility"] and second.split()[:2] == ["hall", "everything"]
