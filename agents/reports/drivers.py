"""The report of drivers: the table, the episodes behind it, their course over time, films."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from pathlib import Path

from agents.evaluation.drivers import kidnappings, tables, world_of
from agents.evaluation.headline import LOST_MEANS
from agents.evaluation.pipeline import Results
from agents.evaluation.records import Record
from agents.evaluation.tables import Column, Table, by_name, counted, difference, display_name
from agents.reports.figures import Panel, curve_chart, dot_chart
from agents.reports.film import film_path
from agents.reports.page import Report, card, heading, image, label, note, table

_WORDS = (
    note("Interquartile mean over episodes, 95&nbsp;% bootstrap interval below it. Bold: the best of the column, and "
         "all whose interval overlaps with it; nothing, where all do.")
    + note("<b>Map error</b> is GOSPA (p = 1, α = 2, c = 2σ₀) over σ₀N: 1 for an empty map, 0 for a perfect one; "
           "missed, misplaced and duplicate features all cost. <b>Coverage</b> is the fraction of the reachable floor "
           "that was seen. <b>Precision</b> and <b>recall</b> judge data association, measurement by measurement. "
           "<b>ANEES</b> is 1 for a consistent filter, above 1 for an overconfident one. <b>Ticks/s</b> is the speed "
           "of one process, with physics, SLAM, planning and the agent itself.")
    + note(html.escape(LOST_MEANS[0].upper() + LOST_MEANS[1:] + "; the mean, as it happens seldom."))
)  # fmt: skip
_PANELS = (Panel("map_error", "map error (lower is better)"), Panel("coverage", "coverage", "percent"))


def report(results: Results, folder: Path) -> Report:
    """What is told of an evaluation of drivers; `folder` may hold films."""
    conditions, names = results.content["conditions"], results.names
    groups = by_name(results.records, "agent")
    sections = [heading("Results"), *(table(shown, names) for shown in tables(results))]
    sections += [note(html.escape(line)) for line in kidnappings(results)]
    sections += [_WORDS, card(image(dot_chart(groups, _PANELS), "map error and coverage of each agent"))]
    sections += [note("A dot per episode; the bar is the interval of the interquartile mean.")]
    sections += [heading("Over time"), card(image(curve_chart(groups, _PANELS), "map error and coverage over ticks"))]
    sections += [note("After so many ticks of driving: interquartile mean over episodes and its 95&nbsp;% bootstrap "
                      "band.")]  # fmt: skip
    sections += _comparison(groups) + _films(groups, folder)
    subtitle = (
        f"slam_gym/Explore-v0, associator {conditions['associator'] or 'of the scenario'}, "
        f"{counted(results.content['asked']['episodes'], 'episode')} "
        f"per agent on the same {conditions['split']} worlds and seeds"
    )
    return Report(f"Exploring {world_of(conditions)}", subtitle, sections)


def _comparison(groups: Mapping[str, Sequence[Record]]) -> list[str]:
    """Differences of map error on the same episodes: what the common seeds are for."""
    names = list(groups)
    if len(names) < 2:
        return []
    rows = {
        name: {other: difference(groups[name], groups[other], "map_error") for other in names if other != name}
        for name in names
    }
    columns = [Column(name, display_name(name), 3) for name in names]
    shown = Table("", "map error of … minus that of", columns, rows, differences=True)
    words = "Paired over episodes; negative: the agent of the row makes the better map. Bold: the interval excludes 0."
    return [heading("Agent against agent"), table(shown, names), note(words)]


def _films(groups: Mapping[str, Sequence[Record]], folder: Path) -> list[str]:
    cards = []
    for agent, records in groups.items():
        film = film_path(folder, agent)
        picture = film.with_suffix(".png")
        if not picture.exists():
            continue
        errors = [record["map_error"] for record in records if record["episode"] == 0]
        said = f", with a map error of {errors[0]:.3f}" if errors else ""
        source = f"films/{html.escape(film.name)}"
        cards.append(card(
            f'<h3>{label(agent, list(groups))}</h3><div class="pair">'
            f"{image(picture.read_bytes(), f'final map of {agent}')}"
            f'<video controls muted preload="metadata" src="{source}"></video></div>'
            + note(f"Left, the map at the end of the first episode{said}. Right, the film of it: "
                   f'<a href="{source}">{html.escape(film.name)}</a>.')
        ))  # fmt: skip
    return [heading("Final maps and films"), *cards] if cards else []
