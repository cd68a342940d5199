"""Floor plan files: JSON for reading and writing, occupancy images and ROS maps for reading."""

import json
import reprlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_gym._files import array_of, content_of, json_of, replacing
from slam_gym.world.floor_plan import (
    MAX_EXTENT,
    MAX_PIXELS,
    Door,
    Features,
    FloorPlan,
    FloorPlanError,
    Kind,
    Room,
    checked_array,
)

FORMAT, VERSION = "slam_gym floor plan", 1
_UNKNOWN_GREY = 205  # in what map_saver writes, with a `free_thresh` of 0.25 for years in nav2
_MAX_JSON, _MAX_YAML = 1 << 24, 1 << 13  # bytes; files of real floors take less than a tenth
_MAX_ARRAY = 8 * MAX_PIXELS + 1024  # bytes: 64-bit labels and a header
_LARGEST = 1e9  # any number in a ROS map


def save_floor_plan(plan: FloorPlan, path: str | Path) -> None:
    """Write `plan` as JSON; `load_floor_plan` reads exactly the same numbers.

    Raises FloorPlanError, before anything is written, for names that `load_floor_plan` refuses.
    """
    for field, name in (("name", plan.name), *(("room: name", room.name) for room in plan.rooms)):
        _text(field, name)
    features = plan.features
    document = {
        "format": FORMAT,
        "version": VERSION,
        "name": plan.name,
        "walls": plan.walls.tolist(),
        "features": [
            {"position": position.tolist(), "kind": Kind(kind).name.lower(), "size": float(size)}
            for position, kind, size in zip(features.positions, features.kinds, features.sizes)
        ],
        "rooms": [{"name": room.name, "polygon": room.polygon.tolist()} for room in plan.rooms],
        "doors": [
            {"position": door.position.tolist(), "width": door.width, "rooms": list(door.rooms)} for door in plan.doors
        ],
        "furniture": [
            dict(zip(("position", "length", "width", "heading"), ([x, y], length, width, heading)))
            for x, y, length, width, heading in plan.furniture.tolist()
        ],
    }
    with replacing(Path(path)) as file:
        file.write(f"{json.dumps(document, allow_nan=False, separators=(',', ':'))}\n".encode())


def load_floor_plan(path: str | Path, resolution: float | None = None) -> FloorPlan:
    """Read a floor plan: `.json` as written by `save_floor_plan`, a ROS map `.yaml`, or an occupancy image.

    Images (`.pgm`, `.png`, `.npy`, `.npy.gz`) need a `resolution` [m/pixel]; a ROS map contains its own. Raises
    FloorPlanError naming file, field and reason, FileNotFoundError, or ImportError naming the missing extra.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no floor plan file at {path}")
    try:
        suffix = path.suffix.lower()
        if resolution is not None and suffix in (".json", ".yaml", ".yml"):
            raise FloorPlanError("resolution", "is for images; this file contains its own scale")
        if suffix == ".json":
            return _parse(path)
        if not path.name.lower().endswith((".pgm", ".png", ".npy", ".npy.gz", ".yaml", ".yml")):
            raise FloorPlanError("file", f"unknown suffix {path.suffix!r}; known: .json .yaml .pgm .png .npy .npy.gz")
        from slam_gym.world.raster import from_raster  # needs OpenCV, an extra, and takes long to import

        read = _read_ros_map if suffix in (".yaml", ".yml") else _read_labelled_image
        return from_raster(**read(path, resolution))
    except FloorPlanError as error:
        raise FloorPlanError(error.field, error.reason, str(path)) from None


def _parse(path: Path) -> FloorPlan:
    try:
        document = json_of(content_of(path, _MAX_JSON))
    except (ValueError, OSError) as error:
        raise FloorPlanError("file", f"is not JSON ({error})") from None
    keys = ("format", "version", "name", "walls", "features", "rooms", "doors", "furniture")
    format_, version, name, walls, features, rooms, doors, furniture = _values("file", document, keys)
    if (format_, version) != (FORMAT, VERSION):
        found = f"{reprlib.repr(format_)}, {reprlib.repr(version)}"
        raise FloorPlanError("format, version", f"{found}: expected {FORMAT!r}, {VERSION}")
    positions, names, sizes = _columns("features", features, ("position", "kind", "size"))
    known = [kind.name.lower() for kind in Kind]
    if unknown := [f"features[{i}].kind" for i, kind in enumerate(names) if kind not in known]:
        raise FloorPlanError(unknown[0], f"known are {', '.join(known)}")
    places, *measures = _columns("furniture", furniture, ("position", "length", "width", "heading"))
    boxes = [checked_array("furniture: position", places, 2)]
    boxes += [checked_array("furniture: sizes", measure) for measure in measures]
    return FloorPlan(
        _text("name", name),
        walls,
        Features(positions, np.array([known.index(kind) for kind in names], np.int64), sizes),
        tuple(Room(_text("room: name", n), p) for n, p in zip(*_columns("rooms", rooms, ("name", "polygon")))),
        tuple(
            Door(position, width, _pair(joined))
            for position, width, joined in zip(*_columns("doors", doors, ("position", "width", "rooms")))
        ),
        np.column_stack(boxes),
    )


def _values(where: str, record: Any, keys: tuple[str, ...]) -> list[Any]:
    """The values of a JSON object that has exactly these keys."""
    if not isinstance(record, dict):
        raise FloorPlanError(where, "is not an object")
    if odd := sorted(set(record) ^ set(keys)):
        key = reprlib.repr(odd[0])
        raise FloorPlanError(where, f"the key {key} is missing or unknown; known are {', '.join(keys)}")
    return [record[key] for key in keys]


def _columns(where: str, records: Any, keys: tuple[str, ...]) -> list[Any]:
    """The values of the objects in a JSON list, one list for each key."""
    if not isinstance(records, list):
        raise FloorPlanError(where, "is not a list")
    rows = [_values(f"{where}[{i}]", record, keys) for i, record in enumerate(records)]
    return [[row[k] for row in rows] for k in range(len(keys))]


def _pair(rooms: Any) -> tuple[str, str]:
    if not isinstance(rooms, list) or len(rooms) != 2:
        raise FloorPlanError("door: rooms", "is not a pair of room names")
    return _text("door: rooms", rooms[0]), _text("door: rooms", rooms[1])


def _text(where: str, value: Any) -> str:
    if not isinstance(value, str) or not 0 < len(value) <= 200:
        raise FloorPlanError(where, "is not a text of 1 to 200 characters")
    return value


def _read_labelled_image(path: Path, resolution: float | None) -> dict[str, Any]:
    """The arguments of `from_raster` for an image file.

    An array named `…_occ_map.npy.gz` is read together with the room labels `…_valid_space.npy.gz` beside it, if there
    are any: these are the names of the KTH floor plan data set.
    """
    if resolution is None:
        raise FloorPlanError("resolution", "an image needs its resolution in metres per pixel")
    image, labels = _read_image(path), path.with_name(path.name.replace("_occ_map", "_valid_space"))
    valid = _read_image(labels) if labels != path and labels.is_file() else None
    name = path.name.split(".")[0].removesuffix("_occ_map")
    return {"occupancy": image, "resolution": resolution, "name": name, "valid": valid}


def _read_ros_map(path: Path, resolution: float | None) -> dict[str, Any]:
    """The same for a map_server file: `image`, `resolution`, `origin` [x, y, yaw = 0], `negate`, `free_thresh`."""
    values = {"origin": [0.0, 0.0, 0.0], "resolution": resolution, "free_thresh": 0.196, "negate": 0} | _yaml(path)
    resolution, threshold = (_number(key, values[key]) for key in ("resolution", "free_thresh"))
    negate = values["negate"] if isinstance(values["negate"], bool) else _number("negate", values["negate"])
    if not 0.0 < threshold < 1.0:
        raise FloorPlanError("free_thresh", f"{threshold} is not between 0 and 1")
    if negate not in (0, 1):
        raise FloorPlanError("negate", f"{negate} is neither 0 nor 1")
    mode = values.get("mode", "trinary")
    if mode not in ("trinary", "scale"):
        raise FloorPlanError("mode", f"{reprlib.repr(mode)} is neither trinary nor scale")
    origin = values["origin"]
    if not isinstance(origin, list) or len(origin) != 3 or _number("origin", origin[2]) != 0.0:
        raise FloorPlanError("origin", f"{reprlib.repr(origin)} is not [x, y, 0]")
    x, y = _number("origin", origin[0]), _number("origin", origin[1])
    if max(abs(x), abs(y)) > MAX_EXTENT:
        raise FloorPlanError("origin", f"{reprlib.repr(origin)} lies beyond {MAX_EXTENT:g} m")
    image = _read_image(path.parent / str(values.get("image")))
    if image.dtype != np.uint8:
        raise FloorPlanError("image", f"holds {image.dtype}, expected uint8")
    grey = np.arange(256.0)
    occupied = grey / 255.0 if negate else (255.0 - grey) / 255.0
    unknown = (grey == (255 - _UNKNOWN_GREY if negate else _UNKNOWN_GREY)) & (mode == "trinary")  # at any `free_thresh`
    free = np.where((occupied < threshold) & ~unknown, 255, 0).astype(np.uint8)  # for each level of grey
    return {"occupancy": free[image], "resolution": resolution, "name": path.stem, "origin": (x, y)}


def _yaml(path: Path) -> dict[Any, Any]:
    """The mapping in a small YAML file."""
    try:
        import yaml
    except ImportError as error:
        raise ImportError('ROS maps need PyYAML: pip install "slam_gym[maps]"') from error
    try:
        document = yaml.safe_load(content_of(path, _MAX_YAML))
    except (yaml.YAMLError, ValueError, TypeError, AttributeError, OSError, RecursionError) as error:
        raise FloorPlanError("file", f"is not YAML ({error})") from None
    if not isinstance(document, dict) or not isinstance(document.get("image"), str):
        raise FloorPlanError("image", "the map names no image")
    return document


def _read_image(path: Path) -> NDArray[Any]:
    """The pixels (h, w) of an image: uint8 from PGM and PNG, integers or bools from arrays."""
    image: Any
    try:
        if path.name.lower().endswith((".npy", ".npy.gz")):
            image = array_of(content_of(path, _MAX_ARRAY), "biuf", _MAX_ARRAY)
        else:
            import cv2

            coded = np.frombuffer(content_of(path), np.uint8)
            whole: Any = cv2.imdecode(coded, cv2.IMREAD_UNCHANGED)
            has_alpha = whole is not None and whole.shape[2:] == (4,) and whole.dtype.kind == "u"
            if has_alpha and whole[..., 3].min() < np.iinfo(whole.dtype).max:
                raise ValueError("has transparent pixels, which may be wall or free space: make them opaque")
            image = cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE)
    except (ValueError, OSError) as error:
        raise FloorPlanError("image", str(error)) from None
    except Exception as error:  # OpenCV's own
        raise FloorPlanError("image", f"cannot be read ({error})") from None
    if image is None:
        raise FloorPlanError("image", "is not a PGM or PNG image, or not all of it is there")
    return np.asarray(image)


def _number(field: str, value: Any) -> float:
    """A finite number from a file. Raises FloorPlanError for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < _LARGEST:
        raise FloorPlanError(field, f"{reprlib.repr(value)} is not a number, or too large")
    return float(value)
