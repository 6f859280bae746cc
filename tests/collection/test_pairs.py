import numpy as np
import pytest

from epiprior import SettingsError
from epiprior.collection.pairs import choose_pairs, default_pairs

NAMES = ["a 1.jpg", "b.jpg", "c.jpg", "d.jpg"]


def test_all_neighbours_a_list_of_names_and_what_is_neither(tmp_path):
    assert choose_pairs("exhaustive", NAMES) == [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    assert choose_pairs("sequential:1", NAMES) == [(0, 1), (1, 2), (2, 3)]
    assert choose_pairs("sequential:2", NAMES) == [(0, 1), (0, 2), (1, 2), (1, 3), (2, 3)]
    assert (default_pairs(200), default_pairs(201)) == ("exhaustive", "similar:20")
    path = tmp_path / "pairs.txt"
    path.write_text("# of hloc\nd.jpg a 1.jpg\na 1.jpg  b.jpg\n\nb.jpg\ta 1.jpg\nc.jpg d.jpg \n")
    assert choose_pairs(str(path), NAMES) == [(0, 1), (0, 3), (2, 3)]
    for how in ("sequential", "sequential:0", "similar:x", "no/such/file"):
        with pytest.raises(SettingsError, match=f"pairs = '{how}': expected"):
            choose_pairs(how, NAMES)
    for text, words in (
        ("b.jpg c.jpg\nb.jpg x.jpg\n", r"pairs\.txt: line 2: 'b.jpg x.jpg' is not two names"),
        ("b.jpg\n", "line 1: 'b.jpg' is not two names"),
        ("b.jpg b.jpg\n", "line 1: 'b.jpg' is paired with itself"),
        ("# nothing\n", "holds no pair"),
    ):
        path.write_text(text)
        with pytest.raises(SettingsError, match=words):
            choose_pairs(str(path), NAMES)


def test_images_that_share_words_are_paired():
    """Four places, three images of each, whose descriptors are noisy copies."""
    rng = np.random.default_rng(0)

    def unit(d):
        return (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)

    places = [rng.normal(size=(200, 128)) for _ in range(4)]
    images = [unit(places[k % 4] + 0.3 * rng.normal(size=(200, 128))) for k in range(12)]
    assert choose_pairs("similar:2", ["x"] * 12) is None
    expected = [(a, b) for a in range(12) for b in range(a + 1, 12) if a % 4 == b % 4]
    found = choose_pairs("similar:2", ["x"] * 12, lambda index: images[index])
    assert found == expected
    assert choose_pairs("similar:2", ["x"] * 12, lambda index: images[index]) == found
    with pytest.raises(SettingsError, match="no features"):
        choose_pairs("similar:2", NAMES, lambda index: np.empty((0, 128), np.float32))
