"""Drive through everything, with settings that no robot should have, and look whether anything breaks.

Episodes of Explore, Associate and Relocate go round all scenarios, eight kinds of extreme settings, and whatever else
the environments offer: actions, rewards, associators, relocation, localities. At every step the observation must be in
its space and the reward finite; maps stay finite and positive semi-definite; rewards sum to the fall of the error;
copies made on the way (pickle, deepcopy, a restored snapshot) go on to the bit like the original; and memory must not
grow. Episodes follow from the seed and their number: `--first N --ticks 1` plays the N-th again. The command ends in 1
if anything broke.
"""

from __future__ import annotations

import gc
import math
import time
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba.core.dispatcher import Dispatcher

from slam_gym.bench.memory import resident
from slam_gym.bench.records import Record, grouped
from slam_gym.bench.report import Report
from slam_gym.bench.runner import FailedError
from slam_gym.bench.soak.cases import Case, case
from slam_gym.bench.soak.checks import Checked, check_copies

COPIES_EVERY = 6  # episodes
COPIED_AT = 40  # [steps] at the latest: copies replay the episode
GROWTH = 0.1  # of memory from the second to the last fifth of a soak; more is a leak
MIN_EPISODES = 100  # in which memory is judged: before, code is still being loaded
_SAY_EVERY = 60.0  # [s]


class Outcome(NamedTuple):
    """What came of an episode."""

    case: Case
    steps: int
    ticks: int
    copied: bool
    seconds: float
    broken: str  # what broke, and where; empty where nothing did
    megabytes: float  # resident afterwards
    functions: int  # compiled or loaded so far: what memory may grow with


def soak(number: int, seed: int, ticks: int) -> Outcome:
    """Play one episode, checked."""
    chosen, start, broken, copied = case(number, seed, ticks), time.perf_counter(), "", False
    rng = np.random.default_rng((seed, number, 3))
    copy_at = int(rng.integers(1, COPIED_AT)) if number % COPIES_EVERY == 0 else -1
    checked: Checked | None = None
    try:
        checked = Checked(chosen)
        for _ in checked.play():
            if checked.steps == copy_at:
                check_copies(checked, checked.env._info(), 3)
                copied = True
                break  # the copies' steps are not in the sum of rewards
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        broken = f"{type(error).__name__}: {error} ({Path(last.filename).name}:{last.lineno})"
    steps, done = (checked.steps, checked.ticks) if checked else (0, 0)
    seconds, checked = time.perf_counter() - start, None  # what is held is asked for when the episode is gone
    gc.collect()
    return Outcome(chosen, steps, done, copied, seconds, broken, resident(), functions())


def functions() -> int:
    """How many compiled functions this process has loaded, each for its types of arguments."""
    return sum(len(held.overloads) for held in gc.get_objects() if isinstance(held, Dispatcher))


def growth(megabytes: Sequence[float]) -> float:
    """How much more memory is held in the last fifth of a soak than in its second: medians, as a fraction."""
    fifth = len(megabytes) // 5
    if fifth == 0:
        return math.nan
    before, after = np.median(megabytes[fifth : 2 * fifth]), np.median(megabytes[-fifth:])
    return float(after / before - 1.0)


def summary(outcomes: Sequence[Outcome], by: str) -> list[Record]:
    """Episodes, steps, ticks and failures by a field of the case."""
    records = [
        {by: getattr(o.case, by), "steps": o.steps, "ticks": o.ticks, "copied": o.copied, "broken": bool(o.broken)}
        for o in outcomes
    ]
    return [
        {
            **key,
            "episodes": len(own),
            **{name: int(sum(record[name] for record in own)) for name in ("steps", "ticks", "copied", "broken")},
        }
        for key, own in grouped(records, by)
    ]


def run(
    report: Report,
    *,
    ticks: int = 1_000_000,
    minutes: float = math.inf,
    length: int = 2000,
    seed: int = 0,
    first: int = 0,
) -> None:
    """Tables of what was driven, by environment, scenario and extreme, and every episode in a CSV file.

    Arguments:
        ticks: at which the soak ends
        minutes: after which it ends in any case; 3 are a test for continuous integration
        length: of an episode, at most [ticks]
        seed: of the cases
        first: number of the first case
    """
    outcomes: list[Outcome] = []
    start = said = time.perf_counter()
    total, number = 0, first
    while total < ticks and time.perf_counter() - start < 60.0 * minutes:
        outcome = soak(number, seed, length)
        outcomes.append(outcome)
        total, number = total + outcome.ticks, number + 1
        if outcome.broken:
            report.say(f"BROKEN {outcome.case}: {outcome.broken}")
        if time.perf_counter() - said > _SAY_EVERY:
            said = time.perf_counter()
            held = f"{outcome.megabytes:.0f} MB with {outcome.functions} compiled functions"
            report.say(f"{len(outcomes)} episodes, {total} ticks, {held}; to go on from here: --first {number}")
    _tell(report, outcomes)
    broken, grown = sum(bool(o.broken) for o in outcomes), growth([o.megabytes for o in outcomes])
    report.say(f"\n{len(outcomes)} episodes, {total} ticks, {broken} broken; memory {_signed(grown)}")
    if broken:
        raise FailedError(f"{broken} of {len(outcomes)} episodes broke")
    if len(outcomes) >= MIN_EPISODES and grown > GROWTH:
        raise FailedError(f"memory grew by {_signed(grown)} from the second to the last fifth of the episodes")


def _tell(report: Report, outcomes: Sequence[Outcome]) -> None:
    for by in ("env", "scenario", "extreme"):
        report.table(f"By {by}", summary(outcomes, by))
    report.rows("soak", [
        {"case": str(o.case), "steps": o.steps, "ticks": o.ticks, "seconds": o.seconds, "megabytes": o.megabytes,
         "functions": o.functions, "broken": o.broken}
        for o in outcomes
    ])  # fmt: skip


def _signed(fraction: float) -> str:
    return "unknown" if math.isnan(fraction) else f"{100.0 * fraction:+.1f} %"
