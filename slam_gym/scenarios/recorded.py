"""How a recording is mapped: the settings of the filter for each kind of log.

Victoria Park's were chosen on its first half, with JCBB. Those of MR.CLAM, and the noise that its reader puts in
(`mrclam.Noise`), were judged with all robots of set 6 in view.
"""

from __future__ import annotations

from slam_gym.mapping.stochastic_map import MapSpec
from slam_gym.recordings.recording import Recording
from slam_gym.slam.slam import SlamSpec

GENERIC = SlamSpec(
    MapSpec(unconfirmed_age=20),
    new_confidence=1.0 - 1e-6,
    max_chance_probability=0.05,
    start_features_from_rejected=True,
)
"""Of a log that nobody has chosen settings for; the reach is taken from its scans. With a limited view, a robot that
comes back sees one old feature first, or one beside it that nobody has mapped."""

VICTORIA_PARK = SlamSpec(MapSpec(confirmations=5, unconfirmed_age=20), reach=80.0, new_confidence=1.0 - 1e-6)
"""A trunk is seen in five of twenty scans. With two sightings, the map of the first half has 118 features more, 23 of
which are labelled trees; the trajectory is the same."""

MRCLAM = SlamSpec(MapSpec(unconfirmed_age=None), reach=12.0, new_confidence=1.0 - 1e-9)
"""A robot may not see a barcode again for minutes, and has drifted by then."""

SETTINGS = {"victoria_park": VICTORIA_PARK, "mrclam": MRCLAM}
"""By the first part of a recording's name."""


def slam_for(recording: Recording) -> SlamSpec:
    """The settings for a recording: those chosen for its kind, or `GENERIC`."""
    kind = recording.name.partition("/")[0]
    return SETTINGS.get(kind, GENERIC)
