"""Learned matchers on photographs, in an environment of their own.

This module imports nothing of epiprior: what is stored of it holds until its script, its packages or a photograph
changes, whatever becomes of the library.
"""

import json
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

LEARNED = ("aliked", "disk", "xfeat")
SCRIPT = Path("benchmarks/real/peers/learned.py")

Columns = dict[str, NDArray[Any]]
Images = Sequence[tuple[Path, Path]]


class LearnedError(RuntimeError):
    """A learned matcher failed; the message ends with what it said."""


def match_learned(*, images: Images, peer: str, python: Path, script: Path) -> list[Columns]:
    """Match pairs of images by a peer of `LEARNED`, with one thread; an image's features are found once per call.

    `script` runs in the interpreter `python`. Return for each pair ``x1, x2`` (M, 2), pixels of the images as given,
    best match first; ``feature1, feature2`` (M,), indices of the peer's own keypoints; ``features`` (2,), how many
    there were.
    """
    return _run(images, peer, python, script, threads=1, timed=False)[0]


def time_learned(
    *, images: Images, peer: str, python: Path, script: Path, threads: int
) -> tuple[list[Columns], list[tuple[float, float]]]:
    """Match as `match_learned` does, but find features for each pair anew.

    Return also, for each pair, the seconds from both files to features, and from features to matches; what is slow the
    first time is not counted.
    """
    return _run(images, peer, python, script, threads=threads, timed=True)


def _run(
    images: Images, peer: str, python: Path, script: Path, *, threads: int, timed: bool
) -> tuple[list[Columns], list[tuple[float, float]]]:
    request: dict[str, Any] = {"peer": peer, "pairs": [[str(path) for path in pair] for pair in images]}
    request |= {"threads": threads, "timed": timed}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        (folder / "request.json").write_text(json.dumps(request), encoding="utf-8")
        done = subprocess.run([str(python), str(script), str(folder)], capture_output=True, text=True, check=False)
        if done.returncode:
            raise LearnedError(f"{script} failed for {peer}: {done.stderr.strip()[-500:]}")
        found = []
        for number in range(len(images)):
            with np.load(folder / f"{number}.npz", allow_pickle=False) as archive:
                found.append({name: archive[name] for name in sorted(archive.files)})
        seconds = json.loads((folder / "seconds.json").read_text(encoding="utf-8")) if timed else []
    return found, [(float(features), float(matching)) for features, matching in seconds]
