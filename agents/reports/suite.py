"""The report of the association suite: the numbers, their order with the reasons, and a plot per capability."""

from __future__ import annotations

import html
from pathlib import Path

from agents.evaluation.pipeline import Results
from agents.evaluation.records import Record
from agents.evaluation.tables import Column, Rows, Table, Value, cell, display_name
from agents.reports.page import Report, card, heading, image, note, table
from agents.reports.suite_figures import capability_bars, level_chart, outcome_bars, radar, reliability_chart
from agents.suite import reliability
from agents.suite.numbers import (
    RELOCATION_COLUMNS,
    SuiteRecords,
    interval,
    paired_difference,
    relocation_rows,
    score_columns,
    split_records,
)
from slam_gym.scenarios.suite import EXPERIMENTS, RELOCATION
from slam_gym.simulation.judged import CEILING

ABOUT = {
    "nearest_neighbour": "decides each measurement by itself, for the nearest compatible feature.",
    "global_nearest_neighbour": "gives each feature to one measurement, by the least sum of single distances.",
    "singles": "pairs only where measurement and feature have no other candidate.",
    "one_point_ransac": "lets single pairings vote for a pose, and keeps what agrees with the best of them.",
    "jcbb": "searches for the largest set of pairings whose innovations agree with each other.",
    "ipjc": "searches as JCBB does, but tests a set after moving the pose to where it puts the robot.",
    "map_hypothesis": "searches for the most probable set, in which a pairing must be likelier than clutter.",
    "marginal": "pairs only what is probable enough over all sets of pairings, by the cost of a mistake.",
    "learned": "decides as `marginal` does, by odds that a network has learned besides: sizes, rivals, clutter.",
    CEILING: "is told the truth: the ceiling.",
}
_WORDS = (
    note("Every number lies between 0 and 1. A scan earns (right − 10 · wrong pairings) over the measurements whose "
         "feature is in the map, but not less than −1, which one wrong pairing mostly comes to: 1 without a mistake, 0 "
         "for refusing everything, less for spoiling the scan, since a wrong pairing bends the map for good while a "
         "refusal only wastes a measurement. A number is the mean over the levels of an experiment, none below 0; "
         "interquartile mean over worlds, 95&nbsp;% bootstrap interval below it. Bold: the best, and all whose "
         "interval overlaps with it; the ceiling is left out of that.")
    + note("<b>Spoiled</b> are scans with a wrong pairing; <b>refused</b>, measurements of a mapped feature that were "
           "left unpaired; <b>exact</b>, scans with neither.")
)  # fmt: skip
_RELIABLE = note(
    "Some associators say how probable each of their decisions is, pairing or refusal. Here all decisions are gathered "
    "by that probability: on the dashed line what is said comes true just as often, below it too much is said."
)
_KIDNAPPED = note(
    "An answer inside the map is <b>correct</b> within 0.3 m and 3°, else <b>wrong</b>; a search may also stay "
    "<b>silent</b>. In another building it has to be <b>refused</b>; a pose is <b>invented</b>. Score: (correct − "
    "wrong, of those inside, not below 0) times (refused, of those outside), so that neither always answering nor "
    "never does well. All searches look within covisibility localities."
)
_EFFORT = (Column("nodes", "nodes", 0), Column("microseconds", "µs", 0), Column("limits", "limit met", 0))
_DETAILS = (
    Column("exact", "exact scans", 3), Column("precision", "precision", 3), Column("recall", "recall", 3),
    Column("spoiled", "spoiled", 3), Column("refused", "refused", 3), *_EFFORT,
)  # fmt: skip


def report(results: Results, folder: Path) -> Report:
    """What is told of a run of the suite; suite.png (bars) and radar.png are written into `folder` as well."""
    association, relocation = split_records(results.records)
    sections = _capabilities(association, folder) if association.records else []
    sections += _reliability(association)
    sections += [part for name in association.experiments for part in _experiment(association, name)]
    if relocation.records:
        sections += _kidnapped(relocation)
    size = results.content["conditions"]
    subtitle = (
        f"{size['worlds']} {size['split']} worlds a level, up to {size['problems']} scans in each, the same for all: "
        "single scans against real SLAM maps"
    )
    return Report("The association suite", subtitle, sections)


def _capabilities(association: SuiteRecords, folder: Path) -> list[str]:
    """The numbers of all associators, as a table and as pictures, and the reasons for their order."""
    names, scores = association.ranked, association.scores()
    shown = Table("", "associator", score_columns(association), {name: scores[name] for name in names})
    bars = capability_bars(scores, names)
    (folder / "suite.png").write_bytes(bars)
    sections = [heading("Capabilities"), table(shown, names), _WORDS, card(image(bars, "score per capability"))]
    if len(association.experiments) > 2:
        star = radar(scores, names)
        (folder / "radar.png").write_bytes(star)
        sections.append(card(image(star, "the same as a radar plot", small=True)))
    reasons = [_reason(association, name, after) for name, after in zip(names, [*names[1:], None])]
    items = "".join(f"<li>{reason}</li>" for reason in reasons)
    return [*sections, heading("In this order, because"), f"<ol>{items}</ol>"]


def _reliability(association: SuiteRecords) -> list[str]:
    """For those who say how probable their decisions are: whether that comes true."""
    found = reliability.by_associator(association.records)
    if not found:
        return []
    shown = [part for one in reliability.tables(association.records)
             for part in (f"<p><b>{html.escape(one.title)}</b></p>", table(one, list(one.rows)))]  # fmt: skip
    return [
        heading("Reliability"),
        _RELIABLE,
        card(image(reliability_chart(found), "rate right by probability")),
        *shown,
    ]


def _reason(association: SuiteRecords, name: str, after: str | None) -> str:
    """What an associator is, where its losses come from, and whether it is told apart from the next."""
    mean = interval(association.overall(name)).estimate
    text = f"<b>{html.escape(display_name(name))}</b> ({mean:.2f}) {ABOUT.get(name, 'is an associator of your own.')} "
    if name == CEILING:
        return text
    spoiled, refused = (interval(association.overall(name, key)).estimate for key in ("spoiled", "refused"))
    text += f"It spoils {spoiled:.0%} of the scans with a wrong pairing, and refuses {refused:.0%} of what is mapped. "
    scores = {e: interval(association.by_world(name, e)).estimate for e in association.experiments}
    if len(scores) > 1:
        weakest, strongest = min(scores, key=lambda e: scores[e]), max(scores, key=lambda e: scores[e])
        text += f"Strongest in {strongest} ({scores[strongest]:.2f}), weakest in {weakest} ({scores[weakest]:.2f}). "
    return text + (_against(association, name, after) if after else "")


def _against(association: SuiteRecords, name: str, after: str) -> str:
    """How far `name` is ahead of the next on the same worlds, and where most of that comes from."""
    ahead = paired_difference(association.overall(name), association.overall(after))
    value, bounds = cell(ahead, 3, signed=True)
    said, other = f"{value} [{bounds}]", html.escape(display_name(after))
    if not ahead.low > 0.0:
        return f"Not told apart from {other} on the same scans: {said}."
    each = {
        e: paired_difference(association.by_world(name, e), association.by_world(after, e))
        for e in association.experiments
    }
    told = {e: f"{e} ({cell(gap, 2, signed=True).value})" for e, gap in each.items()}
    where = sorted((e for e in each if each[e].low > 0.0), key=lambda e: -each[e].estimate)[:2]
    behind = [e for e in each if each[e].high < 0.0 and each[e].estimate <= -0.005]
    text = f"Ahead of {other} by {said}"
    text += f", above all in {' and '.join(told[e] for e in where)}" if where else ""
    return text + (f"; behind it in {', '.join(told[e] for e in behind)}" if behind else "") + "."


def _experiment(association: SuiteRecords, name: str) -> list[str]:
    """One capability: the question, the score level by level, and what is behind it."""
    names, experiment = association.ranked, EXPERIMENTS[name]
    curves = {who: association.level_curve(who, name) for who in names}
    rows: Rows = {}
    for who in names:
        exact = {c.key: interval(association.by_world(who, name, c.key)) for c in _DETAILS[:-3]}
        rows[who] = exact | _effort(association, who, name)
    return [
        *_question(name), card(image(level_chart(curves, experiment.axis, names), f"score against {experiment.axis}")),
        table(Table("", "associator", _DETAILS, rows), names),
    ]  # fmt: skip


def _kidnapped(relocation: SuiteRecords) -> list[str]:
    """Searches without a prior: their numbers, level by level, and what their answers were."""
    rows, axis = relocation_rows(relocation), EXPERIMENTS[RELOCATION].axis
    names = list(rows)
    full = {name: row | _effort(relocation, name, RELOCATION) for name, row in rows.items()}
    curves = {name: relocation.level_curve(name, RELOCATION) for name in names}
    return [
        *_question(RELOCATION), table(Table("", "search", (*RELOCATION_COLUMNS, *_EFFORT), full), names), _KIDNAPPED,
        card(image(level_chart(curves, axis, names), "score against clutter")),
        card(image(outcome_bars(rows), "outcomes inside and outside the map")),
    ]  # fmt: skip


def _question(name: str) -> list[str]:
    experiment = EXPERIMENTS[name]
    words = f"<p><b>{html.escape(experiment.question)}</b> {html.escape(experiment.why)}</p>"
    return [heading(name.capitalize()), words]


def _effort(records: SuiteRecords, name: str, experiment: str) -> dict[str, Value]:
    """Means over worlds, and the number of searches that met their limit."""
    own: list[Record] = records.select(name, experiment)
    means = {key: interval(records.by_world(name, experiment, key)).estimate for key in ("nodes", "microseconds")}
    return means | {"limits": sum(record["limits"] for record in own)}
