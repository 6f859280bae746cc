"""Matches of AdaLAM and GMS on given features. Runs in an environment of its own, so it imports nothing of epiprior.

FOLDER/pairs.json is a list of [pair id, features of image 1, features of image 2, rankers]; FOLDER/<features>.npz holds
``xy`` (N, 2), ``scale`` and ``orientation_deg`` (N,), ``descriptors`` (N, D), unit RootSIFT, and ``size``, (width,
height).
Written is FOLDER/<pair id>.<ranker>.npz with ``rows`` (M, 2): features of both images, best match first.
"""

import json
import sys
from pathlib import Path

import cv2
import kornia.feature as kf
import numpy as np
import torch


def ratios(first, second):
    """Return the nearest neighbour in the second image of each descriptor, and the ratio of the two best distances."""
    similarity = first["descriptors"] @ second["descriptors"].T
    best, nearest = (found.numpy() for found in torch.from_numpy(similarity).topk(2, dim=1))
    near, next_ = np.sqrt(np.maximum(2 - 2 * best.T.astype(np.float64), 0))
    return nearest[:, 0], near / np.maximum(next_, 1e-9)


def adalam(first, second, _, ratio):
    """AdaLAM as kornia has it, with its own settings; ordered by the ratio.

    Its confidence puts all matches of one seed first; on photographs the ratio ranks them better, to the peer's favour.
    """
    frames = [
        kf.laf_from_center_scale_ori(
            torch.from_numpy(f["xy"]).float()[None],
            torch.from_numpy(f["scale"]).float()[None, :, None, None],
            torch.from_numpy(-f["orientation_deg"]).float()[None, :, None],
        )
        for f in (first, second)
    ]
    descriptors = [torch.from_numpy(f["descriptors"]).float() for f in (first, second)]
    sizes = [tuple(int(side) for side in f["size"][::-1]) for f in (first, second)]
    _, rows = kf.match_adalam(*descriptors, *frames, hw1=sizes[0], hw2=sizes[1])
    rows = rows.numpy()
    return rows[np.argsort(ratio[rows[:, 0]], kind="stable")]


def gms(first, second, nearest, ratio):
    """GMS of OpenCV with rotation and scale, on all nearest neighbours; ordered by the ratio."""
    matches = [cv2.DMatch(i, int(j), float(r)) for i, (j, r) in enumerate(zip(nearest, ratio, strict=True))]
    keypoints = [
        [cv2.KeyPoint(float(x), float(y), 2 * float(s), float(a)) for (x, y), s, a in zip(
            f["xy"], f["scale"], f["orientation_deg"], strict=True)]
        for f in (first, second)
    ]  # fmt: skip
    sizes = [tuple(int(side) for side in f["size"]) for f in (first, second)]
    kept = cv2.xfeatures2d.matchGMS(*sizes, *keypoints, matches, withRotation=True, withScale=True)
    rows = np.array([(m.queryIdx, m.trainIdx) for m in kept], np.int64).reshape(-1, 2)
    return rows[np.argsort(ratio[rows[:, 0]], kind="stable")]


RANKERS = {"adalam": adalam, "gms": gms}


def main(folder: Path) -> None:
    """Match every pair by every ranker that is asked for."""
    torch.set_num_threads(1)
    torch.set_grad_enabled(False)
    cv2.setNumThreads(1)
    for pair_id, name1, name2, rankers in json.loads((folder / "pairs.json").read_text(encoding="utf-8")):
        first, second = (dict(np.load(folder / f"{name}.npz")) for name in (name1, name2))
        enough = min(len(first["xy"]), len(second["xy"])) >= 2
        known = ratios(first, second) if enough else ()
        for ranker in rankers:
            rows = RANKERS[ranker](first, second, *known) if enough else np.empty((0, 2), np.int64)
            np.savez(folder / f"{pair_id}.{ranker}.npz", rows=rows)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
