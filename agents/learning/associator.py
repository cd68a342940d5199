"""The training of the learned associator, from worlds to weights.

The examples are the hypotheses that the search keeps of a scan, and which of their pairings are right. Scans come from
train worlds of the suite and of the scenarios, and from the training parts of recordings. The maps of drives and logs
are made by associators, so that they contain the mistakes of associators.

The hypotheses of a scan have log densities by the model; the network adds to each the log odds of its pairings. The
probability of a decision on a measurement is the sum over the hypotheses that contain it. Training maximises the
probability of the right decisions. So the network learns what the model lacks, and the marginals become calibrated.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from rich.progress import track
from torch import Tensor

from agents.evaluation.pipeline import run_all
from agents.learning.cloning import figure, fit
from agents.suite import problems
from slam_gym.association import resolve_associator
from slam_gym.association.prediction import Prediction
from slam_gym.association.tracking.learned import WEIGHTS
from slam_gym.association.tracking.marginal import examples
from slam_gym.association.tracking.network import FARTHEST, INPUTS, VERSION, Network, load_network
from slam_gym.recordings import open_recordings
from slam_gym.scenarios import get_scenario, overridden, slam_for, world_generator, world_seed
from slam_gym.scenarios.suite import EXPERIMENTS, RELOCATION, get_level
from slam_gym.simulation.association_runs import DRIVERS, AssociationRun, DrivenRun, LoggedRun, ScanLog
from slam_gym.simulation.episode import survey
from slam_gym.simulation.judged import RightAnswers
from slam_gym.simulation.recorded_logs import reference_poses
from slam_gym.types import UNLABELLED, UNPAIRED, Array, BoolArray, IntArray, Scan, Truth
from slam_gym.weights import Card, Weights

WIDTH, MARGIN = 150, 16.0  # of the search; wider than in use, since the network is not trained yet
_MOST = 80  # hypotheses of a scan that are kept
_EASY = 0.15  # fraction of the unambiguous scans that are kept; the weight of each is divided by it
_DOUBT = 0.02  # a scan is ambiguous where the best hypothesis has a smaller probability than 1 − this

LEVELS = tuple(level.id for e in EXPERIMENTS.values() if e.name != RELOCATION for level in e.levels)
DRIVES = {
    "office": 6, "aliased": 6, "hall": 8, "crowd": 6, "sparse": 6, "building": 5, "drift-1": 12, "drift-2": 12,
    "drift-3": 12, "aliased-drift": 12, "hall-drift": 24, "crowd-drift": 12, "loop": 40,
}  # fmt: skip
"""The number of worlds of each scenario in which nothing is hidden. `loop` has most of the closures that are hard."""

MAKERS = ("marginal", "map_hypothesis")
"""The associators that make the maps of drives, by turns, and of each log. They make different mistakes."""

THINNED = (5, 10)  # every so many scans of Victoria Park, of the first half of the log

HIDDEN = (("sizes", "kinds told"), ("sizes",), ("sizes", "views", "past", "kinds told"))
"""What is hidden in every fourth world of a level, by turns, so that the network learns what a pairing is worth when
less is known about it. Only with `kinds told` do sensors tell kinds. Something is told always: where neither sizes nor
views nor kinds are, `learned` leaves the decision to `marginal`."""

SHARES = {"level": 0.5, "drive": 0.45, "log": 0.05}
"""The share of each kind of source in the loss, whatever its number of scans."""

_HIDDEN_COUNT = 4.0  # weight of a scan of which something is hidden: many logs are like them
_ENOUGH = 16.0  # limit on log odds in training
_LEAST = 1e-4  # limit on the probabilities in the loss
_BATCH = 64  # scans


class Decisions(NamedTuple):
    """The example made of one scan: c pairings, b hypotheses, m measurements."""

    inputs: NDArray[np.float32]  # (c, inputs)
    measured: IntArray  # (c,) the measurement, numbered separately in each narrow heading
    slots: IntArray  # (c,) the feature, likewise
    hypotheses: IntArray  # (b, m) the pairing of each measurement, or UNPAIRED
    scores: NDArray[np.float32]  # (b,) log densities by the model, without the network
    agreed: BoolArray  # (b, m) the decision of the hypothesis on the measurement is right
    known: BoolArray  # (m,) the right decision is known, and some hypothesis makes it
    weight: float = 1.0  # of the scan in the loss


def decisions_of(scan: Scan, prediction: Prediction, truth: RightAnswers) -> Decisions | None:
    """The example made of a scan, or None where it has no pairing, or no measurement whose right decision is known."""
    parts = examples(scan, prediction, width=WIDTH, margin=MARGIN)
    inputs, measured, rows, scores = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("inputs", "measured", "rows", "log_densities")
    )
    if not len(measured):
        return None
    labelled = truth.sources != UNLABELLED
    right = prediction.features[rows] == truth.right[measured]  # of copies of a feature only the oldest
    width = len(prediction) + 1  # columns of a heading; UNPAIRED is the last one of the heading before
    heading = np.repeat(np.arange(len(parts)), [len(part.rows) for part in parts])  # (c,)
    slots = rows + width * heading
    number = np.full((len(scan), width * len(parts)), UNPAIRED)
    number[measured, slots] = np.arange(len(slots))
    best = np.argsort(-scores, kind="stable")[:_MOST]
    best = best[scores[best] > scores[best[0]] - MARGIN]
    kept = np.concatenate([part.hypotheses + width * k for k, part in enumerate(parts)])[best]
    hypotheses = number[np.arange(len(scan)), kept]
    agreed = np.where(hypotheses == UNPAIRED, truth.right == UNPAIRED, right[hypotheses]) & labelled
    known = agreed.any(axis=0)
    if not known.any():
        return None
    measured = measured + len(scan) * heading
    kept_scores = scores[best].astype(np.float32)
    return Decisions(inputs.astype(np.float32), measured, slots, hypotheses, kept_scores, agreed, known)


def without(hidden: Collection[str], scan: Scan, prediction: Prediction) -> tuple[Scan, Prediction]:
    """Scan and prediction without what is `hidden`: `sizes`, what should be in view (`views`), or how often features
    were seen before (`past`)."""
    if "views" in hidden:
        prediction = prediction.with_visibility(None)
    known = prediction.expected
    if "past" in hidden:
        prediction = replace(prediction, experience=None)
        known = known._replace(sightings=np.zeros(len(prediction), np.int64))
    if "sizes" in hidden:
        unknown, none = np.full(len(scan), math.nan), np.full(len(prediction), math.nan)
        scan = replace(scan, sizes=unknown, size_variances=unknown)
        known = known._replace(sizes=none, size_variances=none)
    return scan, replace(prediction, expected=known)


# -- where scans come from ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Source:
    """A run whose scans become examples: of a level of the suite, of a scenario, or of a log."""

    kind: str  # level, drive or log
    name: str
    world: int
    associator: str = MAKERS[0]  # that makes the map of a drive or a log
    hidden: tuple[str, ...] = ()

    def scans(self, count: int = 12) -> Iterator[Decisions]:
        """The examples of its scans; of a level, up to `count`."""
        rng = np.random.default_rng((world_seed("train", self.world), 7))
        if self.kind == "level":
            yield from self._problems(count)
        elif self.kind == "log":
            yield from self._watched(LoggedRun(_log(self.name), rng), rng)
        else:
            scenario = get_scenario(self.name)
            site = survey(scenario.generator(world_generator("train", self.world)), scenario)
            yield from self._watched(DrivenRun(scenario, site, DRIVERS["nearest_frontier"], rng), rng)

    def _problems(self, count: int) -> Iterator[Decisions]:
        level = get_level(self.name)
        level = replace(level, scenario=overridden(level.scenario, {"sensor.kinds": "kinds told" in self.hidden}))
        for problem in problems(level, self.world, count, "train"):
            decisions = decisions_of(*without(self.hidden, problem.scan, problem.prediction), problem.truth)
            if decisions is not None:
                yield decisions

    def _watched(self, run: AssociationRun, rng: np.random.Generator) -> Iterator[Decisions]:
        """The examples of a drive or a log: all ambiguous scans, and a fraction `_EASY` of the others."""
        associate = resolve_associator(self.associator)
        while not run.over:
            run.next_scan()
            if len(run.scan) and len(run.prediction):
                truth = RightAnswers.of(run.truth, run.identities.majority_of(run.slam.map.ids))
                easy = rng.random() < _EASY
                decisions = decisions_of(*without(self.hidden, run.scan, run.prediction), truth)
                if decisions is not None and _doubtful(decisions):
                    yield decisions
                elif decisions is not None and easy:
                    yield decisions._replace(weight=1.0 / _EASY)
            run.associate(associate(run.scan, run.prediction))


def _log(name: str) -> ScanLog:
    """The first half of a log, thinned: `victoria_park/5` has every fifth scan."""
    published, _, number = name.partition("/")
    whole = open_recordings(published)[0]
    log = whole.part(0, len(whole) // 2).every(int(number))

    def steps(_rng: np.random.Generator) -> Iterator[tuple[Any, Scan, Truth]]:
        for (odometry, scan, sources), pose in zip(log.steps(), reference_poses(log)):
            yield odometry, scan, Truth(pose, sources)

    return ScanLog(log.name, steps, len(log), slam_for(log), log.landmarks)


def _doubtful(d: Decisions) -> bool:
    """Whether the scan is ambiguous for the model, or the best hypothesis of the model is wrong."""
    weights = np.exp(d.scores - d.scores.max())
    best = d.agreed[np.argmax(weights)]
    return bool(weights.max() < (1.0 - _DOUBT) * weights.sum() or not best[d.known].all())


# -- from sources to weights -------------------------------------------------------------------------------------------


def drives_and_logs() -> list[Source]:
    """The sources besides the levels of the suite."""
    hidden = (
        (("sizes",), ("office", "drift-2", "hall", "crowd-drift")),
        (("views", "past"), ("crowd", "drift-3", "aliased-drift", "loop")),
        (("views",), ("office", "crowd", "drift-1", "drift-2", "aliased", "hall-drift", "sparse")),
    )  # what is hidden, the scenarios
    found = [
        Source("drive", name, k, MAKERS[k % len(MAKERS)]) for name, worlds in DRIVES.items() for k in range(worlds)
    ]
    found += [
        Source("drive", name, DRIVES[name] + k, MAKERS[k % len(MAKERS)], what)
        for k, (what, names) in enumerate(hidden)
        for name in names
    ]
    return found + [Source("log", f"victoria_park/{n}", k, maker) for k, maker in enumerate(MAKERS) for n in THINNED]


@dataclass(frozen=True)
class AssociatorPlan:
    """The sources of the examples, and the training of the network."""

    levels: Sequence[str] = LEVELS
    worlds: int = 68  # of each level
    held_out: int = 12  # worlds of each level, after those
    further: Sequence[Source] = field(default_factory=drives_and_logs)
    seeds: Sequence[int] = (0, 1)  # the network with the lowest loss on held-out worlds is kept
    hidden_numbers: int = 24
    epochs: int = 14
    rate: float = 4e-3  # at its highest


QUICK = AssociatorPlan(("clutter/2", "detection/2", "closure/3"), worlds=2, held_out=1, further=(), epochs=30)


def reproduce(quick: bool, command: str, say: Callable[[str], None]) -> Weights:
    """The weights of the seed with the lowest loss on held-out worlds; the figures of the card are those of all seeds.

    Raises ValueError where `SLAM_GYM_DATA` does not name the folder of the recordings, unless `quick`.
    """
    plan = QUICK if quick else AssociatorPlan()
    if plan.further and not os.environ.get("SLAM_GYM_DATA"):
        raise ValueError("SLAM_GYM_DATA is not set: the training looks at Victoria Park as well")
    trained_on, others = sources(plan)
    train, held_out = (examples_of(runs, say) for runs in (trained_on, others))
    fits = []
    for seed in plan.seeds:
        network, curve = trained(plan, train, held_out, seed)
        say(f"seed {seed}: cross-entropy held out, by epoch: {' '.join(f'{loss:.4f}' for loss in curve)}")
        fits.append((curve[-1], mean_loss(network, train), network))
    metrics = {
        "cross-entropy held out": figure([loss for loss, *_ in fits]),
        "cross-entropy trained on": figure([loss for _, loss, _ in fits]),
        "cross-entropy held out, the model alone": figure([mean_loss(tensors(untrained(train, 1)), held_out)]),
        "scans": figure([float(len(train))]),
    }
    with suppress(ValueError):  # the weights that ship may be for other inputs
        shipped = tensors(load_network(WEIGHTS))
        metrics["cross-entropy held out, the weights that ship"] = figure([mean_loss(shipped, held_out)])
    names = dict.fromkeys(f"recording:{own.name}" if own.kind == "log" else own.name for own in trained_on)
    card = Card(VERSION, INPUTS, {}, tuple(names), tuple(plan.seeds), command, metrics)
    best = min(fits, key=lambda one: one[0])[-1]
    return Weights(card, {name: tensor.detach().numpy() for name, tensor in best._asdict().items()})


def sources(plan: AssociatorPlan) -> tuple[list[Source], list[Source]]:
    """The sources to train on, and those held out."""
    last = plan.worlds + plan.held_out
    hidden = [HIDDEN[k // 4 % len(HIDDEN)] if k % 4 == 3 else () for k in range(last)]
    found = [Source("level", name, k, hidden=hidden[k]) for k in range(last) for name in plan.levels]
    trained_on = plan.worlds * len(plan.levels)
    return [*found[:trained_on], *plan.further], found[trained_on:]


def examples_of(runs: Sequence[Source], say: Callable[[str], None]) -> list[Decisions]:
    """All examples of some sources, made by all cores; each kind of source has its share of the weight, and the mean
    weight is 1."""
    calls = [partial(_numbered, k, source) for k, source in enumerate(runs)]
    made = dict(track(run_all(calls, None), "sources", len(calls)))
    kinds: dict[str, list[Decisions]] = {}
    for k, source in enumerate(runs):
        factor = _HIDDEN_COUNT if source.hidden else 1.0
        kinds.setdefault(source.kind, []).extend(d._replace(weight=d.weight * factor) for d in made[k])
    say(", ".join(f"{len(scans)} scans of {kind}s" for kind, scans in kinds.items()))
    count, shared = sum(map(len, kinds.values())), sum(SHARES[kind] for kind in kinds)
    weighted: list[Decisions] = []
    for kind, scans in kinds.items():
        factor = SHARES[kind] / shared * count / max(sum(d.weight for d in scans), 1e-9)
        weighted += [d._replace(weight=d.weight * factor) for d in scans]
    return weighted


def _numbered(number: int, source: Source) -> tuple[int, list[Decisions]]:
    return number, list(source.scans())


# -- the network of `slam_gym.association.tracking.network`, on tensors ------------------------------------------------


def untrained(scans: Sequence[Decisions], hidden: int, seed: int = 0) -> Network:
    """A network whose log odds are 0, as without a network. Inputs are scaled by their mean and deviation."""
    inputs = np.concatenate([d.inputs for d in scans])
    centre, deviation = inputs.mean(axis=0, dtype=np.float64), inputs.std(axis=0, dtype=np.float64)
    n, rng = inputs.shape[1], np.random.default_rng(seed)
    scale = np.where(deviation > 1e-3, deviation, 1.0)

    def layer(width: int) -> list[Array]:
        """Weights (hidden, width) and offsets (hidden,)."""
        return [rng.uniform(-1.0, 1.0, shape) / width**0.5 for shape in ((hidden, width), hidden)]

    layers = *layer(n), *layer(3 * hidden), np.zeros(hidden)
    return Network(centre, scale, np.zeros(n), np.zeros(1), *layers)


def tensors(network: Network) -> Network:
    """The network with tensors instead of arrays."""
    return Network(*(torch.tensor(array, dtype=torch.float32) for array in network))  # type: ignore[arg-type]


def odds_of(network: Network, batch: Batch, most: float = math.inf) -> Tensor:
    """(C,) log odds of each pairing by a network of tensors, limited to ±`most`."""
    net: Any = network
    given = (batch.inputs - net.centre) / net.scale
    x = given.clamp(-FARTHEST, FARTHEST)
    hidden = torch.relu(x @ net.first.T + net.first_offset)
    pooled = torch.cat([hidden, _most(hidden, batch.measured), _most(hidden, batch.slots)], dim=1)
    out = x @ net.linear + net.offset + torch.relu(pooled @ net.second.T + net.second_offset) @ net.last
    return 0.5 ** (x != given).sum(dim=1) * out.clamp(-most, most)


# -- many scans at once ------------------------------------------------------------------------------------------------


class Batch(NamedTuple):
    """B examples: their C pairings one after the other, and for each up to H hypotheses on up to M measurements."""

    inputs: Tensor  # (C, inputs)
    measured: Tensor  # (C,) measurement of each pairing, numbered through all scans
    slots: Tensor  # (C,) feature of each pairing, likewise
    hypotheses: Tensor  # (B, H, M) pairing of each measurement; C where it is unpaired
    scores: Tensor  # (B, H) log densities by the model; −∞ where there is no hypothesis
    agreed: Tensor  # (B, H, M) the decision on the measurement is right
    weights: Tensor  # (B, M) of each measurement in the loss; 0 where the right decision is unknown

    @classmethod
    def of(cls, scans: Sequence[Decisions]) -> Batch:
        sizes = np.array([(len(d.measured), d.measured.max() + 1, d.slots.max() + 1) for d in scans])
        ends = sizes.cumsum(axis=0)
        pairings, measurements, slots = (ends - sizes).T
        return cls(
            torch.from_numpy(np.concatenate([d.inputs for d in scans])),
            torch.from_numpy(np.concatenate([d.measured + first for d, first in zip(scans, measurements)])),
            torch.from_numpy(np.concatenate([d.slots + first for d, first in zip(scans, slots)])),
            _padded([np.where(d.hypotheses == UNPAIRED, ends[-1, 0], d.hypotheses + first)
                     for d, first in zip(scans, pairings)], ends[-1, 0]),
            _padded([d.scores for d in scans], -math.inf),
            _padded([d.agreed for d in scans], False),
            _padded([np.float32(d.weight) * d.known / d.known.sum(dtype=np.float32) for d in scans], 0.0),
        )  # fmt: skip


def _padded(parts: Sequence[NDArray[Any]], value: float) -> Tensor:
    """Arrays of the same number of dimensions as one tensor, padded with `value`."""
    out = np.full((len(parts), *np.max([part.shape for part in parts], axis=0)), value, parts[0].dtype)
    for row, part in zip(out, parts):
        row[tuple(map(slice, part.shape))] = part
    return torch.from_numpy(out)


def _most(values: Tensor, group: Tensor) -> Tensor:
    """(c, h) the maxima of `values` (c, h), which are not negative, over the rows of the same group (c,)."""
    out = torch.zeros(int(group.max()) + 1, values.shape[1])
    index = group[:, None].expand_as(values)
    return out.scatter_reduce(0, index, values, "amax").gather(0, index)


# -- its training ------------------------------------------------------------------------------------------------------


def trained(
    plan: AssociatorPlan, train: Sequence[Decisions], held_out: Sequence[Decisions], seed: int
) -> tuple[Network, list[float]]:
    """A network of tensors that is trained on some examples, and its mean loss on others after each epoch.

    Log odds are limited to ±`_ENOUGH`, so that pairings which are already certain do not increase the weights further.
    Small weights are safer for inputs unlike those of the training.
    """
    network, rng = tensors(untrained(train, plan.hidden_numbers, seed)), np.random.default_rng((seed, 1))
    learned: list[Tensor] = [tensor.requires_grad_() for tensor in network[2:]]  # type: ignore[attr-defined]

    def loss(scans: Sequence[Decisions]) -> Tensor:
        batch = Batch.of(scans)
        return loss_of(odds_of(network, batch, _ENOUGH), batch)

    shuffled = split([train[k] for k in rng.permutation(len(train)).tolist()])
    return network, fit(learned, shuffled, loss, lambda: mean_loss(network, held_out), plan.epochs, plan.rate, rng)


def split(scans: Sequence[Decisions]) -> list[Sequence[Decisions]]:
    """Examples in order, in groups of the size of a batch."""
    return [scans[at : at + _BATCH] for at in range(0, len(scans), _BATCH)]


def probabilities(odds: Tensor, batch: Batch) -> Tensor:
    """(B, M) probability of the right decision on each measurement, for log odds (C,) of the pairings."""
    each = torch.cat([odds, odds.new_zeros(1)])[batch.hypotheses]
    weights = (batch.scores + each.sum(dim=2)).softmax(dim=1)
    return torch.einsum("bh,bhm->bm", weights, batch.agreed.float())


def loss_of(odds: Tensor, batch: Batch) -> Tensor:
    """The weighted mean of −log p of the right decisions, with p at least `_LEAST`."""
    p = probabilities(odds, batch)
    return -(batch.weights * torch.log(p.clamp(_LEAST, 1.0))).sum() / batch.weights.sum()


def mean_loss(network: Network, scans: Sequence[Decisions]) -> float:
    """The loss of a network of tensors over some examples, in batches."""
    total, weighted = 0.0, 0.0
    with torch.no_grad():
        for batch in map(Batch.of, split(scans)):
            weight = float(batch.weights.sum())
            total, weighted = total + weight, weighted + weight * float(loss_of(odds_of(network, batch), batch))
    return weighted / total if total else math.nan
