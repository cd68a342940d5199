"""Files from strangers: whatever the bytes, a reader gives a result or a ValueError or OSError that names the file.

MATLAB files are cut short or hold other variables: with damaged bytes some end the interpreter in `loadmat`.
"""

import gzip
import io
import tracemalloc
import zipfile

import numpy as np
import pytest
from scipy.io import savemat

from slam_gym import weights
from slam_gym._files import zip_members
from slam_gym.recordings import load, open_recordings
from slam_gym.recordings.mrclam import mrclam
from slam_gym.recordings.victoria_park import victoria_park
from slam_gym.world.floor_plan_file import load_floor_plan, save_floor_plan
from tests.recordings.test_pose_graph import files
from tests.recordings.test_recording import by_hand
from tests.world.test_floor_plan import square
from tests.world.test_floor_plan_file import blank

INPUTS = 60  # a reader
CHUNKS = (b"\0\0\0\0", b"\xff\xff\xff\x7f", b"nan", b"-1", b"1e308", b"9" * 20, b"[" * 50, b"\n", b"inf", b"'", b"0")
WORDS = ("0", "-1", "0.5", "1e308", "1e400", "nan", "-inf", "9007199254740993", "9" * 400, "word", "#", "\x00", "∞")
MRCLAM = {
    "Barcodes.dat": "# subject barcode\n1 5\n6 63\n7 25\n8 45\n",
    "Landmark_Groundtruth.dat": "6 1.5 0.1 0.001 0.001\n7 2.5 -0.5 0.001 0.001\n8 3.0 0.8 0.001 0.001\n",
    "Robot1_Odometry.dat": "\n".join(f"{100 + 0.1 * k:.3f} 0.1 0.01" for k in range(30)),
    "Robot1_Measurement.dat": "\n".join(f"{100.5 + k // 2:.3f} {(63, 25)[k % 2]} 1.5 0.05" for k in range(6)),
    "Robot1_Groundtruth.dat": "\n".join(f"{100 + 0.1 * k:.3f} {0.01 * k:.3f} 0 0" for k in range(40)),
}
PARK = {
    "aa3_dr": {"time": [0.0, 900.0, 2000.0], "speed": [1.0, 1.0, 2.0], "steering": [0.0, 0.1, -0.2]},
    "VictoriaParkSinSincronizar": {
        "TLsr": [0.5, 1.5],
        "zt": np.array([[9.0, 1.2, 0.3], [8.0, 3.0, 1.1, 2.0, 0.3, 0.5]], object),
    },
    "aa3_gpsx": {"timeGps": [0.0, 2000.0], "Lo_m": [0.0, 1.5], "La_m": [0.0, 0.1]},
    "data_sensor_clean_clean": {"data_sensor_clean_clean": [[500.0, 9.0, 1.2, 0.0, 0.0, 7.0]]},
}


def damaged(whole, rng):
    """One to four places of the bytes flipped, overwritten, cut off, taken out, or repeated."""
    out = bytearray(whole)
    for _ in range(rng.integers(1, 5)):
        at, length = int(rng.integers(max(len(out), 1))), int(rng.integers(1, 64))
        chunk = CHUNKS[rng.integers(len(CHUNKS))]
        kind = rng.integers(5)
        if kind == 0 and out:
            out[at] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            out[at : at + len(chunk)] = chunk
        elif kind == 2:
            out[at:at] = out[at : at + length]
        elif kind == 3:
            del out[at : at + length]
        elif rng.random() < 0.3:
            del out[at:]
    return bytes(out)


def respelt(whole, rng):
    """One to four words of a text replaced, and a line repeated or left out."""
    lines = [line.split(b" ") for line in whole.split(b"\n")]
    for _ in range(rng.integers(1, 5)):
        words = lines[rng.integers(len(lines))]
        words[rng.integers(len(words))] = WORDS[rng.integers(len(WORDS))].encode()
    k = int(rng.integers(len(lines)))
    lines[k : k + 1] = [lines[k]] * int(rng.integers(3))
    return b"\n".join(b" ".join(words) for words in lines)


def refusals(read, path, whole, damages, named=None):
    """How many of `INPUTS` damaged contents of `path` are refused; each error names the path or `named`."""
    count = 0
    for seed in range(INPUTS):
        rng = np.random.default_rng(seed)
        path.write_bytes(damages[seed % len(damages)](whole, rng))
        try:
            read(path)
        except (ValueError, OSError) as error:
            assert any(str(name) in str(error) for name in (path, path.name, named or path)), f"{error}"
            count += 1
    path.write_bytes(whole)
    return count


def packed(write, *arguments, **variables) -> bytes:
    file = io.BytesIO()
    write(file, *arguments, **variables)
    return file.getvalue()


@pytest.mark.parametrize("write", [np.savez, np.savez_compressed])
def test_recordings(tmp_path, write) -> None:
    content = {"format": "slam_gym recording", "version": 1, **by_hand()}

    def changed(_, rng):
        fields = dict(content)
        name = sorted(fields)[rng.integers(len(fields))]
        value = np.asarray(fields[name])
        kinds = (value[None], value.reshape(-1)[:1], value.T, np.zeros(3), np.array([None]), np.full_like(value, -3))
        fields[name] = kinds[rng.integers(len(kinds))] if value.dtype.kind in "fiu" else np.array(3)
        return packed(write, **fields)

    assert refusals(load, tmp_path / "log.npz", packed(write, **content), (damaged, changed)) > INPUTS / 2


@pytest.mark.parametrize("suffix", [".g2o", ".txt"])
def test_pose_graphs(tmp_path, suffix) -> None:
    whole = next(path for path in files(tmp_path) if path.suffix == suffix).read_bytes()
    assert refusals(open_recordings, tmp_path / f"other{suffix}", whole, (damaged, respelt)) > INPUTS / 2


@pytest.mark.parametrize(("name", "zipped"), [*((name, False) for name in MRCLAM), ("Robot1_Measurement.dat", True)])
def test_mrclam_sets(tmp_path, name, zipped) -> None:
    for each, text in MRCLAM.items():
        (tmp_path / each).write_text(text)
    assert len(mrclam(tmp_path, 1)) == 3
    path, whole = tmp_path / name, MRCLAM[name].encode()
    if zipped:
        path.unlink()
        path, whole = tmp_path / f"{name}.gz", gzip.compress(whole, mtime=0)
    damages = (damaged,) if zipped else (damaged, respelt)
    assert refusals(lambda _: mrclam(tmp_path, 1), path, whole, damages, tmp_path) > 0


@pytest.mark.parametrize("name", PARK)
def test_matlab_files(tmp_path, name) -> None:
    def cut(whole, rng):
        return whole[: rng.integers(len(whole))]

    def changed(_, rng):
        tables = {key: np.array(table) for key, table in PARK[name].items() if key != "zt"}
        key = sorted(tables)[rng.integers(len(tables))]
        table = tables[key]
        table.flat[rng.integers(table.size)] = rng.choice([np.nan, np.inf, 1e300, -3.0, 0.5])
        kinds = (table, table.T, table[:-1], np.array("text"))
        tables[key] = kinds[rng.integers(len(kinds))]
        return packed(savemat, PARK[name] | tables)

    for each, tables in PARK.items():
        savemat(tmp_path / f"{each}.mat", tables)
    path = tmp_path / f"{name}.mat"
    assert len(victoria_park(tmp_path)) == 2
    found = refusals(lambda _: victoria_park(tmp_path), path, path.read_bytes(), (cut, changed), tmp_path)
    assert found > INPUTS / 2


def test_floor_plans(tmp_path) -> None:
    path = tmp_path / "plan.json"
    save_floor_plan(square(), path)
    assert refusals(load_floor_plan, path, path.read_bytes(), (damaged,)) > INPUTS / 2


@pytest.mark.parametrize("suffix", ["png", "pgm", "npy", "npy.gz"])
def test_images(tmp_path, suffix) -> None:
    cv2 = pytest.importorskip("cv2", reason="needs the extra `maps`")
    image = blank()
    whole = packed(np.save, image) if suffix.startswith("npy") else cv2.imencode(f".{suffix}", image)[1].tobytes()
    whole = gzip.compress(whole, 1, mtime=0) if suffix.endswith("gz") else whole
    assert refusals(lambda path: load_floor_plan(path, 0.1), tmp_path / f"map.{suffix}", whole, (damaged,)) > 0


def test_ros_maps(tmp_path) -> None:
    pytest.importorskip("cv2", reason="needs the extra `maps`")
    (tmp_path / "image.npy").write_bytes(packed(np.save, blank()))
    text = b"image: image.npy\nresolution: 0.05\norigin: [-3.0, 2.0, 0.0]\nnegate: 0\nfree_thresh: 0.196\n"
    assert refusals(load_floor_plan, tmp_path / "map.yaml", text, (damaged, respelt)) > INPUTS / 3


def test_weights(tmp_path) -> None:
    own, card = tmp_path / "mine.npz", weights.card_of("driver")
    ships = weights.load("driver", card.version, card.inputs, card.shapes)
    weights.write(own, ships)

    def read(_):
        return weights.load(own, card.version, card.inputs, card.shapes)

    for path in (own, own.with_suffix(".json")):
        assert refusals(read, path, path.read_bytes(), (damaged,), own.name) > INPUTS / 3


def test_files_above_the_limit_are_refused(tmp_path) -> None:
    (tmp_path / "log.npz").write_bytes(bytes((1 << 26) + 1))
    with pytest.raises(ValueError, match=r"log\.npz: .*larger than 64 MB"):
        load(tmp_path / "log.npz")
    bomb = packed(np.savez_compressed, times=np.zeros(1 << 23), format="slam_gym recording")
    (tmp_path / "log.npz").write_bytes(bomb)
    assert len(bomb) < 1 << 20
    with pytest.raises(ValueError, match=r"log\.npz: .*unpacks to more than 64 MB"):
        load(tmp_path / "log.npz")


def test_an_archive_that_unpacks_to_more_than_it_declares_is_refused_before_it_does(tmp_path):
    for kind in (zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2):
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w", kind) as archive:
            archive.writestr("mean.npy", bytes(200 << 20))
        content = packed.getvalue()
        at = content.rindex(b"PK\x01\x02") + 24  # its declared size
        (tmp_path / "bomb.npz").write_bytes(content[:at] + (100).to_bytes(4, "little") + content[at + 4 :])
        tracemalloc.start()
        with pytest.raises(ValueError, match="not a readable zip file"):
            zip_members(tmp_path / "bomb.npz")
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert most < 100 << 20
