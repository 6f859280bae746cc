"""What was found for the pairs of a collection, on disk: one file, one writer; after a kill all that was ready."""

import contextlib
import sqlite3
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from epiprior.errors import OutputError
from epiprior.types import FloatArray, IntArray

_MATRICES = ("F", "H", "E")
_PLAIN = ["image1", "image2", "status", "message", "geometry", "confidence", "guided", "input", "seconds"]
_COLUMNS = ", ".join(("key", *_MATRICES, "matches", *_PLAIN))


@dataclass(frozen=True, kw_only=True)
class MatchedPair:
    """Two images of a collection and what was found for them.

    Parameters
    ----------
    image1, image2 : Their names.
    status, message : Of the estimate, see `epiprior.FundamentalEstimate`.
    geometry : COLMAP's name of the configuration, such as ``UNCALIBRATED`` or ``PLANAR``; empty if there is none.
    confidence : That F is right, in [0, 1]; 1 where a homography relates the images.
    F, H : (3, 3) float64, pixels, the centre of the top-left pixel at (0, 0); None where not found.
    E : (3, 3) float64, the essential matrix that F belongs to where both focal lengths are known; None without.
    matches : (M, 2) int64. Inliers, one-to-one: rows of the keypoints of both images; empty without a geometry.
    guided : So many of them, the last, were gathered along the epipolar lines of F.
    input : What the estimate comes from: ``snn``, ``standard`` or the preset.
    seconds : Wall time.
    """

    image1: str
    image2: str
    status: str
    message: str = ""
    geometry: str = ""
    confidence: float = 0.0
    F: FloatArray | None = None
    H: FloatArray | None = None
    E: FloatArray | None = None
    matches: IntArray
    guided: int = 0
    input: str = ""
    seconds: float = 0.0


class PairStore:
    """A file of matched pairs by key; OutputError names it if it cannot be used."""

    def __init__(self, path: Path) -> None:
        self.path = path
        with self._told():
            # One thread at a time uses it, but a collection that is collected as garbage is closed by any.
            self._opened = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
            self._opened.execute("PRAGMA synchronous = OFF")  # a kill leaves whole rows; only a power cut may not
            kept = ", ".join(row[1] for row in self._opened.execute("PRAGMA table_info(pairs)"))
            if kept and kept != _COLUMNS:  # of another version, whose keys are others too
                self._opened.execute("DROP TABLE pairs")
            self._opened.execute(f"CREATE TABLE IF NOT EXISTS pairs ({_COLUMNS}, PRIMARY KEY (key)) WITHOUT ROWID")

    def __contains__(self, key: bytes) -> bool:
        with self._told():
            return self._opened.execute("SELECT 1 FROM pairs WHERE key = ?", (key,)).fetchone() is not None

    def write(self, key: bytes, pair: MatchedPair) -> None:
        """Keep a pair."""
        matrices = [getattr(pair, name) for name in _MATRICES]
        arrays = [None if M is None else np.asarray(M, np.float64).tobytes() for M in matrices]
        row = (key, *arrays, pair.matches.astype(np.uint32).tobytes(), *(getattr(pair, name) for name in _PLAIN))
        with self._told():
            self._opened.execute(f"INSERT OR REPLACE INTO pairs VALUES ({', '.join('?' * len(row))})", row)

    def read(self, key: bytes) -> MatchedPair:
        """Return the pair that was kept under a key."""
        with self._told():
            row = self._opened.execute("SELECT * FROM pairs WHERE key = ?", (key,)).fetchone()
        arrays, known = row[1:4], dict(zip(_PLAIN, row[5:], strict=True))
        known |= {name: M and np.frombuffer(M).reshape(3, 3) for name, M in zip(_MATRICES, arrays, strict=True)}
        return MatchedPair(**known, matches=np.frombuffer(row[4], np.uint32).reshape(-1, 2).astype(np.int64))

    def close(self) -> None:
        """Close the file."""
        self._opened.close()

    @contextlib.contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.Error as error:
            raise OutputError(f"{self.path}: {error}") from error
