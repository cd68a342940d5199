"""What is compatible in narrow headings is what the page finds in each of them."""

import numpy as np
import pytest

from slam_gym.association.compatibility import chi2_gate, individual
from slam_gym.association.tracking.headings import headings
from slam_gym.association.tracking.scan_hypotheses import candidate_gate
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
from slam_gym.slam.narrow_headings import Foreseen, Scene, compatible, joint_in
from slam_gym.types import Scan
from tests.slam.test_marginal_step import sight


@pytest.mark.parametrize("sigma", [0.01, 0.2, 0.6])
def test_candidates_and_covariances_of_every_heading(sigma: float) -> None:
    rng = np.random.default_rng(4)
    points = rng.uniform(-5.0, 5.0, (15, 2))
    m = StochasticMap(MapSpec(second_order=False))
    m.add(Scan.from_points(points, sigma=0.1), np.arange(15))
    m.place(np.zeros(3), np.diag([0.1, 0.1, sigma]) ** 2)
    scan, prediction = Scan.from_points(points[:9] + 0.05, sigma=0.05), m.prediction(20.0)
    x, P, _, _ = m.arrays
    scene, p = Scene(x, P, False, sight().arrays, np.zeros(4)), prediction
    foreseen = Foreseen(
        p.features, p.sizes, p.size_variances, p.kinds, p.ages, p.sightings, p.near, p.positions, p.covariances,
        p.heading_covariances, p.heading_variance,
    )  # fmt: skip
    confidence = candidate_gate(p.confidence)
    found = compatible(
        scan.points, scan.covariances, foreseen, scene, chi2_gate(2, confidence), 0.05, (0.7, 1.0, 50.0), False
    )
    expected = headings(prediction)
    assert len(found) == len(expected) and (len(found) > 1) == (sigma > 0.1)
    for look, heading in zip(found, expected):
        candidates = individual(scan, heading.prediction, confidence)
        for name in ("starts", "measured", "slots", "innovations", "rows", "tests"):
            np.testing.assert_array_equal(getattr(look, name), getattr(candidates, name), err_msg=name)
        assert look.part.log_weight == heading.log_weight
        np.testing.assert_array_equal(
            joint_in(scene, foreseen, look.part, look.rows), heading.prediction.joint(look.rows)
        )
