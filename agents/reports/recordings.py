"""The report of associators on recordings: per log its tables, the maps over the reference, the errors over time."""

from __future__ import annotations

import html
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from agents.evaluation.log_files import read_columns
from agents.evaluation.pipeline import Results
from agents.evaluation.recordings import COLUMNS, FOLDER, FURTHER_COLUMNS, columns_with_numbers, numbers
from agents.evaluation.records import Record, stem
from agents.evaluation.tables import Table, by_setting
from agents.reports.log_figures import Columns, errors_over_time, maps
from agents.reports.page import Report, card, heading, image, note, table
from slam_gym.geometry import transform
from slam_gym.types import Array

_WORDS = note(
    "Bold: the best of the column; true association, which nothing could know, is left out of that. <b>Precision</b>: "
    "of the pairings of measurements with a known identity, those with the right feature (of several with one "
    "identity, the oldest). <b>Recall</b>: of the measurements whose feature is in the map, those paired with it. The "
    "identity of a feature is that of the measurement that started it. <b>Feat.</b>: confirmed features in the end; "
    "<b>dupl.</b>: those of an identity that has an older one; <b>clut.</b>: those that a measurement without identity "
    "started; <b>found</b>: identities with at least one. <b>Clutter accepted</b>: fraction of the measurements "
    "without identity that were paired, <b>onto landmarks</b>: how many with a feature that has one. <b>ATE</b>, "
    "<b>median error</b>: of positions against the reference [m], after rigid alignment; <b>ATE₀</b>: as the log began "
    "in the frame of the reference. <b>Lm.</b>, <b>landmarks₀</b>: root mean square error of the landmarks found [m], "
    "likewise. <b>ANEES</b> of the poses: 1 for a consistent filter, above 1 for an overconfident one. <b>Nodes</b> of "
    "the interpretation tree are means a scan, <b>µs/scan</b> the median time of the associator, <b>µs/step</b> that "
    "of everything, <b>s</b> the whole log."
)


def report(results: Results, folder: Path) -> Report:
    """What is told of associators on recordings; the files of each log lie in `folder`."""
    names, groups, sections = results.names, by_setting(results.records), []
    for setting, rows in numbers(results.records).items():
        sections += [heading(setting), _about(groups.get(setting, []))]
        for columns in (COLUMNS, FURTHER_COLUMNS):
            sections.append(table(Table("", "associator", columns_with_numbers(rows, columns), rows), names))
        sections += _pictures(folder / FOLDER, setting, groups.get(setting, []))
    subtitle = f"EKF-SLAM over real logs, {len(names)} associators"
    return Report("Associators on recordings", subtitle, [*sections, _WORDS])


def _about(records: Sequence[Record]) -> str:
    if not records:
        return note("Means over the logs.")
    r = records[0]
    return note(f"{r['steps']} scans, {r['measurements']} measurements, {r['clutter']} of them spurious; "
                f"{r['true_features']} labelled features. {html.escape(r['source'])}")  # fmt: skip


class _Drawn(NamedTuple):
    """The files of one log and associator, in the frame of the reference."""

    errors: Columns
    features: Columns
    landmarks: Array  # (l, 2) [m] true ones


def _pictures(folder: Path, setting: str, records: Sequence[Record]) -> list[str]:
    """The maps over the reference and the errors over time; nothing where files are missing."""
    found = {record["associator"]: _read(folder / stem(setting, record["associator"]), record) for record in records}
    drawn = {name: files for name, files in found.items() if files is not None and len(files.errors["time"])}
    if not drawn:
        return []
    errors = {name: files.errors for name, files in drawn.items()}
    features = {name: files.features for name, files in drawn.items()}
    landmarks = next(iter(drawn.values())).landmarks
    return [
        card(image(maps(errors, features, landmarks), f"maps over the reference, {setting}")),
        card(image(errors_over_time(errors), f"position errors over time, {setting}")),
    ]


def _read(base: Path, record: Record) -> _Drawn | None:
    errors, features = (base.with_name(f"{base.name}.{kind}.csv") for kind in ("errors", "map"))
    if not (errors.exists() and features.exists()):
        return None
    columns = read_columns(features)
    align = np.array([record["align_x"], record["align_y"], record["align_heading"]])
    x, y = transform(align, np.column_stack([columns["x"], columns["y"]])).T
    return _Drawn(read_columns(errors), columns | {"x": x, "y": y}, np.array(record["landmarks"]).reshape(-1, 2))
