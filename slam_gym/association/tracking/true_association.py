"""The only associator that uses the truth, as an upper bound for all others."""

import numpy as np

from slam_gym.association.prediction import Prediction
from slam_gym.association.tracking.near_first import Spent, answer
from slam_gym.types import UNPAIRED, BoolArray, Hypothesis, IntArray, Scan


def true_association(
    scan: Scan,
    prediction: Prediction,
    *,
    sources: IntArray | None = None,
    identities: IntArray | None = None,
    new_features: bool = False,
) -> Hypothesis:
    """Pair each measurement with the predicted map feature that comes from the same true feature.

    Arguments:
        sources: (m,) true feature behind each measurement; negative = spurious or unlabelled.
        identities: (n,) true feature behind each feature of the map; negative = spurious or unlabelled. Of several map
            features with one identity, the first counts.
        new_features: also decide which measurements start a feature: the first of each true feature that is not in the
            map.

    Raises ValueError where the truth is missing, or of another number of measurements or features.
    """
    if sources is None or identities is None:
        raise ValueError(
            "true_association needs the true sources: environments, and slam-gym evaluate-association --recording, "
            "have them; Slam alone does not"
        )
    sources, identities = np.asarray(sources), np.asarray(identities)
    if len(sources) != len(scan.points) or len(identities) != prediction.expected.n:
        told = f"sources: {len(sources)} for {len(scan.points)} measurements"
        raise ValueError(f"{told}, identities: {len(identities)} for {prediction.expected.n} features")
    row_of: dict[int, int] = {}
    for row, source in enumerate(identities[prediction.features].tolist()):
        row_of.setdefault(source, row)
    rows = np.array([row_of.get(s, UNPAIRED) if s >= 0 else UNPAIRED for s in sources.tolist()], np.int64)
    new: BoolArray | None = None
    if new_features:
        unmapped = np.flatnonzero((sources >= 0) & ~np.isin(sources, identities))
        new = np.zeros(len(sources), np.bool_)
        new[unmapped[np.unique(sources[unmapped], return_index=True)[1]]] = True
    decided = answer(scan.arrays, prediction.arrays, rows, Spent(len(rows), 0, 0, False))
    return decided.hypothesis(new=new, exclusive=False)
