"""What is evaluated and how it is measured; the one place where that is read from a parameter file."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from epiprior.errors import SettingsError
from epiprior.estimators.handover import HandOver, load_hand_overs
from epiprior.presets import PRESETS, find_preset
from epiprior_lab.evaluation.learned import LEARNED
from epiprior_lab.evaluation.runs import EstimatorInputs, HandOvers
from epiprior_lab.labels.ground_truth import TRUTH
from epiprior_lab.pairsets import Pair, read_pair_set
from epiprior_lab.params import EvaluateParams, MeasureParams, Params, TruthParams

MODELS = Path("models")
PEERS = Path("data/peers")
# What these draw or weigh by, features of a learned matcher lack: scale and orientation, or a ratio of distances.
_NEED_FEATURES = frozenset({"guided-mlesac", "beem", "blogs", "generalized-ransac", "epiprior"})


@dataclass(frozen=True, kw_only=True)
class Protocol:
    """What is evaluated and how it is measured.

    `inputs` lists for each estimator the inputs that it gets; what is not in `inputs.INPUTS` is a peer's, read from
    ``peers/GROUP/PEER/PAIR_ID.npz``. `seeds` are the repetitions of every estimate, and the hand-overs
    ``hand_overs[estimator][input]``.
    """

    inputs: EstimatorInputs
    seeds: tuple[int, ...]
    hand_overs: HandOvers
    truth: TruthParams = TRUTH
    measures: MeasureParams = field(default_factory=lambda: MeasureParams(seed=16, distance_points=1000))
    peers: Path = PEERS

    @property
    def all_inputs(self) -> tuple[str, ...]:
        """All inputs that some estimator gets."""
        return tuple(dict.fromkeys(name for names in self.inputs.values() for name in names))


def make_protocol(params: Params) -> Protocol:
    """Return the protocol of a parameter file.

    Hand-overs were chosen on validation scenes; inputs in `whole` and those of peers are handed over as they are.
    SettingsError if an estimator is to get learned matches that it cannot use.
    """
    evaluate, chosen = params.evaluate, load_hand_overs(MODELS / "hand_over.json")
    inputs = evaluate.inputs_and_peers
    whole = {*(evaluate.whole or ()), *(evaluate.peers or ())}
    for estimator, names in inputs.items():
        unusable = [name for name in names if name in LEARNED]
        if estimator in _NEED_FEATURES and unusable:
            raise SettingsError(f"{estimator} cannot use the matches of {unusable[0]}: see evaluate.peer_estimators")
    hand_overs = {
        estimator: {name: HandOver() if name in whole else chosen[estimator][_chosen(name)] for name in names}
        for estimator, names in inputs.items()
    }
    return Protocol(
        inputs=inputs, seeds=evaluate.seeds, hand_overs=hand_overs, truth=params.truth, measures=params.measures
    )


def as_shipped(protocol: Protocol, name: str) -> tuple[str, ...]:
    """Return the estimators that get an input handed over as the library hands it over."""
    chosen = load_hand_overs(MODELS / "hand_over.json")
    return tuple(e for e, how in protocol.hand_overs.items() if name in how and how[name] == chosen[e][_chosen(name)])


def _chosen(name: str) -> str:
    """Return the input whose hand-over an input gets: a preset that uses another's model uses its hand-over too."""
    return find_preset(name).model if name in PRESETS else name


def pairs_of(evaluate: EvaluateParams, group: str) -> tuple[Pair, ...]:
    """Return the pairs of a group, with their control points."""
    return read_pair_set(evaluate.pairs_of(group), evaluate.control_points_of(group)).pairs


def rendered_pairs(split: str, families: Sequence[str]) -> dict[str, tuple[Pair, ...]]:
    """Return the rendered pairs of a split by family, with their control points."""
    scenes, points = Path("data/scenes") / split, Path("data/ground_truth") / split
    return {name: read_pair_set(scenes / name, points / name / "control_points").pairs for name in families}
