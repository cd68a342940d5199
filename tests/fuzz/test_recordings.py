"""Logs from strangers: each is read, or refused by an error that names it."""

import gzip
import hashlib
import io
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from slam_gym.recordings import load, matlab_child, matlab_file, open_recordings
from slam_gym.recordings.mrclam import mrclam
from slam_gym.recordings.mrclam_groups import stationary
from slam_gym.recordings.victoria_park import victoria_park
from tests.fuzz.attack import attack
from tests.fuzz.inputs import archives, arrays, damaged, respelt
from tests.fuzz.nursery import Nursery
from tests.recordings.test_pose_graph import files
from tests.recordings.test_recording import by_hand

MRCLAM = {
    "Barcodes.dat": "# subject barcode\n1 5\n6 63\n7 25\n8 45\n",
    "Landmark_Groundtruth.dat": "6 1.5 0.1 0.001 0.001\n7 2.5 -0.5 0.001 0.001\n8 3.0 0.8 0.001 0.001\n",
    "Robot1_Odometry.dat": "\n".join(f"{100 + 0.1 * k:.3f} 0.1 0.01" for k in range(30)),
    "Robot1_Measurement.dat": "\n".join(f"{100.5 + k // 2:.3f} {(63, 25)[k % 2]} 1.5 0.05" for k in range(6)),
    "Robot1_Groundtruth.dat": "\n".join(f"{100 + 0.1 * k:.3f} {0.01 * k:.3f} 0 0" for k in range(40)),
}


def test_recording_files(tmp_path, inputs, count) -> None:
    content = {"format": "slam_gym recording", "version": 1, **by_hand()}
    wholes = []
    for write in (np.savez, np.savez_compressed):
        file = io.BytesIO()
        write(file, **content)
        wholes.append(file.getvalue())
    count(attack(load, tmp_path / "log.npz", damaged(*wholes), inputs // 2))
    count(attack(load, tmp_path / "log.npz", archives(content), inputs - inputs // 2))


@pytest.mark.parametrize("suffix", [".g2o", ".txt"])
def test_pose_graphs(suffix, tmp_path, inputs, count) -> None:
    text = next(path for path in files(tmp_path) if path.suffix == suffix).read_text()
    path = tmp_path / f"stranger{suffix}"
    count(attack(open_recordings, path, damaged(text.encode()), inputs // 2))
    count(attack(open_recordings, path, respelt(text), inputs - inputs // 2))


def test_mrclam_sets(tmp_path, inputs, count) -> None:
    for name, text in MRCLAM.items():
        (tmp_path / name).write_text(text)
    assert len(mrclam(tmp_path, 1)) == 3

    def read(_):
        return mrclam(tmp_path, 1)

    for name, text in MRCLAM.items():
        changed = damaged(text.encode()) | respelt(text)
        count(attack(read, tmp_path / name, changed, inputs // 6 + 1))
        (tmp_path / name).write_text(text)
    name, text = "Robot1_Measurement.dat", MRCLAM["Robot1_Measurement.dat"]
    (tmp_path / name).unlink()
    zipped = damaged(gzip.compress(text.encode(), mtime=0))
    count(attack(read, tmp_path / f"{name}.gz", zipped, inputs // 6 + 1))


def test_matlab_files(tmp_path, inputs, count, monkeypatch) -> None:
    """Each is read in a process of its own: one that is started takes half a second, so most are forked."""
    rows = np.array([[1.0, 1.0, 2.0, 0.1], [1.0, 2.0, 1.5, -0.3], [1.0, 3.0, 2.5, 0.4]])
    tables = {
        "landmark": np.array([[1.0, 0.0, 1.0], [2.0, 2.0, 0.0], [3.0, 1.0, 3.0]]),
        "groundtruth": np.array([[1.0, 0.0, 0.0, 0.5]]),
        "measurement": rows,
    }
    wholes = [_matlab(tables, do_compression=packed) for packed in (False, True)]
    path = tmp_path / "groups.mat"
    count(attack(stationary, path, damaged(*wholes), max(inputs // 200, 1)))
    if hasattr(os, "fork"):
        changed = arrays(rows).filter(lambda a: a.dtype.kind != "M").map(lambda a: _matlab(tables | {"measurement": a}))
        with Nursery(Path(matlab_child.__file__)) as nursery:
            monkeypatch.setattr(subprocess, "run", nursery.run)
            count(attack(stationary, path, damaged(*wholes), inputs - inputs // 3))
            count(attack(stationary, path, changed, inputs // 3))


def _matlab(variables, **options) -> bytes:
    file = io.BytesIO()
    savemat(file, variables, **options)
    return file.getvalue()


def test_victoria_park(tmp_path, inputs, count, monkeypatch) -> None:
    """Files that `loadmat` reads, and that hold what no log does."""
    scans = np.empty((1, 3), object)
    scans[0, :] = [np.array([[5.0, 8.0], [1.0, 1.5], [0.3, 0.4]]), np.zeros((3, 0)), np.array([[4.0], [1.1], [0.3]])]
    park = {
        "aa3_dr": {
            "time": np.arange(0, 900, 25)[:, None],
            "speed": np.ones((36, 1)),
            "steering": np.full((36, 1), 0.1),
        },
        "VictoriaParkSinSincronizar": {"TLsr": np.array([[0.1, 0.4, 0.7]]), "zt": scans},
        "aa3_gpsx": {"timeGps": np.array([[100], [600]]), "Lo_m": np.zeros((2, 1)), "La_m": np.ones((2, 1))},
        "data_sensor_clean_clean": {"data_sensor_clean_clean": np.array([[100.0, 5.0, 1.0, 0.0, 0.0, 4.0]])},
    }
    for name, variables in park.items():
        (tmp_path / f"{name}.mat").write_bytes(_matlab(variables))

    class Anything:
        def __contains__(self, _: str) -> bool:
            return True

    monkeypatch.setattr(matlab_file, "PUBLISHED", Anything())  # as if they were known to be sound: they are
    assert victoria_park(tmp_path).sources.tolist() == [4, -1, -2]
    for name, variables in park.items():
        path = tmp_path / f"{name}.mat"
        whole = path.read_bytes()
        for variable, value in variables.items():
            if value.dtype == object:
                cells = (
                    arrays(scans[0, 0])
                    .filter(lambda a: a.dtype.kind != "M")
                    .map(
                        lambda cell: _matlab(
                            {"TLsr": park["VictoriaParkSinSincronizar"]["TLsr"], "zt": _with(scans, cell)}
                        )
                    )
                )
                count(attack(lambda _: victoria_park(tmp_path), path, cells, inputs // 10 + 1))
                continue
            changed = (
                arrays(value)
                .filter(lambda a: a.dtype.kind != "M")
                .map(lambda a, variables=variables, variable=variable: _matlab(variables | {variable: a}))
            )
            count(attack(lambda _: victoria_park(tmp_path), path, changed, inputs // 10 + 1))
        path.write_bytes(whole)


def _with(scans: np.ndarray, cell: np.ndarray) -> np.ndarray:
    out = scans.copy()
    out[0, 0] = cell
    return out


def test_a_known_checksum_is_that_of_the_published_file(data_dir) -> None:
    found = [*(data_dir / "victoria_park").glob("*.mat"), *(data_dir / "mrclam" / "stationary").glob("*.mat")]
    digests = {hashlib.sha256(path.read_bytes()).hexdigest() for path in found}
    assert digests >= matlab_file.PUBLISHED
