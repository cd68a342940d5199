"""The reports of evaluations: of drives, of the association suite, and of recordings, each one page of HTML.

A page is a list of parts in order: tables, pictures, films and paragraphs. Pictures are embedded in it; films are
separate files. The terminal shows the tables of the same page.
"""

import base64
import io
import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from matplotlib.figure import Figure

from agents.drivers.clairvoyant import Clairvoyant
from agents.evaluation.associators import JOIN
from agents.evaluation.episodes import LOST_MEANS, map_path
from agents.evaluation.mapped_log import DEVIANT, FOLDER
from agents.evaluation.pipeline import Results, read_results
from agents.evaluation.records import stem, undamaged, write_whole
from agents.evaluation.tables import (
    INTERVALS,
    Column,
    Rows,
    Table,
    cell,
    columns,
    counted,
    difference,
    display_name,
    estimate,
    estimate_of,
    estimates,
    grouped,
    share,
)
from agents.reports import figures
from agents.reports.film import BESIDE, film_path
from agents.suite import OUTCOMES
from slam_gym.metrics.statistics import Interval, mean
from slam_gym.scenarios.suite import EXPERIMENTS, RELOCATION
from slam_gym.simulation.judged import CEILING


class Picture(NamedTuple):
    """A figure of a page, drawn when the page is written."""

    alt: str
    draw: Callable[[], Figure]


class Film(NamedTuple):
    """A film of the first episode with its last picture."""

    name: str  # of the agent, or BESIDE
    path: Path  # .mp4; the picture beside it is .png


class Maps(NamedTuple):
    """Pictures of final maps, side by side."""

    title: str
    paths: Mapping[str, Path]  # name → .png


Part = Table | Picture | Film | Maps | str


@dataclass(frozen=True)
class Page:
    """The contents of a report: the terminal shows the tables of `parts`, then those of `headline` (the first last)."""

    title: str
    subtitle: str
    parts: Sequence[Part]
    notes: str  # the template that explains the columns
    headline: Sequence[Table] = ()  # at the beginning of the report

    @property
    def tables(self) -> list[Table]:
        return [part for part in (*self.parts, *self.headline[::-1]) if isinstance(part, Table) and not part.detail]


# -- drives: of drivers, or of associators in the loop -----------------------------------------------------------------

COLUMNS = {
    "drivers": columns(
        "map_error", "map_error_aligned", "coverage", "precision", "recall", "anees", "map_lost", "ticks",
        "ticks_per_second",
    ),
    "associators": columns(
        "precision", "recall", "f1", "exact", "duplicates", "nodes", "microseconds", "limits", "map_error_aligned",
        "map_error", "anees",
    ),
}  # fmt: skip
RELOCATION_COLUMNS = columns("recovered", "relocations_wrong", "ticks_astray")
PANELS = {
    "drivers": columns("map_error", "coverage"),
    "associators": columns("precision", "recall", "map_error_aligned", "microseconds"),
}
MEAN = "mean"  # over all scenarios
PAIRED = "paired over the worlds that all scenarios have; negative: the row makes the better map; bold: not 0 by chance"


def drives_page(results: Results, folder: Path) -> Page:
    """First paired differences, for associators with map errors and lost maps; a table for each scenario with its
    episodes; for drivers curves over time, for associators final maps; and the films in `folder`."""
    kind, groups, colour = results.metadata["kind"], grouped(results.frame, "name"), figures.colours(results.names)
    drivers, parts, first = kind == "drivers", list[Part](), [] if kind == "drivers" else headline(results.frame)
    for table, (setting, frame) in zip(drive_tables(results), grouped(results.frame, "setting").items()):
        dots = partial(figures.dot_chart, grouped(frame, "name"), PANELS[kind], colour)
        parts += [table, Picture(f"Each episode of {table.title}", dots)]
        if drawn := {name: path for name in groups if (path := map_path(folder, setting, name)).exists()}:
            parts.append(Maps(f"Maps at the end of the first episode of {table.title}", drawn))
    if drivers:
        curves = partial(figures.curve_chart, groups, PANELS[kind], colour)
        parts += [Picture("Over time: interquartile mean over worlds; band: its 95 % bootstrap interval", curves)]
    if len(groups) > 1:
        error = "map_error" if drivers else "map_error_aligned"  # drivers are rewarded by the former
        gaps: Rows = {
            name: {other: difference(own, groups[other], error) for other in groups if other != name}
            for name, own in groups.items()
        }
        others = [Column(name, display_name(name)) for name in groups]
        corner = f"{'' if drivers else 'aligned '}map error of … minus that of"
        against = Table("Against each other", corner, others, gaps, PAIRED, differences=True, detail=True)
        (parts if any(table.differences for table in first) else first).insert(0, against)
    for name in (BESIDE, *groups):
        if (path := film_path(folder, name)).with_suffix(".png").exists():
            parts.append(Film(name, path))
    title = "Drivers" if drivers else "Associators in the loop"
    worlds = {frozenset(zip(own["setting"], own["episode"])) for own in groups.values()}
    equal = "for all" if len(worlds) == 1 else "only in the paired differences, since rows have episodes of their own"
    subtitle = f"slam_gym/Explore-v0: the same {results.conditions['split']} worlds and seeds {equal}"
    return Page(title, subtitle, parts, "drives.html", first)


def drive_tables(results: Results) -> list[Table]:
    """One table per scenario, with rows in the order of the command.

    Models of one agent are pooled. Where a robot was carried away, there are columns on relocation.
    """
    kind, tables = results.metadata["kind"], []
    for setting, frame in grouped(results.frame, "setting").items():
        shown = COLUMNS[kind] + (RELOCATION_COLUMNS if frame["kidnapped"].any() else [])
        counts = frame.groupby("name")["episode"].nunique()
        most = counted(counts.max(), "episode")
        title = f"{setting}, " + (most if counts.nunique() == 1 else f"{counts.min()} to {most}")
        title += "" if kind == "drivers" else f", driven by {display_name(results.conditions['driver'])}"
        rows = {name: estimates(episodes, shown) for name, episodes in grouped(frame, "name").items()}
        caption = f"interquartile mean{INTERVALS}"
        if Clairvoyant.name in rows:
            caption += "; clairvoyant is shown the plan: the upper reference"
        if "missed_loop" in frame and (missed := int(frame["missed_loop"].sum())):
            drives = counted(len(frame), "drive")
            caption += f"; in {missed} of {drives} the robot says that it has mapped a place twice"
        tables.append(Table(title, kind.removesuffix("s"), shown, rows, caption))
    return tables


def headline(frame: pd.DataFrame) -> list[Table]:
    """Two tables: paired differences to true association with the same relocation, where there are any, and aligned map
    errors with errors that are not aligned and lost maps."""
    groups, (error, raw, lost) = grouped(frame, "name"), columns("map_error_aligned", "map_error", "map_lost")
    settings = list(grouped(frame, "setting"))
    shown = settings if len(settings) == 1 else [*settings, MEAN]
    means = [Column(setting, setting, 3, "lower") for setting in shown]
    errors: Rows = {}
    gaps: Rows = {}
    for name, own in groups.items():
        parts = grouped(own, "setting") | {MEAN: own}
        errors[name] = {setting: estimate_of(some, error.key, mean) for setting, some in parts.items()}
        errors[name] |= {raw.key: estimate_of(own, raw.key, mean), lost.key: estimate_of(own, lost.key, share)}
        associator, join, relocation = name.partition(JOIN)
        truth = f"{CEILING}{join}{relocation}"
        if associator != CEILING and truth in groups:
            gaps[name] = {setting: difference(some, groups[truth], error.key, mean) for setting, some in parts.items()}
    caption = f"mean map error after rigid alignment{INTERVALS}; {raw.title}: without it; {LOST_MEANS}"
    caption += "; means are over the worlds that all scenarios have"
    tables = [Table("Aligned map error, mean", "associator", [*means, raw, lost], errors, caption)]
    if gaps:
        caption = f"mean over the same worlds{INTERVALS}"
        title = "Aligned map error above that of true association with the same relocation"
        tables.insert(0, Table(title, "associator", means, gaps, caption, differences=True))
    return tables


# -- the suite: one number per capability, from the results of worlds --------------------------------------------------

MISTAKES = columns("spoiled", "refused")
EFFORT = columns("nodes", "microseconds", "limits")
DETAILS = [*columns("exact", "precision", "recall"), *MISTAKES, *columns("promised", "kept"), *EFFORT]


def suite_page(results: Results, folder: Path) -> Page:
    """The paired differences in the ranking, the scores, and a plot for each capability."""
    size, colour, parts = results.conditions, figures.colours(results.names), list[Part]()
    about = f"{counted(size['worlds'], 'world')} a level, up to {counted(size['problems'], 'scan')} in each"
    association = results.frame[results.frame["experiment"] != RELOCATION]
    if len(association):
        capability_scores, mistakes = scores(association), details(association, MISTAKES)
        shown = [Column(name, name, 3, "higher") for name in by_world(association)]
        if gaps := leads(association):
            caption = "paired over worlds; bold: the interval excludes 0"
            parts.append(Table("Ahead of the next", "ahead of the next by", shown, gaps, caption, True, detail=True))
        rows: Rows = {name: own | mistakes[name] for name, own in capability_scores.items()}
        parts.append(Table(f"Capabilities, {about}", "associator", [*shown, *MISTAKES], rows))
        parts.append(Picture("Score per capability", partial(figures.capability_bars, capability_scores, colour)))
    for name, frame in results.frame.groupby("experiment", sort=False):
        experiment = EXPERIMENTS[str(name)]
        if name == RELOCATION:
            table = relocations(frame, f"Kidnapped: searches without a prior, {about}")
        else:
            table = Table(experiment.name.capitalize(), "associator", DETAILS, details(frame, DETAILS), "", detail=True)
        curves = {row: levels(frame[frame["name"] == row]) for row in table.rows}
        chart = partial(figures.level_chart, curves, experiment.axis, colour)
        parts += [table, f"{experiment.question} {experiment.why}", Picture(f"Score against {experiment.axis}", chart)]
    subtitle = f"{about}, of the {size['split']} split, the same for all: single scans against real SLAM maps"
    return Page("The association suite", subtitle, parts, "suite.html")


def relocations(frame: pd.DataFrame, title: str = "") -> Table:
    """The scores of searches without a prior, the number of each outcome, and their effort, best first."""
    counts, score = frame.groupby("name")[list(OUTCOMES)].sum(), columns("score")
    rows = {name: own | counts.loc[name].to_dict() for name, own in details(frame, [*score, *EFFORT]).items()}
    outcomes = [Column(outcome, outcome, 0) for outcome in OUTCOMES]
    return Table(title, "search", [*score, *outcomes, *EFFORT], rows)


def by_world(frame: pd.DataFrame, key: str = "score") -> pd.DataFrame:
    """The mean of a number over the levels, with a row for each name and world and a column for each experiment, in the
    order of the suite; column `all` is the mean of these. NaN for a world that lacks the number in one level."""
    wide = frame.pivot(index=["name", "episode"], columns=["experiment", "setting"], values=key)
    table = pd.DataFrame({name: wide[name].mean(axis=1, skipna=False) for name in EXPERIMENTS if name in wide})
    return table.assign(all=table.mean(axis=1, skipna=False))


def scores(frame: pd.DataFrame) -> dict[str, dict[str, Interval]]:
    """Name → experiment → interquartile mean over worlds; `all` is that of the means over experiments. Best first."""
    worlds = by_world(frame)
    found = {name: _estimates(worlds.loc[name]) for name in frame["name"].unique()}
    means = {name: own["all"].estimate for name, own in found.items()}
    return {name: found[name] for name in sorted(found, key=lambda name: (math.isnan(means[name]), -means[name]))}


def leads(frame: pd.DataFrame) -> Rows:
    """Name → experiment → paired difference over worlds between its score and that of the next in rank."""
    worlds = by_world(frame)
    return {name: _estimates(worlds.loc[name] - worlds.loc[after]) for name, after in pairwise(scores(frame))}


def details(frame: pd.DataFrame, shown: Sequence[Column]) -> Rows:
    """Name → key of a column → interquartile mean over worlds of the mean over all levels. Best first."""
    worlds = pd.DataFrame({column.key: by_world(frame, column.key)["all"] for column in shown})
    return {name: _estimates(worlds.loc[name]) for name in scores(frame)}


def levels(frame: pd.DataFrame) -> dict[float, Interval]:
    """Knob → score, for one name in one experiment."""
    return {float(knob): estimate(own) for knob, own in frame.groupby("knob", sort=False)["score"]}


def _estimates(worlds: pd.DataFrame) -> dict[str, Interval]:
    return {str(column): estimate(worlds[column]) for column in worlds}


# -- recordings: the measures of each associator on each log, with maps and errors -------------------------------------

LOG_COLUMNS = columns(
    "precision", "recall", "f1", "features", "duplicates", "clutter_features", "ate", "ate_batch", "landmark_rmse",
    "landmarks_compared", "landmark_rmse_batch", "anees", "seconds",
)  # fmt: skip
FURTHER_LOG_COLUMNS = columns(
    "ate_median", "ate_unaligned", "landmark_rmse_unaligned", "wrong", "clutter_share", "clutter_on_landmarks", "found",
    "nodes", "microseconds", "step_microseconds", "limits",
)  # fmt: skip
LOG_SIGNS = (
    ("missed_loop", 0.0, "The robot says that it has mapped a place twice"),
    ("deviation", DEVIANT, "By the D² of the pairings, the sigmas are probably too small"),
)
"""Columns that are no measures, the value above which they tell something, and what."""

LOG_NOTES = {
    "ate": "ATE, lm.: RMSE of positions, of landmarks [m], aligned.",
    "ate_batch": "batch: by batch least squares with the same pairings, the maximum-likelihood estimate for them.",
    "landmarks_compared": "of lm.: landmarks of the reference that are in the map, and so in lm.",
    "features": "feat.: confirmed features.",
    "duplicates": "dupl.: further features of a landmark; clut.: of no landmark.",
    "seconds": "s: time of the whole log.",
}
"""Column → what is said below a table that contains it."""


def recordings_page(results: Results, folder: Path) -> Page:
    """For each log its tables, maps over the reference, and errors over time; means where there are several logs."""
    logs, colour, parts = grouped(results.frame, "setting"), figures.colours(results.names), list[Part]()
    for name, own in logs.items():
        about = own.iloc[0]
        parts += log_tables(own, f"{name}, {about['steps']} scans, {about['true_features']} labelled features")
        parts.append(f"{about['measurements']} measurements, {about['clutter']} of them spurious. {about['source']}")
        parts += _pictures(name, own["name"], folder / FOLDER, colour)
    if len(logs) > 1:
        parts += log_tables(log_means(results.frame), "mean")
    subtitle = f"EKF-SLAM over real logs, {counted(len(results.names), 'associator')}"
    return Page("Associators on recordings", subtitle, parts, "recordings.html")


def log_tables(frame: pd.DataFrame, title: str) -> list[Table]:
    """Two tables of one log, or of means: the most important columns, and further ones. Empty columns are left out."""
    numbers = frame.set_index("name")[[column.key for column in (*LOG_COLUMNS, *FURTHER_LOG_COLUMNS)]].astype(float)
    filled = numbers.dropna(axis=1, how="all")
    notes = "\n".join(note for key, note in LOG_NOTES.items() if key in filled)
    for key, most, text in LOG_SIGNS:
        said = frame["name"][frame[key] > most] if key in frame else ()
        if len(said):
            notes += f"\n{text}: {', '.join(map(display_name, said))}."
    first, further = ([c for c in shown if c.key in filled] for shown in (LOG_COLUMNS, FURTHER_LOG_COLUMNS))
    rows = filled.to_dict("index")
    return [Table(title, "associator", first, rows, notes), Table("", "associator", further, rows, "", detail=True)]


def log_means(frame: pd.DataFrame) -> pd.DataFrame:
    """The means of each associator that was run over all logs, in their order; NaN where a log has none."""
    groups = frame.groupby("name", sort=False)
    shown = [column.key for column in (*LOG_COLUMNS, *FURTHER_LOG_COLUMNS)]
    table = groups[shown].agg(lambda values: values.mean(skipna=False))
    return table[groups["setting"].nunique() == frame["setting"].nunique()].reset_index()


def _pictures(log: str, names: pd.Series, folder: Path, colour: figures.Colours) -> list[Part]:
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


PAGES = {"drivers": drives_page, "associators": drives_page, "suite": suite_page, "recordings": recordings_page}
"""Kind of an evaluation → the function that makes its page from the results and their folder."""


# -- one page of HTML --------------------------------------------------------------------------------------------------


def write_report(folder: Path, track: Callable[[Sequence[Part]], Iterable[Part]] = iter) -> Page:
    """Write report.html to the folder of an evaluation, from the files there, and return its page.

    Parts are drawn as they come out of `track`, which may show progress. Raises ValueError where the folder contains no
    evaluation, no finished episode, damaged results, or a kind of evaluation with a page of its own.
    """
    results = read_results(folder)
    kind = results.metadata["kind"]
    if kind not in PAGES:
        raise ValueError(f"{folder} belongs to the {kind}, which makes its own page")
    with undamaged(f"results.csv or results.json of {folder}"):
        page = PAGES[kind](results, folder)
        text = _TEMPLATES.get_template("report.html").render(
            page=page,
            parts=track([*page.headline, *page.parts]),
            complete=results.metadata["complete"],
            split=results.conditions.get("split"),
            provenance=json.dumps(results.metadata, indent=1, ensure_ascii=False),
            colours=figures.colours(results.names),
        )
    write_whole(folder / "report.html", text)
    return page


def data_url(picture: Picture | Path) -> str:
    """A data URL with a figure, or with the contents of a .png file."""
    if isinstance(picture, Path):
        png = picture.read_bytes()
    else:
        buffer = io.BytesIO()
        picture.draw().savefig(buffer, format="png")
        png = buffer.getvalue()
    return f"data:image/png;base64,{base64.b64encode(png).decode('ascii')}"


_TEMPLATES = Environment(
    loader=FileSystemLoader(Path(__file__).with_name("templates")),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
_TEMPLATES.filters |= {"display_name": display_name, "data_url": data_url}
_TEMPLATES.globals |= {"cell": cell}
