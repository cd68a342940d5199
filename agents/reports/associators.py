"""The report of associators in the loop: per scenario the table and the episodes behind it, then all against one."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from pathlib import Path

from agents.evaluation.associators import scenario_tables
from agents.evaluation.headline import headline
from agents.evaluation.pipeline import Results
from agents.evaluation.records import Record
from agents.evaluation.tables import Column, Table, by_name, by_setting, counted, difference, display_name
from agents.reports.figures import Panel, dot_chart
from agents.reports.page import Report, card, heading, image, note, table

_WORDS = (
    note("Interquartile mean over episodes, 95&nbsp;% bootstrap interval below it. Bold: the best of the column, and "
         "all whose interval overlaps with it; nothing, where all do. True association, which nothing could know, is "
         "left out.")
    + note("<b>Precision</b>: of the pairings, those with the right feature. <b>Recall</b>: of the measurements whose "
           "feature is in the map, those paired with it. <b>Exact</b> scans have no wrong and no missing pairing. "
           "<b>Dupl.</b>: features that the map ends up having more than once. <b>Nodes</b> of the interpretation tree "
           "are means a scan, <b>µs/scan</b> the median time of the associator's calls. <b>Map error</b> is 1 for an "
           "empty map, 0 for a perfect one. <b>ANEES</b> is 1 for a consistent filter, above 1 for an overconfident "
           "one.")
)  # fmt: skip
_CARRIED = note(
    "Where the robot was carried away, <b>recovered</b> is the fraction of episodes in which its pose was right again, "
    "<b>wrong reloc.</b> the number of relocations that put it elsewhere, <b>ticks astray</b> the time until it was "
    "right. True association is no ceiling there: its pairings are right but its pose is not, and updates from so far "
    "off bend the map."
)
_PANELS = (
    Panel("precision", "precision"), Panel("recall", "recall"), Panel("map_error", "map error"),
    Panel("microseconds", "µs/scan", "log"),
)  # fmt: skip
_COMPARED = (Column("f1", "F1", 3), Column("exact", "exact", 3), Column("map_error", "map error", 3))


def report(results: Results, folder: Path) -> Report:
    """What is told of an evaluation of associators in the loop."""
    names = results.names
    sections = [
        part for t in headline(results.records) for part in (heading(t.title), table(t, names), note(t.caption))
    ]
    for (setting, records), shown in zip(by_setting(results.records).items(), scenario_tables(results)):
        chart = dot_chart(by_name(records, "associator"), _PANELS)
        sections += [heading(setting), table(shown, names), _limits_met(records)]
        sections += [card(image(chart, f"precision, recall, map error and time in {setting}"))]
    carried = any(record.get("kidnapped") for record in results.records)
    sections += [_WORDS, _CARRIED if carried else "", *_comparison(by_name(results.records, "associator"))]
    conditions = results.content["conditions"]
    searches = conditions["relocation"] or []
    searches = searches if isinstance(searches, list) else [searches]
    relocation = f", relocation {' and '.join(name or 'none' for name in searches)}" if searches else ""
    subtitle = (
        f"slam_gym/Explore-v0, driven by {conditions['driver']}{relocation}: "
        f"{counted(results.content['asked']['episodes'], 'episode')} a scenario, "
        f"the same {conditions['split']} worlds and seeds for every associator"
    )
    return Report("Associators in the loop", subtitle, sections)


def _limits_met(records: Sequence[Record]) -> str:
    """Whose search was cut short, and how often."""
    groups = by_name(records, "associator")
    limits = {name: sum(r["limits"] for r in own if r["limits"] > 0) for name, own in groups.items()}
    said = [f"{display_name(name)} in {count:.0f} scans" for name, count in limits.items() if count]
    return note(f"Node limit met: {html.escape(', '.join(said))}.") if said else ""


def _comparison(groups: Mapping[str, Sequence[Record]]) -> list[str]:
    """Differences to one of them on the same episodes: what the common seeds are for."""
    reference = "jcbb" if "jcbb" in groups else next(iter(groups))
    rows = {
        name: {c.key: difference(own, groups[reference], c.key) for c in _COMPARED}
        for name, own in groups.items() if name != reference
    }  # fmt: skip
    if not rows:
        return []
    shown = Table("", f"… minus {display_name(reference)}", _COMPARED, rows, differences=True)
    words = "Paired over the episodes of all scenarios. Bold: the interval excludes 0."
    return [heading(f"Against {display_name(reference)}"), table(shown, list(groups)), note(words)]
