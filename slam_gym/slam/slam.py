"""Feature-based SLAM with a stochastic map, one step on one page: predict, associate, update, add, maintain."""

import math
import warnings
from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial import cKDTree

from slam_gym.association import check_relocation, marginal, resolve_associator
from slam_gym.association.compatibility import chi2_gate
from slam_gym.association.prediction import Associator, Prediction, SlamStep, predict
from slam_gym.association.tracking.marginal import NOTHING_SEEN
from slam_gym.geometry import compose_jacobians, inverse, observe
from slam_gym.mapping import ekf
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.map_joining import UNKNOWN_POSE
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap, checked_pose
from slam_gym.navigation.visibility import ViewsFrom
from slam_gym.slam.atlas import Atlas, AtlasSpec, accepted
from slam_gym.slam.negative_evidence import NegativeEvidence
from slam_gym.slam.places.fusion import MappedArea
from slam_gym.slam.places.loops import NO_PAIRS
from slam_gym.slam.relocate import Relocate, Tracker
from slam_gym.slam.step import Settings, learn
from slam_gym.types import NO_ID, UNPAIRED, Array, BoolArray, Effort, Experience, Hypothesis, Odometry, Relocation, Scan
from slam_gym.validation import Checked, check_hypothesis, check_inputs, check_scan

_NO_FEATURES = np.empty(0, np.int64)
_SLIP = 1000.0  # factor on the covariance of a motion in which the wheels have slipped, where the view is unknown
_AT_REST = 0.01  # fraction of their information that pairings keep where the robot does not move
STILL = Odometry(np.zeros(3), np.zeros((3, 3)))
"""A robot that does not move, for certain."""


@dataclass(frozen=True)
class SlamSpec(Checked):
    """Settings of a SLAM run."""

    map: MapSpec = field(default_factory=MapSpec)
    reach: float | None = None  # [m] features predicted within it are offered; None: the farthest measurement so far
    new_confidence: float | None = None  # of the gate outside which a measurement is new; None: `map.confidence`
    locality: bool = True  # offer covisibility localities to the associator
    recent: int = 5  # [scans] whose pairings define the locality that is searched first
    lost_fraction: float = 0.3  # a scan that pairs less of the features expected in view, and less than half of its
    # measurements, is doubted …
    lost_scans: int = 5  # … and after so many doubted scans in a row the robot is lost
    min_expected: int = 3  # fewest expected features, or measurements, from which a doubt can begin
    outlier_factor: float = 1.0  # where the view is known, a doubted scan is associated again with this factor on the
    # covariance of the last motion, which may be an outlier; 1: it is not
    max_accidental_matches: float = 0.5  # an old feature whose gate expects more of them is not offered
    max_chance_probability: float = 1.0  # expected number of accidental hypotheses with as many pairings, above which
    # all pairings with old features are rejected; 1: never
    trust_marginals: bool = True  # associators that weigh all hypotheses are exempt from `max_accidental_matches`, and
    # say which measurements are new; both rules need an atlas
    error_length: float = 0.0  # [m] motion after which errors of measurements are independent of those before; after a
    # shorter motion, a pairing has that fraction of its information
    negative_evidence: bool = False  # where the view is known, remove features that should be in view and are not
    # measured (`slam_gym.slam.negative_evidence`); needs `relocate`, which notices that the pose is wrong


class Slam:
    """A robot's map and pose estimate, and the step that updates them.

    Arguments:
        spec: settings.
        view_from: tells associators and the tracker what the sensor should have in view from a pose.
        relocate: finds a lost robot (`slam_gym.slam.relocate.relocate_by`). A scan that pairs too few of the features
            that should be in view is then doubted, and not learned from, unless the wheels have slipped. After too many
            doubted scans in a row the robot is lost, and every further scan searches for it. None: every scan is
            learned from.
        atlas: closes loops, and starts and joins maps of a robot that stays lost (`slam_gym.slam.atlas`).

    Raises ValueError for an atlas without `relocate`, and for a name in place of the function or the settings.
    """

    def __init__(
        self,
        spec: SlamSpec | None = None,
        view_from: ViewsFrom | None = None,
        *,
        relocate: Relocate | None = None,
        atlas: AtlasSpec | None = None,
    ) -> None:
        if not (spec is None or isinstance(spec, SlamSpec)):
            raise ValueError(f"spec: {spec!r}, expected a SlamSpec")
        if not (relocate is None or callable(relocate)):
            raise ValueError(f"relocate: {relocate!r} is not a function; relocate_by makes one of a name")
        if not (atlas is None or isinstance(atlas, AtlasSpec)):
            raise ValueError(f"atlas: {atlas!r}, expected an AtlasSpec")
        self.spec = spec or SlamSpec()
        self.view_from, self.relocator = view_from, relocate
        self.tracker = Tracker(self.spec.lost_fraction, self.spec.lost_scans, self.spec.min_expected)
        self.atlas: Atlas | None = None
        if atlas is not None:
            if relocate is None:
                raise ValueError("atlas: needs `relocate`, which finds a lost robot")
            self.atlas = Atlas(atlas, relocate)
        self.map = StochasticMap(self.spec.map)
        self.covisibility = CovisibilityGraph()
        removes = self.spec.negative_evidence and relocate is not None
        self._evidence = NegativeEvidence(None if relocate is None else self.tracker, removes)
        self.fused = NO_PAIRS  # (k, 2) ids of the features fused in the last step: the kept one, the removed one
        self._learned_at: deque[int] = deque(maxlen=self.spec.recent)  # steps of the last scans learned from
        self._farthest = 0.0  # [m] distance of the farthest measurement so far
        self._experience: Experience | None = None  # what the associator has learned so far
        self._weighs_all = False  # whether the associator of the last scan returns an experience
        self._odometry = STILL  # the last
        self._moved = math.inf  # [m] since the last scan that was believed and measured anything
        # the graph, its size and the id of its last feature, which changes where others remove any: ids ascend
        self._remembered = self.covisibility, 0, NO_ID
        self._adopted = _NO_FEATURES  # ids of features that others have added to the map
        self._linked = math.nan  # [m] the reach by which these were last linked
        self._warned = False
        confidence, self._gate = self.spec.new_confidence, chi2_gate(2, self.spec.map.confidence)
        # χ² gate: a measurement that is compatible with any feature within it does not start a new one
        self._new_gate = chi2_gate(2, self.spec.map.confidence if confidence is None else confidence)

    def __repr__(self) -> str:
        return f"Slam: {self.map!r}"

    def step(self, odometry: Odometry, scan: Scan, associator: str | Associator = "jcbb") -> SlamStep:
        """Run one step of Castellanos, Neira and Tardós (2006): predict, associate, update, add, maintain.

        `associator` is a name, `"module:function"` or a callable. Raises ValueError, before anything is changed, for an
        unknown associator and where `predict` does; and where `learn` does, once the motion has been predicted.
        """
        associate = resolve_associator(associator)
        prediction = self.predict(odometry, scan)
        hypothesis = associate(scan, prediction)
        return self.learn(scan, prediction, hypothesis)

    def predict(self, odometry: Odometry, scan: Scan) -> Prediction:
        """Move the robot by `odometry`; returns what `scan` should show from there, and the locality to search first.

        A map that was loaded may take the place of `map` before the first step. It follows the settings of this Slam,
        and its features count as covisible where one scan may see them.
        Raises ValueError, before anything is changed, for non-finite numbers and invalid covariances, and where others
        have removed features of the map.
        """
        check_inputs(odometry, scan)
        self.map.spec = self.spec.map
        known, (graph, count, newest) = self.covisibility.n, self._remembered
        ours = count > 0 and known == count and graph is self.covisibility
        if self.map.n < known or (ours and self.map.arrays[2][ekf.IDS, count - 1] != newest):
            raise ValueError("map: features were removed by others than this Slam")
        if self.map.n != known:  # the map was loaded, or others have added features
            self._adopt()
        if len(self._adopted):
            check_scan(scan)
        prediction = self._predict(odometry, scan, self._most_accidental)
        self._odometry = odometry
        if self.spec.error_length > 0.0:
            self._moved += math.hypot(*odometry.motion[:2])
        return prediction

    def learn(self, scan: Scan, prediction: Prediction, hypothesis: Hypothesis) -> SlamStep:
        """Complete the step after association: the map learns from the scan if the tracker believes it.

        Raises ValueError for a hypothesis that does not fit scan and map, and RuntimeError for a prediction that is not
        the latest; only the motion has been predicted then.
        """
        if prediction.estimate is not self.map.estimate:
            raise RuntimeError("prediction: the map has changed since it was made, or another map made it")
        check_scan(scan)
        hypothesis, self.fused = check_hypothesis(hypothesis, len(scan), self.map.n), NO_PAIRS
        if not len(scan) and self.view_from is None:  # odometry alone, not a scan
            return SlamStep(prediction, hypothesis, _NO_FEATURES, np.zeros(0, np.bool_), _NO_FEATURES)
        self._weighs_all, spec = hypothesis.experience is not None, self.spec
        if self.relocator is not None:
            factor = spec.outlier_factor if prediction.has_view else _SLIP
            if factor > 1.0 and self.tracker.suspects_slip(scan, prediction, hypothesis):
                prediction, hypothesis = self._after_slip(scan, prediction, hypothesis, factor)
            if not self.tracker.believes(scan, prediction, hypothesis):
                return self.close_loops(self.relocate(scan, prediction), scan)
        if self.atlas is not None:
            believed = hypothesis
            hypothesis = accepted(scan, prediction, hypothesis, spec.max_chance_probability, spec.trust_marginals)
            if hypothesis is not believed:
                self.tracker.accept(hypothesis)  # features of rejected pairings are not expected in the next scan
        return self.close_loops(self.update(scan, prediction, hypothesis), scan)

    def update(self, scan: Scan, prediction: Prediction, hypothesis: Hypothesis) -> SlamStep:
        """Update the map with the pairings, add new features, and remove those that were not confirmed or do not exist.

        `hypothesis.new` says which measurements start a feature. If it is None, a measurement starts one if it is
        unpaired *and* individually compatible with no predicted feature: a measurement that is compatible but unpaired
        more likely comes from a mapped feature, and is discarded. A gate of confidence γ turns away 1 − γ of the right
        pairings, and each would start a duplicate: over hundreds of scans a wider gate pays off (`new_confidence`).
        """
        m, graph, count = self.map, self.covisibility, len(scan.points)
        if self._moved < self.spec.error_length and count:
            fraction = max(self._moved / self.spec.error_length, _AT_REST)
            factors = np.where(hypothesis.features == UNPAIRED, 1.0, 1.0 / fraction)
            scan = replace(scan, covariances=factors[:, None, None] * scan.covariances)
        self._moved = 0.0 if count else self._moved
        absent = self._evidence.learn(prediction, hypothesis, m)
        m.make_room(count)
        graph.make_room(count)
        is_decided, ids = hypothesis.new is not None, np.empty(count, np.int64)
        created = np.array(hypothesis.new) if is_decided else np.empty(count, np.bool_)
        decisions, known = (hypothesis.features, created, is_decided, ids), prediction.expected
        expected, numbers = (known.positions, known.covariances), (m.n, m.step, m.next_id)
        added, removed, became = learn(
            m.arrays, numbers, graph.counts, scan.arrays, decisions, expected, absent, self._settings
        )
        self._experience = hypothesis.experience or self._experience
        m.learned(added, len(removed))
        graph.n = m.n
        if added or len(removed):
            self._remember()
        self._learned_at.append(m.step)
        if len(removed):
            self.tracker.renumber(became)
        m.end_of_step()
        if added and self.spec.reach is not None:
            self._warn_of_reach(scan, created, self.spec.reach)
        return SlamStep(prediction, hypothesis, ids, created, removed)

    def relocate(self, scan: Scan, prediction: Prediction) -> SlamStep:
        """The step of a doubted scan: the map learns from it only if the robot is lost and the scan finds it again.

        The robot is then moved to the pose found, with an uninformative covariance, and the update with the pairings
        determines the pose. A robot that stays lost for too long goes on in another map.
        Raises ValueError, before the robot is moved, for an invalid answer of the relocator.
        """
        assert self.relocator is not None
        unpaired = Hypothesis(np.full(len(scan), UNPAIRED), 0.0, 0, Effort())
        found = None
        if self.tracker.lost:
            found = self.relocator(scan, self.map, self.covisibility, self.reach, self.view_from)
        if found is not None:
            return self._go_on_from(found, scan)
        if self.atlas is not None and self.atlas.gives_up(self.tracker):
            removed = self.map.ids
            self.map, self.covisibility = self.atlas.next_map(self.map, self.covisibility), CovisibilityGraph()
            self._learned_at.clear()
            self._evidence.reset()
            self.tracker.forget()
            return replace(self.update(scan, self.predict(STILL, scan), unpaired), removed=removed)
        self.map.end_of_step()
        return SlamStep(prediction, unpaired, np.full(len(scan), NO_ID), np.zeros(len(scan), np.bool_), _NO_FEATURES)

    def close_loops(self, step: SlamStep, scan: Scan) -> SlamStep:
        """Fuse the features that the atlas recognises as the same, and return the step with what changed."""
        if self.atlas is None or self.doubted:
            return step
        known = len(self.atlas.fusions)
        fusion = self.atlas.fusion(MappedArea(self.map, self.covisibility), step, scan, self.reach, self.missed_loop)
        if fusion is None:
            return step
        self.map, self.covisibility, self.fused = fusion.map, fusion.covisibility, fusion.ids
        self._remember()
        self.tracker.renumber(fusion.became)
        if any(record.kind != "duplicates" for record in self.atlas.fusions[known:]):
            self._evidence.reset()
        if len(fusion.returned):
            self.tracker.relocations += 1
        removed_now = np.concatenate([step.removed, fusion.ids[:, 1]])
        return replace(step, removed=removed_now, returned=fusion.returned)

    @property
    def _most_accidental(self) -> float:
        """The number of accidental matches in the gate of an old feature above which that feature is not offered.

        Where a loop seems to have been missed, none is: the pose may be wrong, and the search for loops decides by more
        pairs than a scan has. Without a known view, the sign is not reliable enough.
        """
        if self.atlas is not None and self.view_from is not None and self.missed_loop:
            return 0.0
        is_exempt = self.atlas is None or (self._weighs_all and self.spec.trust_marginals)
        return math.inf if is_exempt else self.spec.max_accidental_matches

    @property
    def reach(self) -> float:
        """[m] within which features are predicted: `spec.reach`, or to the farthest measurement so far and 3 σ more."""
        return self._farthest if self.spec.reach is None else self.spec.reach

    @property
    def maps(self) -> tuple[StochasticMap, ...]:
        """The active map, then the inactive maps of the atlas, each in the coordinates it had when it was left."""
        return (self.map,) if self.atlas is None else (self.map, *[area.map for area in self.atlas.inactive])

    @property
    def lost(self) -> bool:
        """Whether the robot is lost, and waits for relocation. Always False without `relocate`."""
        return self.tracker.lost

    @property
    def doubted(self) -> bool:
        """Whether a scan was doubted, and none has been believed since. Always False without `relocate`."""
        return self.tracker.doubted > 0

    @property
    def missed_loop(self) -> bool:
        """Whether the robot seems to map a place for the second time: see `slam_gym.slam.negative_evidence`.

        It remains true until a loop is closed, maps are joined, or another map begins. Always False with neither
        `view_from` nor `relocate`.
        """
        return self._evidence.missed_loop

    @property
    def relocations(self) -> int:
        """How often the robot has been relocated so far."""
        return self.tracker.relocations

    def _predict(self, odometry: Odometry, scan: Scan, most_accidental: float) -> Prediction:
        """Predict the features in reach, without old ones whose gates expect more than `most_accidental` matches."""
        reach = self.reach
        if self.spec.reach is None:
            reach = max(reach, _farthest(scan.points, scan.covariances))
        if len(self._adopted) and reach != self._linked:
            self._link_adopted(reach)
        prediction = predict(
            self.map, reach, odometry=odometry, scan=scan, graph=self.covisibility if self.spec.locality else None,
            since=self._learned_at[0] if self._learned_at else self.map.step, accidental=(self._gate, most_accidental),
            sight=self.view_from, experience=self._experience,
        )  # fmt: skip
        self._farthest = reach
        return prediction

    def _after_slip(
        self, scan: Scan, prediction: Prediction, hypothesis: Hypothesis, factor: float
    ) -> tuple[Prediction, Hypothesis]:
        """Associate again by `marginal`, with `factor` times the covariance of the last motion. Returns prediction and
        hypothesis of wheels that have slipped if the scan confirms it, and otherwise the given ones.

        Nothing has slipped where `marginal` can explain the scan with the given prediction: the associator failed.
        """
        if not self.tracker.suspects_slip(scan, prediction, marginal(scan, _understood(prediction))):
            return prediction, hypothesis
        before, Q = self.map, self._odometry.covariance
        self.map = before.copy()
        _, turned = compose_jacobians(inverse(self._odometry.motion), np.zeros(3))  # Q is in R before the motion
        slipped = Odometry(np.zeros(3), (factor - 1.0) * turned @ Q @ turned.T)
        prediction_after = self._predict(slipped, scan, self._most_accidental)
        after = marginal(scan, _understood(prediction_after))
        if self.tracker.confirms_slip(scan, (prediction, hypothesis), (prediction_after, after)):
            self.tracker.slips += 1
            experience = after.experience if _is_of_marginal(hypothesis.experience) else hypothesis.experience
            return prediction_after, replace(after, experience=experience)
        self.map = before
        return prediction, hypothesis

    def _go_on_from(self, found: Relocation, scan: Scan) -> SlamStep:
        """Go on from a relocation. Raises ValueError, before the robot is moved, for an invalid one."""
        check_relocation(found, len(scan), self.map.n)
        checked_pose(found.pose, found.covariance)  # also of an answer that is not accepted
        answer = Hypothesis(found.features, found.joint_distance, 2 * found.pairings, found.effort)
        hypothesis = check_hypothesis(answer, len(scan), self.map.n)
        self.map.place(found.pose, UNKNOWN_POSE * max(1.0, *np.diag(found.covariance)[:2]))
        self.tracker.forget()
        self.tracker.accept(hypothesis)
        self.tracker.relocations += 1
        everything = self._predict(STILL, scan, math.inf)  # no limit: from an unknown pose every feature is ambiguous
        return self.update(scan, everything, hypothesis)

    def _adopt(self) -> None:
        """Enter the features in the graph that others have added to the map."""
        m, graph = self.map, self.covisibility
        if not graph.n:  # the robot of a loaded map should see what it saw in its last scan
            seen = np.flatnonzero(m.last_seen == m.last_seen.max())
            self.tracker.accept(Hypothesis(seen, 0.0, 0))
            self.tracker.look(observe(m.pose, m.positions[seen]))
        self._adopted, self._linked = np.concatenate([self._adopted, m.ids[graph.n :]]), math.nan
        graph.add(m.n - graph.n)
        self._remember()

    def _remember(self) -> None:
        """Note the id of the last feature, after the map has changed."""
        newest = int(self.map.arrays[2][ekf.IDS, self.map.n - 1]) if self.map.n else NO_ID
        self._remembered = self.covisibility, self.map.n, newest

    def _link_adopted(self, reach: float) -> None:
        """Add an edge between any two features added by others that one scan with this `reach` [m] may see."""
        rows = np.flatnonzero(np.isin(self.map.ids, self._adopted))
        near = cKDTree(self.map.positions[rows]).query_pairs(2.0 * reach, output_type="ndarray")
        self.covisibility.link(rows[near])
        self._linked = reach

    @property
    def _settings(self) -> Settings:
        """The settings that `learn` takes."""
        spec = self.spec.map
        before = self.map.step - spec.unconfirmed_age if spec.unconfirmed_age is not None else -1
        return spec.iterations, float(spec.settled), spec.right_invariant, self._new_gate, spec.confirmations, before

    def _warn_of_reach(self, scan: Scan, new: BoolArray, reach: float) -> None:
        """Warn, once, where one of the `new` measurements (m,) starts a feature too far away to be predicted."""
        beyond = 0.0 if self._warned else _farthest(scan.points[new], scan.covariances[new], -6.0)
        if beyond <= reach:
            return
        self._warned = True
        warnings.warn(
            f"SlamSpec.reach={reach} m, but a scan measures at {beyond:.1f} m and more: features so far away are never "
            "offered for pairing, and every scan starts them again; reach=None takes the reach from the scans",
            stacklevel=4,
        )


def _is_of_marginal(experience: Experience | None) -> bool:
    """Whether there is an experience, and of the form of `marginal`; associators of users may have others."""
    return experience is not None and experience.detections.shape == NOTHING_SEEN.detections.shape


def _understood(prediction: Prediction) -> Prediction:
    """The prediction without an experience that `marginal` does not understand."""
    return prediction if _is_of_marginal(prediction.experience) else replace(prediction, experience=None)


def _farthest(points: Array, covariances: Array, sigmas: float = 3.0) -> float:
    """[m] The greatest ‖z‖ + `sigmas` · σ of measurements (m,), at least 0; σ² is the trace of the covariance."""
    with np.errstate(invalid="ignore", over="ignore"):  # of a scan that will be refused
        sigma = np.sqrt(covariances[:, 0, 0] + covariances[:, 1, 1])
        distances: Array = np.sqrt(points[:, 0] ** 2 + points[:, 1] ** 2) + sigmas * sigma
    return float(distances.max(initial=0.0))
