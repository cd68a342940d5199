"""The HTML report of associators on recordings: one section per log."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from agents.evaluation.associators import CEILING
from agents.evaluation.recording_files import read_columns, stem
from agents.evaluation.recordings import COLUMNS, MORE, shown_columns, tables, text
from agents.evaluation.results import Column, Record
from agents.reports.associators import header, label, page, picture, provenance, read, unfinished
from agents.reports.recording_figures import errors_over_time, maps
from slam_gym.geometry import transform

_WIDE = "<style>main { max-width: 1240px } th, td { padding: 6px 7px; white-space: nowrap }</style>"
_WORDS = """<p class="soft">Bold: the best of the column; true association, which nothing could know, is left out of
that. <b>Precision</b>: of the pairings of measurements with a known identity, those with the right feature (of several
with one identity, the oldest). <b>Recall</b>: of the measurements whose feature is in the map, those paired with it.
The identity of a feature is that of the measurement that started it. <b>Feat.</b>: confirmed features in the end;
<b>dupl.</b>: those of an identity that has an older one; <b>clut.</b>: those that a measurement without identity
started; <b>found</b>: identities with at least one. <b>Clutter accepted</b>: share of the measurements without identity
that were paired, <b>onto landmarks</b>: how many with a feature that has one. <b>ATE</b>, <b>median error</b>: of
positions against the reference [m], after rigid alignment; <b>ATE₀</b>: as the run began in the frame of the reference.
<b>Lm.</b>, <b>landmarks₀</b>: root mean square error of the landmarks found [m], likewise. <b>ANEES</b> of the poses: 1
for a consistent filter, above 1 for an overconfident one. <b>Nodes</b> of the interpretation tree are means a scan,
<b>µs/scan</b> the median time of the associator, <b>µs/step</b> that of everything, <b>s</b> the whole run.</p>"""


def write_report(folder: Path, names: Sequence[str]) -> Path:
    """Write report.html into the folder of an evaluation on recordings, and return its path."""
    results, records = read(folder)
    records = [record for record in records if record["associator"] in names]
    names = [name for name in names if any(record["associator"] == name for record in records)]
    table = tables(records, names)
    body = [_WIDE]
    for setting, rows in table.items():
        body.append(f"<h2>{html.escape(setting)}</h2>")
        body.append(_about([record for record in records if record["setting"] == setting]))
        body += [_table(rows, names, COLUMNS), _table(rows, names, MORE)]
        body += _pictures(folder / "runs", setting, [r for r in records if r["setting"] == setting], names)
    body += [_WORDS, provenance(results)]
    subtitle = f"EKF-SLAM over real logs, {len(names)} associators{unfinished(results)}"
    path = folder / "report.html"
    path.write_text(page("Associators on recordings", subtitle, "\n".join(body)), encoding="utf-8")
    return path


def _about(records: Sequence[Record]) -> str:
    if not records:
        return '<p class="soft">Means over the logs.</p>'
    r = records[0]
    return (
        f'<p class="soft">{r["steps"]} scans, {r["measurements"]} measurements, {r["clutter"]} of them spurious; '
        f"{r['true_features']} labelled features. {html.escape(r['source'])}</p>"
    )


def _table(rows: dict[str, dict[str, float]], names: Sequence[str], columns: Sequence[Column]) -> str:
    shown = shown_columns(rows, columns)
    best = {column.key: _best({name: row[column.key] for name, row in rows.items()}, column) for column in shown}
    lines = [header(["associator", *(column.title for column in shown)])]
    for name, row in rows.items():
        cells = "".join(
            f"<td{' class=best' if name in best[c.key] else ''}>{text(row[c.key], c.digits)}</td>" for c in shown
        )
        lines.append(f"<tr><td>{label(names, name)}</td>{cells}</tr>")
    return f'<div class="card"><table>{"".join(lines)}</table></div>'


def _best(found: dict[str, float], column: Column) -> set[str]:
    """The names with the best number as it is shown; none where that is all of them. No ceiling."""
    known = {name: value for name, value in found.items() if name != CEILING and math.isfinite(value)}
    if not column.better or len(known) < 2:
        return set()
    first = (min if column.better == "lower" else max)(known.values())
    tied = {name for name, value in known.items() if text(value, column.digits) == text(first, column.digits)}
    return tied if len(tied) < len(known) else set()


def _pictures(folder: Path, setting: str, records: Sequence[Record], names: Sequence[str]) -> list[str]:
    """The maps over the reference and the errors over time; nothing where files are missing."""
    errors, features, landmarks = {}, {}, np.empty((0, 2))
    for record in records:
        base = folder / stem(setting, record["associator"])
        files = (base.with_name(f"{base.name}.errors.csv"), base.with_name(f"{base.name}.map.csv"))
        if not all(file.exists() for file in files):
            continue
        errors[record["associator"]], found = (read_columns(file) for file in files)
        align = np.array([record["align_x"], record["align_y"], record["align_heading"]])
        x, y = transform(align, np.column_stack([found["x"], found["y"]])).T
        features[record["associator"]] = found | {"x": x, "y": y}
        landmarks = np.array(record["landmarks"]).reshape(-1, 2)
    drawn = [name for name in names if name in errors]
    if not drawn or not len(errors[drawn[0]]["time"]):
        return []
    return [
        picture(maps(errors, features, landmarks, drawn), f"maps over the reference, {setting}"),
        picture(errors_over_time(errors, drawn), f"position errors over time, {setting}"),
    ]
