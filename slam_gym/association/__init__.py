"""Associators, relocators and policies: searches of the interpretation tree.

With a prior on the pose, an associator maps a `Scan` and a `Prediction` to a `Hypothesis` (`ASSOCIATORS`,
`from_policy`). Without one, a relocator maps a `Scan`, the `Landmarks` of a map and a `Locality` to a `Relocation`
(`RELOCATORS`, `relocator_from_policy`). Each can be selected by name, passed as a function, or written as a policy of
the tree.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from slam_gym.association.policy import from_policy, greedy, relocator_from_policy
from slam_gym.association.prediction import Prediction
from slam_gym.association.relocation.cliques import max_clique
from slam_gym.association.relocation.gcbb import gcbb
from slam_gym.association.relocation.random_sampling import random_sampling
from slam_gym.association.relocation.triangles import indexed
from slam_gym.association.tracking.ipjc import ipjc
from slam_gym.association.tracking.jcbb import jcbb
from slam_gym.association.tracking.learned import learned_associator
from slam_gym.association.tracking.map_hypothesis import map_hypothesis
from slam_gym.association.tracking.marginal import marginal
from slam_gym.association.tracking.nearest_neighbour import global_nearest_neighbour, nearest_neighbour, singles
from slam_gym.association.tracking.one_point_ransac import one_point_ransac
from slam_gym.association.tracking.ppo import ppo, walk_by
from slam_gym.association.tracking.true_association import true_association
from slam_gym.association.walks import Policy
from slam_gym.mapping.stochastic_map import checked_pose
from slam_gym.types import Hypothesis, Landmarks, Locality, Relocation, Relocator, Scan
from slam_gym.validation import check_hypothesis, check_number, imported

__all__ = [
    "ASSOCIATORS",
    "RELOCATORS",
    "Policy",
    "check_relocation",
    "from_policy",
    "gcbb",
    "global_nearest_neighbour",
    "greedy",
    "indexed",
    "ipjc",
    "jcbb",
    "learned_associator",
    "map_hypothesis",
    "marginal",
    "max_clique",
    "nearest_neighbour",
    "one_point_ransac",
    "ppo",
    "random_sampling",
    "relocator_from_policy",
    "resolve_associator",
    "resolve_relocator",
    "singles",
    "true_association",
]

ASSOCIATORS: dict[str, Callable[..., Hypothesis]] = {
    "global_nearest_neighbour": global_nearest_neighbour,
    "ipjc": ipjc,
    "jcbb": jcbb,
    "learned": learned_associator,
    "map_hypothesis": map_hypothesis,
    "marginal": marginal,
    "nearest_neighbour": nearest_neighbour,
    "one_point_ransac": one_point_ransac,
    "ppo": ppo,
    "singles": singles,
    "true_association": true_association,
}
"""Associators by name, called with (scan, prediction). `true_association` also needs the true sources of the scan."""

RELOCATORS: dict[str, Relocator] = {
    "gcbb": gcbb,
    "indexed": indexed,
    "max_clique": max_clique,
    "random_sampling": random_sampling,
}
"""Relocators by name, called with (scan, landmarks, locality or None)."""


def resolve_associator(associator: str | Callable[..., Hypothesis]) -> Callable[..., Hypothesis]:
    """The associator given by name, as `"module:name"`, as a file of trained weights (`.npz`), or as a function.

    Raises ValueError, listing the known names, where there is no such associator or file.
    """
    if isinstance(associator, str) and associator.endswith(".npz"):
        if not Path(associator).is_file():
            raise ValueError(f"associator {associator}: there is no such file")
        return walk_by(associator)
    resolved: Callable[..., Hypothesis] = _resolve("associator", associator, ASSOCIATORS)
    return resolved


def resolve_relocator(relocator: str | Relocator) -> Relocator:
    """The relocator given by name, as `"module:name"`, or as a function. Raises ValueError as `resolve_associator`."""
    resolved: Relocator = _resolve("relocator", relocator, RELOCATORS)
    return resolved


def check_relocation(answer: Relocation, measurements: int, features: int) -> Relocation:
    """The answer of a relocator for so many measurements and features. Raises ValueError, telling what is wrong with
    it: its type, its pairings, how many it requires or, if they are accepted, its pose or covariance."""
    if not isinstance(answer, Relocation):
        raise ValueError(f"returned {type(answer).__name__}, not a Relocation")
    check_hypothesis(Hypothesis(answer.features, 0.0, 0), measurements, features)
    check_number("min_pairings", answer.min_pairings)
    if answer.accepted:
        checked_pose(answer.pose, answer.covariance)
    return answer


@dataclass(frozen=True, slots=True)
class _ReadOnly:
    """A user's associator or relocator, called with a scan, and landmarks, whose arrays are read-only. Its errors, and
    those of its answer, name it."""

    role: str
    function: Callable[..., Any]
    is_checked: ClassVar[bool] = True

    def __call__(self, scan: Scan, known: Prediction | Landmarks, *locality: Locality | None) -> Any:
        name = f"{self.role} {getattr(self.function, '__name__', repr(self.function))}"
        try:
            read_only = known.read_only() if isinstance(known, Landmarks) else known
            answer = self.function(scan.read_only(), read_only, *locality)
        except Exception as error:
            error.add_note(f"raised by {name}")
            raise
        try:
            if isinstance(known, Prediction):
                return check_hypothesis(answer, len(scan), known.expected.n)
            return check_relocation(answer, len(scan), len(known))
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None


def _resolve(role: str, value: Any, table: Mapping[str, Any]) -> Any:
    resolved = value if callable(value) else table.get(value) or imported(role, str(value), table)
    if not callable(resolved):
        raise ValueError(f"{role} {value!r} is not callable; known: {', '.join(table)}")
    is_checked = getattr(resolved, "is_checked", False) or any(resolved is known for known in table.values())
    return resolved if is_checked else _ReadOnly(role, resolved)
