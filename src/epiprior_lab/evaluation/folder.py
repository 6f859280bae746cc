"""Pair sets of one's own: X_L as in the paper, `snn` and `default`, each given to the same estimators."""

from collections.abc import Sequence
from pathlib import Path

from epiprior.errors import SettingsError
from epiprior.estimators.handover import FILE, HandOver, load_hand_overs
from epiprior.ranking.models import find_model
from epiprior.settings_file import find_settings_file
from epiprior_lab.evaluation.evaluate import evaluate
from epiprior_lab.evaluation.protocol import Protocol
from epiprior_lab.evaluation.records import Tables
from epiprior_lab.pairsets import read_pair_set

INPUTS = ("standard", "snn", "default")
ESTIMATOR = "magsac++"


def evaluate_folder(
    folder: Path,
    *,
    sets: Sequence[str] | None = None,
    estimators: Sequence[str] = (ESTIMATOR,),
    seeds: int = 3,
    out: Path = Path("data/own-evaluation"),
    store: Path = Path("data/.tasks/own"),
) -> Tables:
    """Evaluate pair sets, and write the tables of `evaluate` to the folder `out`.

    `folder` is a pair set in the uniform format or a folder of them; `sets` are their names, all by default. Results
    per pair are kept in `store`, so that a run that was killed continues. SettingsError if `seeds` is below 1, or there
    is no such set or estimator; DatasetError if a set is damaged: nothing is skipped.
    """
    if seeds < 1:
        raise SettingsError(f"seeds is {seeds}, expected at least 1")
    chosen = load_hand_overs()
    unknown = [name for name in estimators if name not in chosen]
    if unknown:
        raise SettingsError(f"unknown estimator {unknown[0]!r}, known: {', '.join(chosen)}")
    inputs = {name: ("generalized", *INPUTS[1:]) if name == "generalized-ransac" else INPUTS for name in estimators}
    # `snn` is a fixed recipe (ratio below 0.85, all of it): cuts that were chosen on rendered scenes do it harm.
    hand_overs = {e: {n: HandOver() if n == "snn" else chosen[e][n] for n in names} for e, names in inputs.items()}
    protocol = Protocol(inputs=inputs, seeds=tuple(range(seeds)), hand_overs=hand_overs)
    model = sorted(path for path in find_model("default").iterdir() if path.is_file())
    found = find_settings_file(FILE)
    files = (*model, *(() if found is None else (found,)))
    sets_of = {root.name: read_pair_set(root).pairs for root in find_sets(folder, sets)}
    parts = [evaluate(pairs, protocol, group=g, store=store / g, files=files) for g, pairs in sets_of.items()]
    tables = Tables.join(parts)
    tables.write(out)
    return tables


def find_sets(folder: Path, names: Sequence[str] | None = None) -> list[Path]:
    """Return the folders of pair sets in the order of `names`, or all by name; `folder` itself where it is one.

    SettingsError if a named set is not there, or there is none at all; the message names it.
    """
    paths = [folder] if (folder / "pairs.csv").is_file() else [p.parent for p in sorted(folder.glob("*/pairs.csv"))]
    known = {path.resolve().name: path for path in paths}
    if not known:
        raise SettingsError(f"{folder}: no pairs.csv in it, nor in a folder of it")
    missing = [name for name in names or () if name not in known]
    if missing:
        raise SettingsError(f"{folder}: no set {missing[0]!r}; there are {', '.join(known)}")
    return [known[name] for name in names or known]
