"""The page of recordings: the measures of each associator on each log, with maps and errors."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import pandas as pd

from agents.evaluation.mapped_log import FOLDER
from agents.evaluation.pipeline import Results
from agents.evaluation.records import stem
from agents.evaluation.tables import Table, by_setting, columns, counted
from agents.reports import figures
from agents.reports.figures import Colours
from agents.reports.page import Page, Part, Picture

COLUMNS = columns(
    "precision", "recall", "f1", "features", "duplicates", "clutter_features", "ate", "ate_batch", "landmark_rmse",
    "landmark_rmse_batch", "anees", "seconds",
)  # fmt: skip
FURTHER_COLUMNS = columns(
    "ate_median", "ate_unaligned", "landmark_rmse_unaligned", "wrong", "clutter_share", "clutter_on_landmarks", "found",
    "nodes", "microseconds", "step_microseconds", "limits",
)  # fmt: skip
CAPTION = """ATE, lm.: RMSE of positions, of landmarks [m], aligned; batch: by batch
least squares with the same pairings; with true pairings, it is the best possible result.
feat.: confirmed features; dupl.: further ones of a landmark; clut.: of no landmark.
s: time of the whole log."""


def recordings_page(results: Results, folder: Path) -> Page:
    """For each log its tables, maps over the reference, and errors over time; means where there are several logs."""
    logs, colour, parts = by_setting(results.frame), figures.colours(results.names), list[Part]()
    for name, own in logs.items():
        about = own.iloc[0]
        title = f"{name}, {about['steps']} scans, {about['true_features']} labelled features"
        parts += [
            *tables(own, title),
            f"{about['measurements']} measurements, {about['clutter']} of them spurious. {about['source']}",
        ]
        parts += _pictures(name, own["name"], folder / FOLDER, colour)
    if len(logs) > 1:
        parts += tables(means(results.frame), "mean")
    subtitle = f"EKF-SLAM over real logs, {counted(len(results.names), 'associator')}"
    return Page("Associators on recordings", subtitle, parts, "recordings.html")


def tables(frame: pd.DataFrame, title: str) -> list[Table]:
    """Two tables of one log, or of means: the most important columns, and further ones. Empty columns are left out."""
    both = []
    for shown in (COLUMNS, FURTHER_COLUMNS):
        filled = [column for column in shown if frame[column.key].notna().any()]
        rows = frame.set_index("name")[[column.key for column in filled]].astype(float).to_dict("index")
        both.append(Table(title, "associator", filled, rows, CAPTION))
    return [both[0], replace(both[1], title="", caption="", detail=True)]


def means(frame: pd.DataFrame) -> pd.DataFrame:
    """The means of each associator that was run over all logs, in the order of the frame."""
    groups = frame.groupby("name", sort=False)
    table = groups[[column.key for column in (*COLUMNS, *FURTHER_COLUMNS)]].mean()
    return table[groups["setting"].nunique() == frame["setting"].nunique()].reset_index()


def _pictures(log: str, names: pd.Series, folder: Path, colour: Colours) -> list[Part]:
    """Maps and errors of the associators whose files exist, if the log has a reference."""
    errors, features = {}, {}
    for name in names:
        files = [folder / f"{stem(log, name)}.{kind}.csv" for kind in ("errors", "map")]
        if all(file.exists() for file in files) and len(error := pd.read_csv(files[0])):
            errors[name], features[name] = error, pd.read_csv(files[1])
    places = [folder / f"{stem(log)}.{of}.csv" for of in ("reference", "landmarks")]
    if not errors or not all(file.exists() for file in places):
        return []
    reference, landmarks = (pd.read_csv(file).to_numpy() for file in places)
    maps = partial(figures.maps, errors, features, reference, landmarks, colour)
    over_time = partial(figures.errors_over_time, errors, colour)
    return [Picture(f"Maps over the reference, {log}", maps), Picture(f"Position errors over time, {log}", over_time)]
