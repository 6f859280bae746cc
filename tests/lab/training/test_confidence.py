"""Rows for the confidence: blocks of scenes, what matches of others lack, the default of min_confidence."""

from types import SimpleNamespace

import numpy as np

from epiprior.verification.facts import COLUMNS, UNKNOWN
from epiprior_lab.evaluation.kinds import KindCase
from epiprior_lab.training.confidence import CaseFacts, confidence_rows, least_confidence, plan_blocks


def pair(family, number):
    name = f"{family}-{number}"
    return SimpleNamespace(pair_id=name, scene=name, image1=f"{name}a", image2=f"{name}b")


def test_whatever_a_pair_is_made_of_is_in_one_block():
    pairs = {"f": [pair("f", k) for k in range(3)], "g": [pair("g", k) for k in range(2)]}
    cases = plan_blocks(pairs, {"unrelated": 2, "copy": 1}, seed=1)
    for case in cases:
        sources = [case.pair.scene] if case.pair else [image[:-1] for image in case.images]
        assert {int(source[2:]) for source in sources} == {int(case.block)}
    counts = {block: [case.kind for case in cases if case.block == block] for block in ("000", "001", "002")}
    assert counts["000"] == counts["001"] == ["pair", "pair", "unrelated", "unrelated", "copy"]
    assert counts["002"] == ["pair", "copy"]  # one scene has no stranger


def facts(kind, right, name, value=0.5):
    case = KindCase(name=name, block="0", kind=kind, seed=0)
    rows = np.full((len(right), len(COLUMNS)), value, np.float32)
    return CaseFacts(case=case, rows=rows, right=np.array(right, bool))


def test_every_row_comes_again_without_what_others_may_lack_and_few_unrelated_pairs_reach_the_default():
    rows = confidence_rows([facts("pair", [True, False], "a"), facts("plane", [False], "b")], seed=2)
    found = rows["confidence"]
    assert found.labels.tolist() == [True, False] * 2 + [False] * 2
    lacking = np.array(found.columns)[(found.rows == UNKNOWN).any(axis=0)]
    assert set(lacking) <= {"turn", "scale", "plausibility", "turn_like"}
    assert (found.rows[[0, 1, 4]] == 0.5).all()
    assert (found.rows[[2, 3, 5]] == UNKNOWN).any(axis=1).all()
    assert rows["homography"].labels.tolist() == [False] * 4 + [True] * 2
    known = [facts("unrelated", [False] * 100, "s"), facts("pair", [True] * 100, "t")]
    data = SimpleNamespace(pairs=np.array(["s", "t"]), lengths=np.array([100, 100]))
    values = np.concatenate([np.linspace(0, 0.99, 100), np.full(100, 0.99)])
    cross = {"lightgbm": SimpleNamespace(calibrated=values)}
    comparison = SimpleNamespace(grouped=cross, exported="lightgbm", data=data)
    assert np.mean(values[:100] > least_confidence(comparison, known, accepted=0.05, floor=0.2)) == 0.05
    assert least_confidence(comparison, known, accepted=0.99, floor=0.2) == 0.2
