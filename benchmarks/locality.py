"""The effort that locality saves in relocation, compared with the bound of the source (Eq. 9.22), and its losses.

A surveyed field (`slam_gym.simulation.surveyed_field`) is a map with correlated errors. The robot is lost in it,
and scans once: m measurements, a quarter spurious, without sizes and kinds.

Tables: sizes of the localities, hypotheses of the unpruned tree and losses of each locality; effort of GCBB and of
random sampling (RS) against n, with exponents; answers by the required number of pairings, inside the map and outside.
A pairing test is a unary or a binary one.

    python benchmarks/locality.py        # ten minutes
"""

import functools
import itertools
import math
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from benchmarks.common import Record, attempt, count_answers, options, table
from slam_gym import UNPAIRED, Locality, gcbb, random_sampling
from slam_gym.association.relocation.location import locate
from slam_gym.mapping.locality import hypothesis_bound, hypothesis_count, locality_sizes
from slam_gym.simulation.kidnapping import is_right
from slam_gym.simulation.surveyed_field import LOCALITIES, FieldScan, SurveyedField, surveyed_field
from slam_gym.types import IntArray, Relocator

NEAR = 1.0, math.radians(5.0)  # around the pose by the true pairings
LARGEST = 3_200  # features of a map that is searched without a locality


def searches(*, rivals: bool) -> dict[str, Relocator]:
    """GCBB, with or without the search for rivals, and RS, by their names in the tables."""
    return {"GCBB": functools.partial(gcbb, rivals=rivals), "RS": random_sampling}


def relocate(search: Relocator, area: SurveyedField, drawn: FieldScan, locality: Locality | None) -> Record:
    """Relocate one scan; returns its effort, and which of its pairings are right."""
    answer, record = attempt(search, drawn.scan, area.landmarks, locality)
    true, right = drawn.truth != UNPAIRED, False
    if true.sum() >= 2 and np.isfinite(answer.pose).all():
        right = is_right(answer.pose, locate(drawn.scan, area.landmarks, drawn.truth).pose, *NEAR)
    found = int((true & (answer.features == drawn.truth)).sum())
    record |= {"inside": bool(np.isfinite(drawn.pose).all()), "right": right}
    return record | {"pairings found": found / max(int(true.sum()), 1), "all found": found == true.sum()}


def sweep(
    searched: Mapping[str, Relocator], sizes: Sequence[int], m: int, scans: int, seed: int
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The results of all searches under all localities in maps of each size: a row per scan, and a row per locality
    and size. Without a locality, where the time grows with n², maps have at most `LARGEST` features.
    """
    attempts, localities = [], []
    for n in sizes:
        for number in range(maps := min(max(3200 // n, 1), 5, scans)):
            rng = np.random.default_rng([seed, n, m, number])
            area = surveyed_field(n, rng)
            drawn = [area.scan_inside(m, m // 4, rng) for _ in range(number, scans, maps)]
            for name in LOCALITIES:
                locality, key = area.locality(name), {"locality": name, "n": n, "m": m}
                localities.append(key | figures(n, m, locality, [scan.truth for scan in drawn]))
                if locality is not None or n <= LARGEST:
                    attempts += [
                        {"search": search, **key, **relocate(searched[search], area, scan, locality)}
                        for search in searched for scan in drawn
                    ]  # fmt: skip
    means = pd.DataFrame(localities).groupby(["locality", "n", "m"], sort=False).mean().reset_index()
    return pd.DataFrame(attempts), means


def figures(n: int, m: int, locality: Locality | None, truths: Sequence[IntArray]) -> Record:
    """Mean and largest |L(j)| in a map of n features, N_h of the unpruned tree, the bound of Eq. 9.22, and losses."""
    sizes = locality_sizes(locality, n)
    counts = {"N_h": hypothesis_count(sizes, m), "9.22, max c": hypothesis_bound(n, m, int(sizes.max()))}
    return {"mean c": sizes.mean(), "max c": sizes.max(), **counts, **losses(truths, locality)}


def losses(truths: Sequence[IntArray], locality: Locality | None) -> dict[str, float]:
    """The fractions that a locality loses before any test, from the feature (m,) behind each measurement of each scan.

    `pairs`: pairs of features seen in one scan that are not local to each other. `pairings`: true pairings that are not
    in the best hypothesis that pairs measurements in the order of the scan, so that its first pairing determines the
    locality. `scans`: scans without such a hypothesis with all true pairings. `anyhow`: scans without one even if any
    measurement may be paired first, as in random sampling.
    """
    known = [truth[truth != UNPAIRED] for truth in truths]
    everything = np.concatenate(known)
    local = [np.array([np.isin(one, everything if locality is None else locality.of(j)) for j in one]) for one in known]
    pairs, true = sum(len(one) * (len(one) - 1) for one in local), sum(len(one) for one in local)
    return {
        "pairs": sum(int((~one).sum()) for one in local) / pairs,
        "pairings": 1.0 - sum(int(np.triu(one).sum(axis=1).max()) for one in local) / true,
        "scans": 1.0 - float(np.mean([one[0].all() for one in local])),
        "anyhow": 1.0 - float(np.mean([one.all(axis=1).any() for one in local])),
    }


def inside_and_outside(search: Relocator, name: str, n: int, m: int, scans: int, seed: int) -> pd.DataFrame:
    """Attempts at `scans` scans from inside and as many from outside the map, under a locality, over several maps."""
    rows, maps = [], min(10, scans)
    for number in range(maps):
        rng = np.random.default_rng([seed, n, m, number])
        area = surveyed_field(n, rng)
        locality = area.locality(name)
        for _ in range(number, scans, maps):
            rows.append(relocate(search, area, area.scan_inside(m, m // 4, rng), locality))
            rows.append(relocate(search, area, area.scan_outside(m, rng), locality))
    return pd.DataFrame(rows)


def power(attempts: pd.DataFrame, name: str, rng: np.random.Generator) -> tuple[float, float, float]:
    """Exponent p of means ∝ n^p, by least squares on logarithms; 95 % interval by resampling scans of each size."""
    groups = {n: group.to_numpy(float) for n, group in attempts.groupby("n")[name]}
    x = np.log(list(groups))
    resampled = [v[rng.integers(0, len(v), (2000, len(v)))].mean(axis=1) for v in groups.values()]
    drawn = np.polyfit(x, np.log(np.maximum(resampled, 1e-12)), 1)[0]
    estimate = np.polyfit(x, np.log([v.mean() for v in groups.values()]), 1)[0]
    return float(estimate), *np.quantile(drawn, [0.025, 0.975]).tolist()


def exponents(attempts: pd.DataFrame, fitted_from: int, seed: int) -> list[Record]:
    """Exponents in n of every series with at least two sizes from `fitted_from` features on."""
    rows = []
    for (search, name), group in attempts[attempts["n"] >= fitted_from].groupby(["search", "locality"], sort=False):
        if group["n"].nunique() > 1:
            fits = {of: power(group, of, np.random.default_rng(seed)) for of in ("nodes", "pairing tests", "ms")}
            cells = {of: "{:.2f} [{:.2f}, {:.2f}]".format(*fit) for of, fit in fits.items()}
            rows.append({"search": search, "locality": name, **cells})
    return rows


if __name__ == "__main__":
    a = options(__doc__, seed=0, scans=30, judged=500, largest=12_800)
    scans, judged, largest = (2, 4, 100) if a.quick else (a.scans, a.judged, a.largest)
    sizes = [n for n in (50, 100, 200, 400, 800, 1600, 3200, 6400, 12_800) if n <= largest]
    attempts, localities = sweep(searches(rivals=False), sizes, 8, scans, a.seed)
    table("Localities; hypotheses of the unpruned tree (m = 8), fractions of the truth that are lost", localities)
    means = attempts.groupby(["search", "locality", "n"], sort=False).mean(numeric_only=True).reset_index()
    shown = ["nodes", "pairing tests", "ms", "pairings found", "all found", "right", "limit hit"]
    table("Effort against the size of the map; means per scan", means[["search", "locality", "n", *shown]])
    table("Exponents in n", exponents(attempts, sizes[0] if a.quick else 800, a.seed))
    rows = []
    for m, (name, search) in itertools.product((6, 8, 10), searches(rivals=True).items()):
        tried = inside_and_outside(search, "two hops", 100 if a.quick else 400, m, judged, a.seed)
        rows += [{"search": name, "m": m, **count_answers(tried, least)} for least in (None, *range(3, m + 1))]
    table("Answers by the required number of pairings, two hops", rows)
