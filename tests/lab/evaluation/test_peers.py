"""Rankers of others, run in an environment of their own."""

import sys

import numpy as np
import pytest

from epiprior.errors import SettingsError
from epiprior.features.detect import detect_features
from epiprior.features.images import load_photograph
from epiprior_lab.evaluation.inputs import read_peer_matches
from epiprior_lab.evaluation.peers import write_peer_matches

# Stands in for torch and another OpenCV: matches every feature of image 1 with the one of the same number.
SCRIPT = """
import json, sys
from pathlib import Path
import numpy as np
folder = Path(sys.argv[1])
for pair_id, first, second, rankers in json.loads((folder / "pairs.json").read_text()):
    n = min(len(np.load(folder / f"{name}.npz")["xy"]) for name in (first, second))
    for k, ranker in enumerate(rankers):
        if ranker == "broken":
            sys.exit("it is broken")
        rows = np.column_stack([np.arange(n), np.arange(n)])[::-1][k:]
        np.savez(folder / f"{pair_id}.{ranker}.npz", rows=rows)
"""


def test_peers_run_in_an_environment_of_their_own(pairs, tmp_path):
    script, environment = tmp_path / "match.py", tmp_path / "peers"
    script.write_text(SCRIPT)
    settings = {"environment": environment, "script": script, "files": ()}
    write_peer_matches(pairs[:1], (), tmp_path / "none", **settings)
    assert list((tmp_path / "none").iterdir()) == []
    with pytest.raises(SettingsError, match="make peers"):
        write_peer_matches(pairs[:1], ("a",), tmp_path / "out", **settings)
    (environment / "bin").mkdir(parents=True)
    (environment / "bin" / "python").symlink_to(sys.executable)
    write_peer_matches(pairs[:1], ("a", "b"), tmp_path / "out", **settings)
    features = detect_features(load_photograph(pairs[0].image1))
    first, second = (read_peer_matches(tmp_path / "out" / name / "relief-0.npz") for name in ("a", "b"))
    assert len(first) > 300
    assert len(second) == len(first) - 1
    np.testing.assert_array_equal(first.x1[::-1], features.xy[: len(first)])
    assert first.feature1.max() <= len(np.unique(features.xy, axis=0))
    with pytest.raises(Exception, match="it is broken"):
        write_peer_matches(pairs[:1], ("broken",), tmp_path / "out", **settings)
