"""The report of the association suite: the numbers, their order with the reasons, and a plot per capability."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from pathlib import Path

from agents.evaluation.associators import CEILING, short
from agents.evaluation.results import Record
from agents.reports.association_figures import capability_bars, outcomes, radar, sweep
from agents.reports.associators import (
    best_of,
    header,
    interval_cell,
    label,
    page,
    picture,
    provenance,
    read,
    unfinished,
)
from agents.suite.run import (
    by_world,
    capabilities,
    difference,
    level_curve,
    names_of,
    number,
    over_all,
    ranked,
    tables,
)
from slam_gym.scenarios.suite import EXPERIMENTS, RELOCATION

ABOUT = {
    "nearest_neighbour": "decides each measurement by itself, for the nearest compatible feature.",
    "global_nearest_neighbour": "gives each feature to one measurement, by the least sum of single distances.",
    "singles": "pairs only where measurement and feature have no other candidate.",
    "one_point_ransac": "lets single pairings vote for a pose, and keeps what agrees with the best of them.",
    "jcbb": "searches for the largest set of pairings whose innovations agree with each other.",
    "ipjc": "searches as JCBB does, but tests a set after moving the pose to where it puts the robot.",
    "map_hypothesis": "searches for the most probable set, in which a pairing must be likelier than clutter.",
    CEILING: "is told the truth: the ceiling.",
}
_WORDS = """<p class="soft">Every number lies between 0 and 1. A scan earns (right − 10 · wrong pairings) over the
measurements whose feature is in the map, but not less than −1, which one wrong pairing mostly comes to: 1 without a
mistake, 0 for refusing everything, less for spoiling the scan, since a wrong pairing bends the map for good while a
refusal only wastes a measurement. A number is the mean over the levels of an experiment, none below 0; interquartile
mean over worlds, 95&nbsp;% bootstrap interval below it. Bold: the best, and all whose interval overlaps with it; the
ceiling is left out of that.</p><p class="soft"><b>Spoiled</b> are scans with a wrong pairing; <b>refused</b>,
measurements of a mapped feature that were left unpaired; <b>exact</b>, scans with neither.</p>"""
_KIDNAPPED = """<p class="soft">An answer inside the map is <b>correct</b> within 0.3 m and 3°, else <b>wrong</b>; a
search may also stay <b>silent</b>. In another building it has to be <b>refused</b>; a pose is <b>invented</b>. Score:
(correct − wrong, of those inside, not below 0) times (refused, of those outside), so that neither always answering nor
never does well. All searches look within covisibility localities.</p>"""


def write_report(folder: Path) -> Path:
    """Write report.html, suite.png (bars) and radar.png into the folder of a suite; return the path of the report."""
    results, records = read(folder)
    order = ranked(records)
    body = []
    if order:
        numbers = tables(records)["numbers"]
        (folder / "suite.png").write_bytes(bars := capability_bars(numbers, order))
        body += ["<h2>Capabilities</h2>", _table(records, order), _WORDS, picture(bars, "score per capability")]
        if len(capabilities(records)) > 2:
            (folder / "radar.png").write_bytes(star := radar(numbers, order))
            body.append(
                picture(star, "the same as a radar plot").replace("<img", '<img style="max-width:680px; margin:auto"')
            )
        body.append(_reasons(records, order))
        body += [_experiment(records, name, order) for name in capabilities(records)]
    if names_of(records, relocators=True):
        body.append(_kidnapped(records))
    body.append(provenance(results))
    fixed = results["fixed"]
    subtitle = (
        f"{fixed['worlds']} {fixed['split']} worlds a level, up to {fixed['problems']} scans in each, the same for "
        f"all: single scans against real SLAM maps{unfinished(results)}"
    )
    path = folder / "report.html"
    path.write_text(page("The association suite", subtitle, "\n".join(body)), encoding="utf-8")
    return path


def _table(records: Sequence[Record], order: Sequence[str]) -> str:
    shown = capabilities(records)
    found = {e: {name: number(by_world(records, name, e)) for name in order} for e in shown}
    found["all"] = {name: number(over_all(records, name, shown)) for name in order}
    best = {e: best_of(column, "higher") for e, column in found.items()}
    lines = [header(["associator", *found])]
    for name in order:
        cells = "".join(interval_cell(found[e][name], 3, name in best[e]) for e in found)
        lines.append(f"<tr><td>{label(order, name)}</td>{cells}</tr>")
    return f'<div class="card"><table>{"".join(lines)}</table></div>'


def _reasons(records: Sequence[Record], order: Sequence[str]) -> str:
    """The order, each with what it is, where its losses come from, and whether it is told apart from the next."""
    items = [f"<li>{_reason(records, name, after)}</li>" for name, after in zip(order, [*order[1:], None])]
    return f"<h2>In this order, because</h2><ol>{''.join(items)}</ol>"


def _reason(records: Sequence[Record], name: str, after: str | None) -> str:
    shown = capabilities(records)
    mean = number(over_all(records, name, shown)).estimate
    about = ABOUT.get(name, "is an associator of your own.")
    text = f"<b>{html.escape(short(name))}</b> ({mean:.2f}) {about} "
    if name != CEILING:
        spoiled, refused = (number(over_all(records, name, shown, key)).estimate for key in ("spoiled", "refused"))
        scores = {e: number(by_world(records, name, e)).estimate for e in shown}
        weakest, strongest = min(scores, key=lambda e: scores[e]), max(scores, key=lambda e: scores[e])
        text += (
            f"It spoils {spoiled:.0%} of the scans with a wrong pairing, and refuses {refused:.0%} of what is mapped. "
        )
        if len(shown) > 1:
            text += (
                f"Strongest in {strongest} ({scores[strongest]:.2f}), weakest in {weakest} ({scores[weakest]:.2f}). "
            )
    return text + (_against(records, name, after) if after and name != CEILING else "")


def _against(records: Sequence[Record], name: str, after: str) -> str:
    """How far `name` is ahead of the next on the same worlds, and where most of that comes from."""
    shown = capabilities(records)
    ahead = difference(over_all(records, name, shown), over_all(records, after, shown))
    said = f"{ahead.estimate:+.3f} [{ahead.low:+.3f}, {ahead.high:+.3f}]".replace("-", "−")
    other = html.escape(short(after))
    if not ahead.low > 0.0:
        return f"Not told apart from {other} on the same scans: {said}."
    each = {e: difference(by_world(records, name, e), by_world(records, after, e)) for e in shown}
    where = sorted((e for e in shown if each[e].low > 0.0), key=lambda e: -each[e].estimate)
    behind = [e for e in shown if each[e].high < 0.0 and each[e].estimate <= -0.005]
    text = f"Ahead of {other} by {said}"
    if where:
        text += f", above all in {' and '.join(f'{e} ({each[e].estimate:+.2f})' for e in where[:2])}"
    if behind:
        text += f"; behind it in {', '.join(f'{e} ({each[e].estimate:+.2f})' for e in behind)}".replace("-", "−")
    return text + "."


def _experiment(records: Sequence[Record], name: str, order: Sequence[str]) -> str:
    experiment = EXPERIMENTS[name]
    curves = {n: level_curve(records, n, name, "score") for n in order}
    plot = picture(sweep(curves, experiment.axis, order), f"score against {experiment.axis}")
    columns = (("exact", 3), ("precision", 3), ("recall", 3), ("spoiled", 3), ("refused", 3))
    titles = ["associator", "exact scans", "precision", "recall", "spoiled", "refused", "nodes", "µs"]
    lines = [header([*titles, "limit met"])]
    for who in order:
        own = [r for r in records if r["associator"] == who and r["experiment"] == name]
        cells = "".join(interval_cell(number(by_world(records, who, name, key)), digits) for key, digits in columns)
        nodes, time = (number(by_world(records, who, name, key)).estimate for key in ("nodes", "microseconds"))
        cells += f"<td>{nodes:.0f}</td><td>{time:.0f}</td><td>{sum(r['limits'] for r in own)}</td>"
        lines.append(f"<tr><td>{label(order, who)}</td>{cells}</tr>")
    return (
        f"<h2>{name.capitalize()}</h2><p><b>{html.escape(experiment.question)}</b> {html.escape(experiment.why)}</p>"
        f'{plot}<div class="card"><table>{"".join(lines)}</table></div>'
    )


def _kidnapped(records: Sequence[Record]) -> str:
    experiment = EXPERIMENTS[RELOCATION]
    names = names_of(records, relocators=True)
    names = sorted(names, key=lambda n: -_finite(number(by_world(records, n, RELOCATION)).estimate))
    relocation = tables(records)["relocation"]
    best = best_of({name: relocation[name][RELOCATION] for name in names}, "higher")
    lines = [
        header(["search", "score", "correct", "silent", "wrong", "refused", "invented", "nodes", "µs", "limit met"])
    ]
    for name in names:
        own = [r for r in records if r["associator"] == name and r["experiment"] == RELOCATION]
        found = relocation[name]
        counts = "".join(f"<td>{found[kind]}</td>" for kind in ("correct", "silent", "wrong", "refused", "invented"))
        nodes, time = (number(by_world(records, name, RELOCATION, key)).estimate for key in ("nodes", "microseconds"))
        cells = interval_cell(found[RELOCATION], 3, name in best) + counts
        cells += f"<td>{nodes:.0f}</td><td>{time:.0f}</td><td>{sum(r['limits'] for r in own)}</td>"
        lines.append(f"<tr><td>{label(names, name)}</td>{cells}</tr>")
    curves = {name: level_curve(records, name, RELOCATION, "score") for name in names}
    return (
        f"<h2>Kidnapped</h2><p><b>{html.escape(experiment.question)}</b> {html.escape(experiment.why)}</p>"
        f'<div class="card"><table>{"".join(lines)}</table></div>{_KIDNAPPED}'
        f"{picture(sweep(curves, experiment.axis, names), 'score against clutter')}"
        f"{picture(outcomes(relocation, names), 'outcomes inside and outside the map')}"
    )


def _finite(value: float) -> float:
    return value if math.isfinite(value) else -1.0
