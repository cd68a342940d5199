"""The HTML report of associators in the loop, and what it shares with the report of the suite."""

from __future__ import annotations

import base64
import html
import json
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from agents.evaluation.associators import CEILING, key_of, paired, row, short
from agents.evaluation.drives import columns_for
from agents.evaluation.results import Column, Journal, Record, cell
from agents.reports.association_figures import colours, drives_chart
from agents.reports.evaluation import TEMPLATE
from slam_gym.metrics.statistics import Interval

_STYLE = re.findall(r"<style>.*?</style>", TEMPLATE.read_text(encoding="utf-8"), re.DOTALL)[0]
_WIDE = "<style>main { max-width: 1240px } th, td { padding: 7px 8px }</style>"
_WORDS = """<p class="soft">Interquartile mean over episodes, 95&nbsp;% bootstrap interval below it. Bold: the best of
the column, and all whose interval overlaps with it; true association, which nothing could know, is left out of that.
</p><p class="soft"><b>Precision</b>: of the pairings, those with the right feature. <b>Recall</b>: of the measurements
whose feature is in the map, those paired with it. <b>Exact</b> scans have no wrong and no missing pairing.
<b>Dupl.</b>: features that the map ends up having more than once. <b>Nodes</b> of the interpretation tree are means a
scan, <b>µs/scan</b> the median time of the associator's calls. <b>Map error</b> is 1 for an empty map, 0 for a perfect
one. <b>ANEES</b> is 1 for a consistent filter, above 1 for an overconfident one.</p>"""
_CARRIED = """<p class="soft">Where the robot was carried away, <b>recovered</b> is the share of episodes in which its
pose was right again, <b>wrong reloc.</b> the number of relocations that put it elsewhere, <b>ticks astray</b> the time
until it was right. True association is no ceiling there: its pairings are right but its pose is not, and updates from
so far off bend the map.</p>"""


def read(folder: Path) -> tuple[dict[str, Any], list[Record]]:
    """results.json and the records of an evaluation. ValueError where there is none, or nothing finished yet."""
    if not (folder / "results.json").exists():
        raise ValueError(f"{folder} holds no results.json of python -m agents.evaluate_association")
    records = {key_of(record): record for record in Journal(folder / "records.jsonl").read()}
    if not records:
        raise ValueError(f"{folder} holds no finished episode yet")
    return json.loads((folder / "results.json").read_text(encoding="utf-8")), list(records.values())


def write_report(folder: Path, names: Sequence[str], settings: Sequence[str]) -> Path:
    """Write report.html of drives into the folder of their evaluation, and return its path."""
    results, records = read(folder)
    records = [r for r in records if r["associator"] in names and r["setting"] in settings]
    names = [name for name in names if any(record["associator"] == name for record in records)]
    body = []
    for setting in settings:
        own = [record for record in records if record["setting"] == setting]
        if own:
            body.append(f"<h2>{html.escape(setting)}</h2>{_table(own, names)}")
            body.append(picture(drives_chart(own, names), f"precision, recall, map error and time in {setting}"))
    body.append(_WORDS)
    if any(record.get("kidnapped") for record in records):
        body.append(_CARRIED)
    body.append(_pairs(records, names))
    body.append(provenance(results))
    fixed = results["fixed"]
    relocation = f", relocation {fixed['relocation']}" if fixed.get("relocation") else ""
    episodes = max(record["episode"] for record in records) + 1
    subtitle = (
        f"slam_gym/Explore-v0, driven by {fixed['driver']}{relocation}: {episodes} episodes a scenario, the same "
        f"{fixed['split']} worlds and seeds for every associator{unfinished(results)}"
    )
    path = folder / "report.html"
    path.write_text(page("Associators in the loop", subtitle, "\n".join([_WIDE, *body])), encoding="utf-8")
    return path


def page(title: str, subtitle: str, body: str) -> str:
    """A page with everything inside it."""
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<meta name="viewport" '
        f'content="width=device-width">\n<title>slam_gym: {html.escape(title)}</title>\n{_STYLE}\n</head>\n<body>\n'
        f'<main>\n<h1>{html.escape(title)}</h1>\n<p class="soft">{html.escape(subtitle)}</p>\n{body}\n</main>\n'
        "</body>\n</html>\n"
    )


def picture(png: bytes, alt: str) -> str:
    """A card with a picture in it."""
    data = base64.b64encode(png).decode("ascii")
    return f'<div class="card"><img alt="{html.escape(alt)}" src="data:image/png;base64,{data}"></div>'


def unfinished(results: dict[str, Any]) -> str:
    return "" if results["complete"] else " — unfinished"


def provenance(results: dict[str, Any]) -> str:
    """Commands, settings and versions."""
    commands = [f"{c['command']}    # {c['started']}, {c.get('seconds', '?')} s" for c in results["commands"]]
    facts = [", ".join(f"{name} {value}" for name, value in results[key].items()) for key in ("fixed", "versions")]
    return f"<h2>How it was made</h2><pre>{html.escape(chr(10).join([*commands, '', *facts]))}</pre>"


def label(names: Sequence[str], name: str) -> str:
    """A name with its dot of colour."""
    colour = colours(names).get(name, "#1c2733")
    return f'<span class="dot" style="background:{colour}"></span>{html.escape(short(name))}'


def header(titles: Sequence[str]) -> str:
    return "<tr>" + "".join(f"<th>{html.escape(title)}</th>" for title in titles) + "</tr>"


def interval_cell(value: Interval, digits: int, best: bool = False) -> str:
    """An estimate with its interval below it."""
    middle, _, interval = cell(value, digits).partition(" ")
    return f"<td{' class=best' if best else ''}>{middle}<small>{interval}&nbsp;</small></td>"


def best_of(found: dict[str, Interval], better: str) -> set[str]:
    """The name with the best estimate and those that cannot be told from it; none where that is all. No ceiling."""
    known = {n: value for n, value in found.items() if n != CEILING and math.isfinite(value.estimate)}
    if not better or len(known) < 2:
        return set()
    sign = 1.0 if better == "lower" else -1.0
    first = min(known.values(), key=lambda value: sign * value.estimate)
    tied = {name for name, value in known.items() if value.low <= first.high and value.high >= first.low}
    return tied if len(tied) < len(known) else set()


def _table(records: Sequence[Record], names: Sequence[str]) -> str:
    columns = columns_for(records)
    rows = {name: row(records, name, None, columns) for name in names}
    best = {c.key: best_of({name: rows[name][c.key] for name in names}, c.better) for c in columns}
    lines = [header(["associator", *(column.title for column in columns)])]
    for name in names:
        cells = [interval_cell(rows[name][c.key], c.digits, name in best[c.key]) for c in columns]
        lines.append(f"<tr><td>{label(names, name)}</td>{''.join(cells)}</tr>")
    limits = {name: sum(r["limits"] for r in records if r["associator"] == name and r["limits"] > 0) for name in names}
    hit = [f"{short(name)} in {count:.0f} scans" for name, count in limits.items() if count]
    note = f'<p class="soft">Node limit met: {html.escape(", ".join(hit))}.</p>' if hit else ""
    return f'<div class="card"><table>{"".join(lines)}</table></div>{note}'


def _pairs(records: Sequence[Record], names: Sequence[str]) -> str:
    """Differences on the same episodes to the best of the others and to the truth: what the common seeds are for."""
    reference = "jcbb" if "jcbb" in names else names[0]
    others = [name for name in names if name != reference]
    if not others:
        return ""
    columns = (Column("f1", "F1", 3, "higher"), Column("exact", "exact", 3), Column("map_error", "map error", 3))
    lines = [header([f"… minus {short(reference)}", *(column.title for column in columns)])]
    for name in others:
        found = [_rounded(paired(records, name, reference, column.key)) for column in columns]
        cells = [interval_cell(value, 3, value.low > 0.0 or value.high < 0.0) for value in found]
        lines.append(f"<tr><td>{label(names, name)}</td>{''.join(cells).replace('-', '−')}</tr>")
    note = "Paired over the episodes of all scenarios. Bold: the interval excludes 0."
    body = f'<div class="card"><table>{"".join(lines)}</table></div><p class="soft">{note}</p>'
    return f"<h2>Against {html.escape(short(reference))}</h2>{body}"


def _rounded(value: Interval) -> Interval:
    """To three digits, without a negative zero."""
    return Interval(*(round(number, 3) + 0.0 for number in (value.estimate, value.low, value.high)))
