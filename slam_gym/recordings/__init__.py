"""Real logs, read into the odometry and scans that the simulator also produces.

`open_recordings` opens the logs of the catalogue by name, and others by file, for commands, notebooks and environments.
"""

import os
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from slam_gym.recordings import dlr as _dlr
from slam_gym.recordings import mrclam as _mrclam
from slam_gym.recordings import victoria_park as _victoria_park
from slam_gym.recordings.csv_log import from_csv
from slam_gym.recordings.pose_graph import g2o, isam
from slam_gym.recordings.recording import Recording, RecordingError, load, save, write_tum

__all__ = [
    "DATA",
    "PUBLISHED",
    "Recording",
    "RecordingError",
    "from_csv",
    "load",
    "open_recordings",
    "save",
    "write_tum",
]

PUBLISHED = {"victoria_park": _victoria_park.SOURCE, "mrclam": _mrclam.SOURCE, "dlr": _dlr.SOURCE}
"""Public logs that can be opened by name, and what to cite. Users must obtain their files themselves."""

DATA = "SLAM_GYM_DATA"
"""The environment variable that names the folder that contains the folders `victoria_park`, `mrclam` and `dlr`."""


def open_recordings(
    name: str | Path, data: str | Path | None = None, robots: Sequence[int] | None = None, *, reference: bool = False
) -> list[Recording]:
    """Open the logs of a name or file: one log, or for MR.CLAM one for each robot of each set.

    Arguments:
        name: `victoria_park`, `mrclam`, `dlr`, or a file: .csv (`from_csv`), .npz (`recordings/FORMAT.md`), .g2o, or
            .txt (iSAM).
        data: folder of the published files; default: the folder of that name in `SLAM_GYM_DATA`.
        robots: robots of MR.CLAM; default: all.
        reference: whether the vertices of a .g2o file are the truth.

    Raises FileNotFoundError that says what is missing, where to get it and what to cite; RecordingError for invalid
    files; ValueError for a name that is neither a public log nor a file of these types.
    """
    name, path = str(name), Path(name)
    if name == "victoria_park":
        return [_victoria_park.victoria_park(_folder(name, data))]
    if name == "dlr":
        return [_dlr.dlr(_folder(name, data))]
    if name == "mrclam":
        sets = _sets(_folder(name, data))
        return [_mrclam.mrclam(folder, robot) for folder in sets for robot in robots or _mrclam.ROBOTS]
    read_g2o = partial(g2o, reference=reference)
    readers: dict[str, Callable[[Path], Recording]] = {".npz": load, ".csv": from_csv, ".g2o": read_g2o, ".txt": isam}
    if (suffix := path.suffix.lower()) not in readers:
        known = ", ".join([*PUBLISHED, *(f"FILE{known}" for known in readers)])
        raise ValueError(f"unknown recording {name!r}; known: {known}")
    if not path.is_file():
        raise FileNotFoundError(f"{path}: not there")
    return [readers[suffix](path)]


def _folder(name: str, data: str | Path | None) -> Path:
    """The folder of the published files. Raises FileNotFoundError that says where to get them."""
    if data is None and DATA not in os.environ:
        raise FileNotFoundError(
            f"recording {name!r}: its files are not part of this package. Get them from their authors, and say where "
            f"they are: the folder itself, or {DATA} for the folder in which {name!r} lies. {PUBLISHED[name]}"
        )
    folder = Path(os.environ[DATA]) / name if data is None else Path(data)
    if not folder.is_dir():
        raise FileNotFoundError(f"recording {name!r}: {folder} is no folder. {PUBLISHED[name]}")
    return folder


def _sets(folder: Path) -> list[Path]:
    """The sets of MR.CLAM in a folder, or the folder itself if it is a set."""
    if (folder / "Barcodes.dat").is_file() or (folder / "Barcodes.dat.gz").is_file():
        return [folder]
    found = sorted({path.parent for path in folder.glob("*/Barcodes.dat*")})
    if not found:
        raise FileNotFoundError(f"recording 'mrclam': {folder} holds no set (MRCLAM_Dataset…). {_mrclam.SOURCE}")
    return found
