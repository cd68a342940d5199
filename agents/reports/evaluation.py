"""The HTML report of an evaluation: `python -m agents.reports.evaluation DIR` makes it again from the files there.

One file with its pictures inside; only the films lie beside it.
"""

from __future__ import annotations

import argparse
import base64
import html
import json
import math
from collections.abc import Sequence
from pathlib import Path
from string import Template
from typing import Any

from agents.cli import run_main
from agents.evaluation.results import (
    TABLE,
    Column,
    Journal,
    Record,
    cell,
    film_path,
    in_order,
    kidnappings,
    paired,
    table,
)
from agents.reports.figures import colour_of, curves, interval_chart
from slam_gym.metrics.statistics import Interval

TEMPLATE = Path(__file__).with_name("template.html")


def write_report(folder: Path) -> Path:
    """Write report.html into the folder of an evaluation and return its path. ValueError where it is none."""
    if not (folder / "results.json").exists():
        raise ValueError(f"{folder} holds no results.json of python -m agents.evaluate")
    results = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    journal = Journal(folder / "episodes.jsonl").read()
    records = in_order([r for r in journal if r["episode"] < results["episodes"]], results["agents"])
    if not records:
        raise ValueError(f"{folder} holds no finished episode yet")
    path = folder / "report.html"
    path.write_text(_page(results, records, folder), encoding="utf-8")
    return path


def _page(results: dict[str, Any], records: Sequence[Record], folder: Path) -> str:
    setting = results["setting"]
    agents = [agent for agent in results["agents"] if any(record["agent"] == agent for record in records)]
    world = Path(setting["floor_plan"]).name if setting["floor_plan"] else setting["scenario"]
    return Template(TEMPLATE.read_text(encoding="utf-8")).substitute(
        world=html.escape(world),
        subtitle=_subtitle(results, records),
        table=_table(records, agents),
        intervals=_data(interval_chart(records, agents)),
        curves=_data(curves(records, agents)),
        pairs=_pairs(records, agents),
        films=_films(records, agents, folder),
        provenance=html.escape(_provenance(results)),
    )


def _subtitle(results: dict[str, Any], records: Sequence[Record]) -> str:
    associator, split = html.escape(results["setting"]["associator"]), html.escape(results["setting"]["split"])
    unfinished = "" if results["complete"] else f" — <b>unfinished</b>, {len(records)} episodes so far"
    return (
        f"slam_gym/Explore-v0, associator {associator}, {results['episodes']} episodes per agent on the same {split} "
        f"worlds and seeds{unfinished}"
    )


def _table(records: Sequence[Record], agents: Sequence[str]) -> str:
    rows = table(records, agents)
    best = {column.key: _best(column, rows) for column in TABLE}
    lines = [_header(["agent", *(column.title for column in TABLE)])]
    for agent in agents:
        cells = []
        for column in TABLE:
            mean, _, interval = cell(rows[agent][column.key], column.digits).partition(" ")
            mark = ' class="best"' if agent in best[column.key] else ""
            cells.append(f"<td{mark}>{mean}<small>{interval}&nbsp;</small></td>")
        lines.append(f"<tr><td>{_label(agents, agent)}</td>{''.join(cells)}</tr>")
    carried = "".join(f"<p>{line}</p>" for line in (kidnappings(records, agent) for agent in agents) if line)
    return f"<table>{''.join(lines)}</table>{carried}"


def _best(column: Column, rows: dict[str, dict[str, Interval]]) -> set[str]:
    """The agent with the best estimate and those that cannot be told from it; none where that is all of them."""
    found = {agent: row[column.key] for agent, row in rows.items() if math.isfinite(row[column.key].estimate)}
    if not column.better or len(found) < 2:
        return set()
    sign = 1.0 if column.better == "lower" else -1.0
    first = min(found.values(), key=lambda value: sign * value.estimate)
    tied = {agent for agent, value in found.items() if value.low <= first.high and value.high >= first.low}
    return tied if len(tied) < len(found) else set()


def _pairs(records: Sequence[Record], agents: Sequence[str]) -> str:
    """Differences of map error on the same episodes: what the common seeds are for."""
    if len(agents) < 2:
        return ""
    lines = [_header(["map error of … minus that of", *map(html.escape, agents)])]
    for row in agents:
        cells = []
        for column in agents:
            value = None if row == column else paired(records, row, column, "map_error")
            text = "" if value is None else f"{value.estimate:+.3f}<small>[{value.low:+.3f}, {value.high:+.3f}]</small>"
            text = text.replace("-", "−")
            apart = value is not None and (value.low > 0.0 or value.high < 0.0)
            cells.append(f"<td{' class=best' if apart else ''}>{text}</td>")
        lines.append(f"<tr><td>{_label(agents, row)}</td>{''.join(cells)}</tr>")
    note = "Paired over episodes; negative: the agent of the row makes the better map. Bold: the interval excludes 0."
    body = f'<div class="card"><table>{"".join(lines)}</table></div><p class="soft">{note}</p>'
    return f"<h2>Agent against agent</h2>{body}"


def _films(records: Sequence[Record], agents: Sequence[str], folder: Path) -> str:
    cards = []
    for agent in agents:
        film = film_path(folder, agent)
        if not film.with_suffix(".png").exists():
            continue
        errors = [r["map_error"] for r in records if r["agent"] == agent and r["episode"] == 0]
        said = f", with a map error of {errors[0]:.3f}" if errors else ""
        source, picture = f"films/{html.escape(film.name)}", _data(film.with_suffix(".png").read_bytes())
        cards.append(
            f'<div class="card"><h3>{_label(agents, agent)}</h3><div class="pair">'
            f'<img alt="final map of {html.escape(agent)}" src="{picture}">'
            f'<video controls muted preload="metadata" src="{source}"></video></div>'
            f'<p class="soft">Left, the map at the end of the first episode{said}. Right, the film of it: '
            f'<a href="{source}">{html.escape(film.name)}</a>.</p></div>'
        )
    return f"<h2>Final maps and films</h2>{''.join(cards)}" if cards else ""


def _provenance(results: dict[str, Any]) -> str:
    commands = [f"{c['command']}    # {c['started']}, {c.get('seconds', '?')} s" for c in results["commands"]]
    models = [f"{Path(path).name}: sha256 {m['sha256']}, {_trained(m)}" for path, m in results["models"].items()]
    split, last = results["setting"]["split"], results["episodes"] - 1
    seeds = f"episode k = 0 … {last}: reset(seed=k, options={{'world': k}}) of the {split} split"
    facts = ", ".join(f"{name} {value}" for name, value in results["versions"].items())
    return "\n\n".join(filter(None, ["\n".join(commands), seeds, "\n".join(models), facts]))


def _trained(model: dict[str, Any]) -> str:
    training = model.get("training", {})
    said = (training.get(key, "?") for key in ("timesteps", "scenario", "seed"))
    return "{} decisions on {}, seed {}".format(*said)


def _header(titles: Sequence[str]) -> str:
    return "<tr>" + "".join(f"<th>{title}</th>" for title in titles) + "</tr>"


def _label(agents: Sequence[str], agent: str) -> str:
    return f'<span class="dot" style="background:{colour_of(agents, agent)}"></span>{html.escape(agent)}'


def _data(png: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")


def main(argv: list[str]) -> int:
    p = argparse.ArgumentParser(
        prog="python -m agents.reports.evaluation", description="Make the report of an evaluation again."
    )
    p.add_argument("folder", type=Path, metavar="DIR", help="what python -m agents.evaluate wrote into")
    print(write_report(p.parse_args(argv).folder))
    return 0


if __name__ == "__main__":
    raise SystemExit(run_main(main))
