"""Matches of others, made in an environment of their own: rankers on our RootSIFT features, and learned matchers.

The two are tasks apart: what learned matchers found is kept when the library changes.
"""

import json
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from epiprior.errors import EpipriorError, SettingsError
from epiprior.features.describe import normalise_descriptors
from epiprior.features.detect import detect_features
from epiprior.features.images import load_photograph
from epiprior.features.locations import unique_locations
from epiprior.presets import FeatureSettings
from epiprior.types import Features, FloatArray, IntArray
from epiprior_lab.compute.tasks import Task, map_tasks
from epiprior_lab.evaluation import learned
from epiprior_lab.evaluation.learned import LEARNED, match_learned
from epiprior_lab.pairsets import Pair

ENVIRONMENT = Path(".venv/peers")
SCRIPT = Path("benchmarks/real/peers/match.py")
REQUIREMENTS = Path("benchmarks/real/peers/requirements.txt")
WEIGHTS = Path("benchmarks/real/peers/weights.txt")
_PAIRS_PER_TASK = 12  # the start of torch takes as long as a few pairs
_LEARNED_PAIRS_PER_TASK = 24  # features of an image are found once per task

Columns = dict[str, FloatArray | IntArray]


class PeerError(EpipriorError):
    """The rankers of others failed; the message ends with what they said."""


def match_by_peers(*, pairs: Sequence[Pair], peers: Sequence[str], python: Path, script: Path) -> list[list[Columns]]:
    """Match some pairs by every peer, in the interpreter `python` of their environment; PeerError if `script` fails.

    Return, for each pair and peer, the arrays of `inputs.read_peer_matches`.
    """
    settings = FeatureSettings(root=True, centred=False)
    features: dict[Path, Features] = {}
    for path in dict.fromkeys(path for pair in pairs for path in (pair.image1, pair.image2)):
        features[path] = detect_features(load_photograph(path, settings.max_image_size), settings)
    names = {path: f"features-{k}" for k, path in enumerate(features)}
    asked = [(pair.pair_id, names[pair.image1], names[pair.image2], list(peers)) for pair in pairs]
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for path, found in features.items():
            np.savez(
                folder / f"{names[path]}.npz",
                xy=found.xy,
                scale=found.scale,
                orientation_deg=found.orientation_deg,
                descriptors=normalise_descriptors(found.descriptors, root=True, centred=False),
                size=np.array(found.image_size),
            )
        (folder / "pairs.json").write_text(json.dumps(asked), encoding="utf-8")
        done = subprocess.run([str(python), str(script), str(folder)], capture_output=True, text=True, check=False)
        if done.returncode:
            raise PeerError(f"{script} failed: {done.stderr.strip()[-500:]}")
        found_of = [(pair.pair_id, features[pair.image1], features[pair.image2]) for pair in pairs]
        return [[_columns(folder / f"{name}.{peer}.npz", *both) for peer in peers] for name, *both in found_of]


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


def interpreter() -> Path:
    """Return the interpreter of the peers' environment; SettingsError if there is none."""
    python = ENVIRONMENT / "bin" / "python"
    if not python.is_file():
        raise SettingsError(f"no environment {ENVIRONMENT}: run `make peers`, or set `peers: null` to do without them")
    return python


def write_peer_matches(pairs: Sequence[Pair], peers: Sequence[str], out: Path, store: Path) -> None:
    """Write the matches of every peer and pair as ``out/PEER/PAIR_ID.npz``; a killed run continues.

    Without peers the folder stays empty. Scripts run in `ENVIRONMENT`, where the peers are installed (SettingsError if
    it is absent). Those of `LEARNED` find own features, others get ours.
    """
    out.mkdir(parents=True, exist_ok=True)
    if not peers:
        return
    python, files = interpreter(), (REQUIREMENTS, WEIGHTS)
    how: dict[str, Any] = {"store": store, "description": f"peers of {out.name}"}
    rankers = tuple(name for name in peers if name not in LEARNED)
    if rankers:
        tasks = []
        for name, part in _parts(pairs, _PAIRS_PER_TASK):
            payload = {"pairs": part, "peers": rankers, "python": python, "script": SCRIPT}
            own = (file for pair in part for file in pair.files)
            tasks.append(Task(name=name, payload=payload, files=(*own, SCRIPT, *files)))
        ranked = [found for part in map_tasks(match_by_peers, tasks, **how) for found in part]
        for k, peer in enumerate(rankers):
            _write(out / peer, pairs, [found[k] for found in ranked])
    for peer in (name for name in peers if name in LEARNED):
        tasks = []
        for name, part in _parts(pairs, _LEARNED_PAIRS_PER_TASK):
            images = tuple((pair.image1, pair.image2) for pair in part)
            payload = {"images": images, "peer": peer, "python": python, "script": learned.SCRIPT}
            own = (file for both in images for file in both)
            tasks.append(Task(name=f"{peer}: {name}", payload=payload, files=(*own, learned.SCRIPT, *files)))
        matched = map_tasks(match_learned, tasks, versions=False, **how)
        _write(out / peer, pairs, [found for part in matched for found in part])


def _parts(pairs: Sequence[Pair], size: int) -> Iterator[tuple[str, tuple[Pair, ...]]]:
    """Yield parts of so many pairs, each with a name for its task."""
    for k in range(0, len(pairs), size):
        part = tuple(pairs[k : k + size])
        yield f"{part[0].pair_id} and {len(part) - 1} more", part


def _write(folder: Path, pairs: Sequence[Pair], found: Sequence[Columns]) -> None:
    folder.mkdir(exist_ok=True)
    for pair, columns in zip(pairs, found, strict=True):
        np.savez(folder / f"{pair.pair_id}.npz", allow_pickle=False, **columns)
