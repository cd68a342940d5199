"""Evaluate agents on the same test worlds: `python -m agents.evaluate` compares those of `SHOWN` on `office`.

Writes into OUT: episodes.jsonl (--resume goes on from it), episodes.csv, results.json, report.html and films/.
"""

from __future__ import annotations

import argparse

from agents.cli import (
    add_episode_options,
    add_execution_options,
    add_explore_options,
    add_rerun_option,
    command_line,
    episodes_of,
    execution,
    explore_arguments,
    program,
    require_positive,
    require_rerun,
    results_folder,
    run_main,
    say_where,
)
from agents.drivers.base import AGENTS, SHOWN
from agents.evaluation.drivers import driver_evaluation, drivers_of, kidnappings, tables, world_of
from agents.evaluation.pipeline import carry_out
from agents.evaluation.tables import print_table

EPISODES = 40


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(prog=program("agents.evaluate"), description="Evaluate agents on the same test worlds.")
    p.add_argument("--agents", nargs="+", default=list(SHOWN), metavar="NAME", help=f"of {', '.join(AGENTS)}, or "
                   f"module:Class (default: {' '.join(SHOWN)})")  # fmt: skip
    p.add_argument("--model", nargs="+", default=[], metavar="FILE", help="model of a learned agent; several files are "
                   "several training seeds of it, pooled")  # fmt: skip
    p.add_argument("--trust", action="store_true", help="allow model files that can run code when read (SB3's .zip)")
    add_episode_options(p, EPISODES, "per agent")
    p.add_argument("--no-films", dest="films", action="store_false", help="leave the films out")
    add_rerun_option(p)
    add_execution_options(p, "results/WORLD-TIME")
    add_explore_options(p, "office")
    return p


def main(argv: list[str]) -> int:
    a = parser().parse_args(argv)
    require_positive(a, "jobs")
    require_rerun(a)
    episodes = episodes_of(a)
    arguments = explore_arguments(a, split="test")
    out = a.out or results_folder(world_of(arguments.plain).split(".")[0], a.resume)
    drivers, how = drivers_of(a.agents, a.model, a.trust), execution(a, command_line("agents.evaluate", argv))
    try:
        results = carry_out(driver_evaluation(drivers, arguments, episodes), out, how)
        if a.films:
            from agents.reports.film import make_films  # ffmpeg and pygame are needed for films only

            make_films(drivers, arguments, a.first, out, how)
        if a.rerun:
            from agents.reports.rerun_log import Drive, log_drives

            drives = [Drive(driver.agent, arguments, driver.make()) for driver in drivers]
            say_where(log_drives(a.rerun, a.first, drives), how)
    except KeyboardInterrupt:
        how.console.print(f"interrupted; go on with the same command and --resume --out {out}", soft_wrap=True)
        raise
    for table in tables(results):
        print_table(table, how.console)
    for line in kidnappings(results):
        how.console.print(line)
    from agents.report import write_report  # matplotlib takes a second to import

    how.console.print(f"report: {write_report(out)}", soft_wrap=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(run_main(main))
