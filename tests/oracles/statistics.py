"""Where a statistic of a consistent filter lies; tests that hold for every seed."""

import functools
import inspect
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.stats import chi2

from slam_gym.types import Array


def anees_interval(count: int, dof: int, level: float = 0.95) -> tuple[float, float]:
    """Interval of the ANEES of `count` values with `dof` each (Bar-Shalom, Li and Kirubarajan 2001, sec. 5.4)."""
    n, tail = count * dof, 0.5 * (1.0 - level)
    return float(chi2.ppf(tail, n)) / n, float(chi2.ppf(1.0 - tail, n)) / n


def nees_of_each(errors: Array, covariances: Array) -> Array:
    """(n,) eᵀ P⁻¹ e of errors (n, d) with covariances (n, d, d)."""
    return np.einsum("ni,nij,nj->n", errors, np.linalg.inv(covariances), errors)


def random_covariance(rng: np.random.Generator, d: int, scale: float = 1.0) -> Array:
    """(d, d), of standard deviations of about `scale`."""
    root = rng.normal(0.0, scale, (d, d))
    return root @ root.T + (0.1 * scale) ** 2 * np.eye(d)


def for_seeds(count: int) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Run a test for the seeds 0 … count − 1 as one test: as many tests would take longer than what they test.

    A failure names its seed. Fixtures are those of one test, so a test that changes them is not for this.
    """

    def repeated(test: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(test)
        def run(**others: Any) -> None:
            for seed in range(count):
                try:
                    test(seed=seed, **others)
                except Exception as error:
                    error.add_note(f"seed {seed}")
                    raise

        signature = inspect.signature(test)
        others = [parameter for name, parameter in signature.parameters.items() if name != "seed"]
        run.__signature__ = signature.replace(parameters=others)  # type: ignore[attr-defined]
        return run

    return repeated
