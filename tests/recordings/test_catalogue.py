"""Recordings by name or file."""

import numpy as np
import pytest

from slam_gym.recordings import DATA, Recording, RecordingError, open_recordings, save
from slam_gym.recordings.recording import Spans
from tests.recordings.test_recording import by_hand

G2O = "EDGE_SE2 0 1 1 0 0 9 0 0 9 0 9\nEDGE_SE2_XY 0 5 2 1 4 0 4\nVERTEX_SE2 0 3 4 0\nVERTEX_SE2 1 4 4 0\n"
ISAM = "ODOMETRY 0 1 1 0 0 3 0 0 3 0 3\nLANDMARK 0 5 2 1 2 0 2\n"


def test_the_suffix_of_a_file_tells_its_reader(tmp_path) -> None:
    save(Recording(**by_hand()), tmp_path / "mine.npz")
    (tmp_path / "mine.g2o").write_text(G2O)
    (tmp_path / "mine.txt").write_text(ISAM)
    (tmp_path / "mine.G2O").write_text(f"\ufeff{G2O}", encoding="utf-8")
    assert len(open_recordings(tmp_path / "mine.G2O")[0]) == 2
    assert [len(open_recordings(tmp_path / f"mine.{suffix}")[0]) for suffix in ("npz", "g2o", "txt")] == [6, 2, 2]
    for reference, known in ((False, 0), (True, 2)):
        (log,) = open_recordings(str(tmp_path / "mine.g2o"), reference=reference)
        assert len(log.reference_poses) == known
    np.testing.assert_array_equal(open_recordings(tmp_path / "mine.txt")[0].points, [[2.0, 1.0]])


def test_what_is_no_recording_is_refused_by_name(tmp_path, monkeypatch) -> None:
    with pytest.raises(ValueError, match=r"unknown recording 'park'; known: victoria_park, mrclam, dlr, FILE\.npz"):
        open_recordings("park")
    with pytest.raises(FileNotFoundError, match=r"none\.npz: not there"):
        open_recordings(tmp_path / "none.npz")
    (tmp_path / "bad.txt").write_bytes(b"ODOMETRY \xff\n")
    with pytest.raises(RecordingError, match=r"bad\.txt: line 1"):
        open_recordings(tmp_path / "bad.txt")
    monkeypatch.delenv(DATA, raising=False)
    for name in ("victoria_park", "mrclam", "dlr"):
        with pytest.raises(FileNotFoundError, match=rf"{name}.*not part of this package.*{DATA}.*Cite"):
            open_recordings(name)
        with pytest.raises(FileNotFoundError, match=rf"{name}.*is no folder.*Cite"):
            open_recordings(name, tmp_path / "nowhere")
    with pytest.raises(FileNotFoundError, match=r"holds no set.*Cite"):
        open_recordings("mrclam", tmp_path)


def test_of_each_set_every_robot_that_was_asked_for(data_dir, tmp_path, monkeypatch) -> None:
    monkeypatch.setenv(DATA, str(data_dir))
    sets = sorted(path.name for path in (data_dir / "mrclam").glob("MRCLAM_Dataset*"))
    logs = open_recordings("mrclam", robots=[2, 4])
    assert [log.name for log in logs] == [f"mrclam/{folder}/robot{robot}" for folder in sets for robot in (2, 4)]
    for file in (data_dir / "mrclam" / sets[0]).iterdir():
        (tmp_path / "one").mkdir(exist_ok=True)
        (tmp_path / "one" / file.name).symlink_to(file)
    (tmp_path / "one" / "Barcodes.dat.bak").touch()
    (alone,) = open_recordings("mrclam", tmp_path, [4])
    np.testing.assert_array_equal(alone.points, logs[1].points)


# --- what the readers share -------------------------------------------------------------------------------------------


def test_spans_are_cut_where_commands_take_over() -> None:
    looks, commands = np.array([0.0, 1.0, 1.0, 4.0]), np.array([0.5, 1.0, 2.5, 2.5, 9.0])
    spans = Spans.between(looks, commands)
    assert spans.step.tolist() == [1, 1, 3, 3] and spans.command.tolist() == [-1, 0, 1, 3]
    assert spans.sums(spans.seconds, 4).tolist() == [0.0, 1.0, 0.0, 3.0]
    assert spans.headings(np.array([1.0, 2.0, 4.0, 8.0])).tolist() == [0.0, 1.0, 0.0, 4.0]
    assert len(Spans.between(looks[:1], commands).step) == 0
