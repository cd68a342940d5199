"""Where a statistic of a consistent filter lies."""

from scipy.stats import chi2


def anees_interval(count: int, dof: int, level: float = 0.95) -> tuple[float, float]:
    """Interval of the ANEES of `count` values with `dof` each (Bar-Shalom, Li and Kirubarajan 2001, sec. 5.4)."""
    n, tail = count * dof, 0.5 * (1.0 - level)
    return float(chi2.ppf(tail, n)) / n, float(chi2.ppf(1.0 - tail, n)) / n
