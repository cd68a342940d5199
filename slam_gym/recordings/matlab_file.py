"""MATLAB files: published ones are known by their checksums, and any other is read in a process of its own.

`scipy.io.loadmat` trusts what a file says about itself: some damaged ones end the interpreter. The child that reads an
unknown file has a bound on its memory and on its time, and hands numbers back, never pickles.
"""

from __future__ import annotations

import hashlib
import io
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat

from slam_gym._files import array_of, content_of, zip_members
from slam_gym.recordings import matlab_child
from slam_gym.recordings.reading import RecordingError

_TIME = 10.0  # [s] that a child may take
_MAX_VALUES = 1 << 27  # bytes that a child may hand back
PUBLISHED = frozenset({
    "6ce2c4f757023b7d275cc14f24ff2ffcca21ea68cfa360bc854e620a706eb358",  # victoria_park/aa3_dr.mat
    "8e5212b3028d40f64dcf7b43f68f89e67ea4b0c0b3ec01835997381fe9d96997",  # VictoriaParkSinSincronizar.mat
    "521fc4c6e0ea3851ffb463c3d9c0578044e9178c4fb87f37c703bb587f38c755",  # aa3_gpsx.mat
    "1506a7ae951c4458de6e5929075d0665211d91ad396ebc6d15a392cd383e029f",  # data_sensor_clean_clean.mat
    "8dfae1db56c146b1a7309a39494756cbeca8e7968d8f95e572a93ac97b2ec63c",  # VicPark_clean_data.mat
    "832922dd0a9ee16192819f6409508de9086e5a32f640efa2d03488335ca5a7e3",  # mrclam/stationary/mrclam1.mat
    "a353a79e38b42aa3ac60624e93b95578a4e2070361b57181ea739332a5f6c65e",  # mrclam2.mat
    "d978a20a4519ba6ed5c93861d8339120abfbfc4b4ab1de37ff7b0c76ad080dff",  # mrclam3.mat
    "596f2dc88b7c17d5291966916f4cc20dc04c56200163bb1ab2d5a6f955061231",  # mrclam4.mat
    "f0b56a64cbe1fbf8c64b92575fc3c7b078ba64905aa07e0e02203070d4021aa3",  # mrclam5.mat
})  # fmt: skip
"""SHA-256 of the files that loadmat is known to read."""


def read_matlab(path: Path, names: Sequence[str], source: str) -> dict[str, Any]:
    """The variables of a MATLAB file from a `source` to be cited: arrays of numbers, or of arrays of numbers.

    Raises FileNotFoundError, or RecordingError for what is unreadable or missing.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: not there. {source}")
    try:
        content = content_of(path)
        if hashlib.sha256(content).hexdigest() in PUBLISHED:
            read: dict[str, Any] = loadmat(io.BytesIO(content), variable_names=list(names))
        else:
            read = _read_apart(content, names)
    except (ValueError, OSError) as error:
        raise RecordingError(f"{path}: no readable MATLAB file: {error}") from error
    for name in names:
        if name not in read:
            raise RecordingError(f"{path}: variable {name!r} is missing")
    return {name: read[name] for name in names}


def _read_apart(content: bytes, names: Sequence[str]) -> dict[str, Any]:
    """The same in a child process. ValueError where it ends without an answer."""
    with tempfile.TemporaryDirectory() as folder:
        given, answer = Path(folder) / "given.mat", Path(folder) / "answer.npz"
        given.write_bytes(content)
        command = [sys.executable, "-P", str(Path(matlab_child.__file__)), str(given), str(answer), *names]
        try:
            child = subprocess.run(
                command, timeout=_TIME, capture_output=True, stdin=subprocess.DEVNULL,
                env=os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            raise ValueError(f"it was not read within {_TIME:g} s") from None
        if child.returncode != 0 or not answer.is_file():
            said = child.stderr.decode(errors="replace").strip().splitlines()
            raise ValueError(said[-1][:200] if said else f"reading it ended with status {child.returncode}")
        members = zip_members(content_of(answer, 2 * _MAX_VALUES), _MAX_VALUES)
    arrays = {name.removesuffix(".npy"): array_of(member, "fiub", _MAX_VALUES) for name, member in members.items()}
    return {name: _put_together(name, arrays) for name in names if name in arrays or f"{name} shapes" in arrays}


def _put_together(name: str, arrays: dict[str, np.ndarray]) -> Any:
    """A variable from what `matlab_child.taken_apart` made of it."""
    if name in arrays:
        return arrays[name].copy()
    shapes, values = arrays[f"{name} shapes"], arrays[f"{name} values"]
    cells = np.empty(len(shapes), object)
    at = 0
    for k, (rows, columns) in enumerate(shapes.tolist()):
        cells[k] = values[at : at + rows * columns].reshape(rows, columns)
        at += rows * columns
    return cells.reshape(tuple(arrays[f"{name} shape"].tolist()))
