"""Films of the same worlds by scenario and associator, on one page: `python -m agents.gallery --out films`.

A row a scenario, a column an associator: each film shows the first test world, driven by the same agent. Films that are
there already stay; index.html plays them side by side.
"""

from __future__ import annotations

import argparse
import html
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import joblib
from rich.console import Console

from agents.cli import program, require_positive, run_main
from agents.drivers.base import AGENTS, make_agent
from agents.evaluation.associators import find_associator
from agents.evaluation.episodes import ExploreArguments
from agents.evaluation.parallel import run_all
from agents.evaluation.records import stem, write_whole
from agents.evaluation.tables import display_name
from slam_gym.scenarios import SCENARIOS, get_scenario

ASSOCIATORS = ("nearest_neighbour", "jcbb", "marginal", "true_association")
WIDTH = 420  # [pixels] of a film on the page


def film_path(out: Path, scenario: str, associator: str) -> Path:
    """Where a film lies; its last picture has the same name with .png."""
    return out / f"{stem(scenario, associator)}.mp4"


def _film(scenario: str, associator: str, driver: str, budget: int | None, world: int, path: Path) -> Path:
    from agents.reports.film import film  # ffmpeg and pygame are needed here only

    overrides = (("budget", budget),) if budget is not None else ()
    return film(ExploreArguments(scenario, overrides, associator=associator), make_agent(driver), world, path)


def page(out: Path, scenarios: Sequence[str], associators: Sequence[str]) -> str:
    """The page with all films that there are."""
    head = "".join(f"<th>{html.escape(display_name(name))}</th>" for name in associators)
    rows = [f"<tr><th></th>{head}</tr>"]
    for scenario in scenarios:
        cells = []
        for associator in associators:
            path = film_path(out, scenario, associator)
            still, film = path.with_suffix(".png").name, path.name
            shown = f'<video width="{WIDTH}" controls loop muted poster="{still}" src="{film}"></video>'
            cells.append(f"<td>{shown if path.exists() else ''}</td>")
        rows.append(f"<tr><th>{html.escape(scenario)}</th>{''.join(cells)}</tr>")
    style = "body{font-family:sans-serif;margin:1em}td,th{padding:.3em;text-align:left;vertical-align:top}"
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>slam_gym: gallery</title>'
        f"<style>{style}</style></head><body><h1>The same drives, associated by others</h1>"
        f"<table>{''.join(rows)}</table></body></html>\n"
    )


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(prog=program("agents.gallery"), description="Film scenarios by associator.")
    p.add_argument("--scenarios", nargs="+", default=["office", "drift-2"], metavar="NAME",
                   help=f"of {', '.join(SCENARIOS)} (default: %(default)s)")  # fmt: skip
    p.add_argument("--associators", nargs="+", default=list(ASSOCIATORS), metavar="NAME", help="default: %(default)s")
    p.add_argument("--driver", default="information_gain", metavar="AGENT", help=f"of {', '.join(AGENTS)} but learned "
                   "ones, or module:Class (default: %(default)s)")  # fmt: skip
    p.add_argument("--world", type=int, default=0, metavar="K", help="of the test worlds (default: %(default)s)")
    p.add_argument("--budget", type=int, metavar="TICKS", help="of an episode (default: the scenario's)")
    p.add_argument("--jobs", type=int, default=joblib.cpu_count(), metavar="J", help="processes (default: %(default)s)")
    p.add_argument("--out", type=Path, default=Path("results/gallery"), metavar="DIR", help="default: %(default)s")
    return p


def main(argv: list[str]) -> int:
    a = parser().parse_args(argv)
    require_positive(a, "jobs", "budget")
    for scenario in a.scenarios:
        get_scenario(scenario)
    for associator in a.associators:
        find_associator(associator)
    make_agent(a.driver)
    a.out.mkdir(parents=True, exist_ok=True)
    pairs = [(scenario, associator) for scenario in a.scenarios for associator in a.associators]
    missing = [pair for pair in pairs if not film_path(a.out, *pair).with_suffix(".png").exists()]
    calls = [partial(_film, *pair, a.driver, a.budget, a.world, film_path(a.out, *pair)) for pair in missing]
    with Console().status(f"{len(calls)} films"):
        list(run_all(calls, a.jobs))
    write_whole(a.out / "index.html", page(a.out, a.scenarios, a.associators))
    print(f"gallery: {a.out / 'index.html'}")
    return 0


if __name__ == "__main__":
    raise SystemExit(run_main(main))
