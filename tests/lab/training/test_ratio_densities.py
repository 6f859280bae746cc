from types import SimpleNamespace

import numpy as np

from epiprior.estimators.ratio_prior import density
from epiprior_lab.training import ratio_densities


def learn(monkeypatch, ratios, labels):
    """Learn from pairs k with these distance ratios and labels."""

    def standard_matches(image1, _, *, max_distance_ratio):
        assert max_distance_ratio == 1.0
        return SimpleNamespace(x1=image1, x2=None, scale1=None, scale2=None, distance_ratio=np.array(ratios[image1]))

    monkeypatch.setattr(ratio_densities, "standard_matches", standard_matches)
    monkeypatch.setattr(ratio_densities, "label_matches", lambda _, x1, *__: np.array(labels[x1]))
    return ratio_densities.learn_densities(SimpleNamespace(image1=k, image2=k) for k in range(len(ratios)))


def test_every_pair_counts_alike_and_one_without_right_matches_tells_only_of_wrong_ones(monkeypatch):
    right, wrong = learn(monkeypatch, [[0.3, 0.9, 0.95, 0.4], [0.8, 0.99]], [[True, False, False, True], [True, False]])
    np.testing.assert_allclose(right, (density(np.array([0.3, 0.4])) + density(np.array([0.8]))) / 2)
    np.testing.assert_allclose(wrong, (density(np.array([0.9, 0.95])) + density(np.array([0.99]))) / 2)
    right, wrong = learn(monkeypatch, [[0.5, 0.9], [0.7, 0.8]], [[True, False], [False, False]])
    np.testing.assert_allclose(right, density(np.array([0.5])))
    np.testing.assert_allclose(wrong, (density(np.array([0.9])) + density(np.array([0.7, 0.8]))) / 2)


def test_only_training_scenes_are_read(monkeypatch, tmp_path, capsys):
    for split in ("train", "test"):
        (tmp_path / "data" / "scenes" / split / "open").mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(ratio_densities, "read_pair_set", lambda folder: SimpleNamespace(pairs=[folder.as_posix()]))
    asked, found = [], (np.ones(3), np.zeros(3))
    monkeypatch.setattr(ratio_densities, "learn_densities", lambda pairs: asked.extend(pairs) or found)
    ratio_densities.main()
    assert asked == ["data/scenes/train/open"]
    assert capsys.readouterr().out.startswith("DENSITY_IN [1.0000")
