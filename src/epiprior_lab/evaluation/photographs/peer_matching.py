"""Let rankers of others match the pairs, on our RootSIFT features, in an environment of their own."""

from __future__ import annotations

import json
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from epiprior.errors import EpipriorError, SettingsError
from epiprior.features.describe import normalise_descriptors
from epiprior.features.detect import detect_features
from epiprior.features.images import load_photograph
from epiprior.features.locations import unique_locations
from epiprior.presets import FeatureSettings
from epiprior.types import Features, FloatArray, IntArray
from epiprior_lab.compute.tasks import Task, map_tasks
from epiprior_lab.pairsets import Pair

ENVIRONMENT = Path(".venv/peers")
SCRIPT = Path("benchmarks/real/peers/match.py")
REQUIREMENTS = Path("benchmarks/real/peers/requirements.txt")
_PAIRS_PER_TASK = 12  # the start of torch takes as long as a few pairs

Columns = dict[str, FloatArray | IntArray]


class PeerError(EpipriorError):
    """The rankers of others failed; the message ends with what they said."""


def match_by_peers(*, pairs: Sequence[Pair], rankers: Sequence[str], python: Path, script: Path) -> list[list[Columns]]:
    """Match some pairs by every ranker.

    Parameters
    ----------
    pairs : sequence of Pair
        Their images are read.
    rankers : sequence of str
        Names that the script knows.
    python, script : Path
        Interpreter of the environment, and what it runs.

    Returns
    -------
    list of list of dict
        Per pair and ranker, the arrays of `epiprior_lab.evaluation.photographs.peers.read_peer_matches`.

    Raises
    ------
    PeerError
        If the script fails.
    """
    settings = FeatureSettings(root=True, centred=False)
    features: dict[Path, Features] = {}
    for path in dict.fromkeys(path for pair in pairs for path in (pair.image1, pair.image2)):
        features[path] = detect_features(load_photograph(path, settings.max_image_size), settings)
    names = {path: f"features-{k}" for k, path in enumerate(features)}
    asked = [(pair.pair_id, names[pair.image1], names[pair.image2], list(rankers)) for pair in pairs]
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for path, found in features.items():
            _write(folder / f"{names[path]}.npz", found)
        (folder / "pairs.json").write_text(json.dumps(asked), encoding="utf-8")
        done = subprocess.run([str(python), str(script), str(folder)], capture_output=True, text=True, check=False)
        if done.returncode:
            raise PeerError(f"{script} failed: {done.stderr.strip()[-500:]}")
        return [
            [
                _columns(folder / f"{pair.pair_id}.{ranker}.npz", features[pair.image1], features[pair.image2])
                for ranker in rankers
            ]
            for pair in pairs
        ]


def _write(path: Path, features: Features) -> None:
    descriptors = normalise_descriptors(features.descriptors, root=True, centred=False)
    np.savez(
        path,
        xy=features.xy,
        scale=features.scale,
        orientation_deg=features.orientation_deg,
        descriptors=descriptors,
        size=np.array(features.image_size),
    )


def _columns(path: Path, features1: Features, features2: Features) -> Columns:
    with np.load(path, allow_pickle=False) as archive:
        rows1, rows2 = np.asarray(archive["rows"], np.int64).T
    columns: Columns = {}
    for number, features, rows in ((1, features1, rows1), (2, features2, rows2)):
        columns[f"x{number}"] = features.xy[rows]
        columns[f"scale{number}"] = features.scale[rows]
        columns[f"orientation{number}_deg"] = features.orientation_deg[rows]
        columns[f"feature{number}"] = unique_locations(features)[1][rows]
    return columns


def write_peer_matches(
    pairs: Sequence[Pair],
    rankers: Sequence[str],
    out: Path,
    *,
    environment: Path = ENVIRONMENT,
    script: Path = SCRIPT,
    files: Sequence[Path] = (REQUIREMENTS,),
    workers: int = 1,
    store: Path | None = None,
) -> None:
    """Write the matches of every ranker and pair as ``out/RANKER/PAIR_ID.npz``; a killed run continues.

    Parameters
    ----------
    pairs : sequence of Pair
        Of one set.
    rankers : sequence of str
        None writes an empty folder.
    out : Path
        Folder, made if absent.
    environment, script : Path
        Where the rankers live, and what runs there.
    files : sequence of Path
        What else decides the matches.
    workers, store
        As for `epiprior_lab.compute.tasks.map_tasks`.

    Raises
    ------
    SettingsError
        If there is no such environment.
    """
    out.mkdir(parents=True, exist_ok=True)
    if not rankers:
        return
    python = environment / "bin" / "python"
    if not python.is_file():
        raise SettingsError(f"no environment {environment}: run `make peers`, or set `peers: null` to do without them")
    parts = [tuple(pairs[k : k + _PAIRS_PER_TASK]) for k in range(0, len(pairs), _PAIRS_PER_TASK)]
    tasks = [
        Task(
            name=f"{part[0].pair_id} and {len(part) - 1} more",
            payload={"pairs": part, "rankers": tuple(rankers), "python": python, "script": script},
            files=(*(file for pair in part for file in pair.files), script, *files),
        )
        for part in parts
    ]
    matched = map_tasks(match_by_peers, tasks, workers=workers, description=f"peers of {out.name}", store=store)
    for part, found in zip(parts, matched, strict=True):
        for pair, of_pair in zip(part, found, strict=True):
            _save(out, pair.pair_id, dict(zip(rankers, of_pair, strict=True)))


def _save(out: Path, pair_id: str, matches: Mapping[str, Columns]) -> None:
    for ranker, columns in matches.items():
        (out / ranker).mkdir(exist_ok=True)
        np.savez(out / ranker / f"{pair_id}.npz", allow_pickle=False, **columns)
