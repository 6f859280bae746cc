"""How often the verdict turns down right matrices, and how often it sees that nothing decides F, by its levels.

    python benchmarks/verdict.py prepare FOLDER   # pairs and their matches, in about half an hour
    python benchmarks/verdict.py table FOLDER     # estimates, and the table of both rates over the levels

Pairs that decide F are rendered, with seeds that the study does not use. Pairs that do not are photographs that
scikit-image and scikit-learn package, seen as a plane from two places or by a camera that only turns: warped by
the homographies of true cameras, then blurred, exposed and made noisy like the rendered ones. Both go through detection
and matching like any other pair.
"""

import argparse
import pickle
from collections.abc import Iterator
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from epiprior.estimators.handover import HandOver, hand_over, load_hand_overs
from epiprior.estimators.run import estimate_from_matches
from epiprior.types import FloatArray, Status
from epiprior.verification.chance import chance_rate
from epiprior.verification.degeneracy import LEVELS, DecidedLevels, PlaneEvidence, plane_evidence
from epiprior.verification.judge import judge
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.evaluation.inputs import PairMatches, match_pair
from epiprior_lab.labels.ground_truth import control_points_from_depth, errors_px
from epiprior_lab.pairsets import Pair
from epiprior_lab.scenes import render_pair
from epiprior_lab.scenes.photography import draw_photograph, take
from epiprior_lab.scenes.textures import photograph

SEED = 90210
FAMILIES = ("facades-easy", "facades-hard", "open", "rolled")
PER_FAMILY = 24
SURFACES = ("astronaut", "brick", "camera", "chelsea", "china", "coffee", "flower", "gravel", "motorcycle", "rocket")
PER_SURFACE = 3
INPUTS = ("standard", "snn", "default")
SIZE = (800, 600)
ESTIMATORS = ("usac", "magsac++", "degensac", "epiprior")
UNDECIDED = ("plane", "rotation")
REPETITIVE = ("china", "rocket")  # roofs and lattices: wrong matches along them agree with one epipole
PLANE_FACTOR = 8.0 / 3.0  # as `why_degenerate` by default
SUCCESS_PX = 10.0


@dataclass(frozen=True, kw_only=True)
class Case:
    """One pair with its matches; control points only where something decides F."""

    kind: str
    name: str
    matches: PairMatches
    points: tuple[FloatArray, FloatArray] | None


def planned() -> Iterator[tuple[str, str]]:
    """Yield kind and name of every pair, kinds by turns so that an unfinished run is a fair sample."""
    surfaces = [f"{surface}-{k}" for k in range(PER_SURFACE) for surface in SURFACES]
    for k in range(max(PER_FAMILY, len(surfaces))):
        if k < len(surfaces):
            yield from ((kind, f"{kind}-{surfaces[k]}") for kind in ("plane", "rotation"))
        if k < PER_FAMILY:
            yield from ((family, f"{family}-{k:02d}") for family in FAMILIES)


def undecided_views(kind: str, name: str) -> list[np.ndarray[Any, Any]]:
    """Return two views, (H, W, 3) uint8, of a photographed surface that fills both."""
    rng = np.random.default_rng(child_seed(SEED, name))
    texture = photograph(name.split("-")[1])
    width, height = SIZE
    K = np.array([[rng.uniform(0.8, 1.4) * width, 0, width / 2], [0, 0, height / 2], [0, 0, 1.0]])
    K[1, 1] = K[0, 0]
    side = rng.uniform(1.0, 1.5) * max(SIZE) / K[0, 0] / min(texture.shape[:2])
    # From texture pixels to the plane z = 1 before the first camera; beyond its rim the texture is mirrored. It is so
    # large that nothing is seen twice the same way round.
    to_plane = np.array([[side, 0, -side * texture.shape[1] / 2], [0, side, -side * texture.shape[0] / 2], [0, 0, 1.0]])
    slant = Rotation.from_euler("xy", rng.uniform(-25, 25, 2), degrees=True).as_matrix()
    views = []
    for turned in (False, True):
        R, centre = np.eye(3), np.zeros(3)
        if turned:
            angle = rng.uniform(8, 30)
            R = Rotation.from_euler("yxz", [angle, rng.uniform(-6, 6), rng.uniform(-10, 10)], degrees=True).as_matrix()
            # A camera that moves looks at the same spot again; one that turns sees what lies beside it.
            away = R.T @ np.array([0, 0, -1.0]) * rng.uniform(0.75, 1.25) + np.array([0, 0, 1.0])
            centre = away if kind == "plane" else np.zeros(3)
        # Points of the plane are (0, 0, 1) + slant (u, v, 0).
        plane = np.column_stack([slant[:, 0], slant[:, 1], np.array([0, 0, 1.0]) - centre])
        seen = cv2.warpPerspective(
            texture, K @ R @ plane @ to_plane, SIZE, flags=cv2.INTER_AREA, borderMode=cv2.BORDER_REFLECT
        )
        views.append(take(np.asarray(seen, np.uint8), draw_photograph(rng), rng))
    return views


def prepare(folder: Path) -> None:
    """Make and match all pairs; those that are there already are left."""
    for kind, name in planned():
        path = folder / f"{name}.case"
        if path.exists():
            continue
        points = None
        if kind in FAMILIES:
            rendered = render_pair(kind, child_seed(SEED, name))
            views = [rendered.image1, rendered.image2]
            cameras, depths = (rendered.camera1, rendered.camera2), (rendered.depth1, rendered.depth2)
            points = control_points_from_depth(cameras, depths, count=100, seed=child_seed(SEED, "points", name))
        else:
            views = undecided_views(kind, name)
        files = [folder / "images" / f"{name}_{k}.jpg" for k in (1, 2)]
        for file, view in zip(files, views, strict=True):
            file.parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(view).save(file, quality=92)
        pair = Pair(
            pair_id=name, scene=name, image1=files[0], image2=files[1], camera1=None, camera2=None, difficulty=""
        )
        case = Case(kind=kind, name=name, matches=match_pair(pair, INPUTS), points=points)
        path.write_bytes(pickle.dumps(case))
        print(name, {key: len(sets[0]) for key, sets in case.matches.sets.items()}, flush=True)


@dataclass(frozen=True, kw_only=True)
class Run:
    """One estimate, and for the matches handed over and those collected what speaks for it."""

    kind: str
    surface: str
    input: str
    right: bool
    evidence: tuple[PlaneEvidence | None, ...]

    def passes(self, levels: DecidedLevels) -> bool:
        """Return whether the verdict is ``ok``."""
        return any(found is None or found.decides(levels) for found in self.evidence)


def run_case(case: Case, estimator: str, name: str, how: HandOver) -> Run | None:
    """Return what one estimator makes of one input, or None without F."""
    sets = case.matches.sets[name]
    estimate = estimate_from_matches(sets, estimator=estimator, seed=child_seed(0, case.name), hand_over=how)
    if (F := estimate.raw_F) is None:
        return None
    handed = hand_over(next(matches for matches in sets if matches.roll_deg == estimate.roll_deg), how)
    used = [(handed.x1, handed.x2), *([(estimate.x1, estimate.x2)] if how.collect else [])]
    evidence = []
    for x1, x2 in used:
        # With nothing to ask of the plane only the other reasons remain.
        if judge(F, x1, x2, how.threshold_px, DecidedLevels(parallax=1.1))[0] is Status.OK:
            rate = chance_rate(F, x1, x2, how.threshold_px)
            plane_px = how.threshold_px * PLANE_FACTOR
            evidence.append(plane_evidence(F, x1, x2, threshold_px=how.threshold_px, plane_px=plane_px, rate=rate))
    right = case.points is not None and float(errors_px(F, *case.points).mean()) < SUCCESS_PX
    return Run(kind=case.kind, surface=case.name.split("-")[1], input=name, right=right, evidence=tuple(evidence))


def share(runs: list[Run], levels: DecidedLevels) -> str:
    """Return how many of the runs are turned down, as a percentage."""
    return f"{100 * np.mean([not run.passes(levels) for run in runs]):5.1f}" if runs else "    -"


def table(folder: Path) -> None:
    """Print false alarms and detected planes and rotations over the levels."""
    hand_overs = load_hand_overs()
    cases = [pickle.loads(path.read_bytes()) for path in sorted(folder.glob("*.case"))]
    tried = [
        run_case(case, estimator, name, hand_overs[estimator][name])
        for case in cases
        for estimator in ESTIMATORS
        for name in INPUTS
    ]
    runs = [run for run in tried if run is not None]
    right = [run for run in runs if run.right]
    undecided = [run for run in runs if run.kind in UNDECIDED]
    wrong = [run for run in runs if not run.right and run.kind not in UNDECIDED]
    plain = [run for run in undecided if run.surface not in REPETITIVE]
    print(f"{len(right)} runs with a right F, {len(wrong)} with a wrong one, {len(undecided)} that nothing decides")
    head = [*(f"right, {name}" for name in INPUTS), "right", "wrong", *UNDECIDED, "of plain ones"]
    print(f"{'expected':>9s}{'share':>7s}{'above':>9s}{'parallax':>9s}" + "".join(f"{name:>17s}" for name in head))
    for parallax in (1e-4, 1e-5, 1e-8):
        for above_share, above in ((1.0, 1.0), (0.25, 100.0), (0.25, 1000.0), (0.2, 1000.0), (0.25, inf)):
            for expected in (10.0, 1.0, 0.1, 0.02):
                levels = DecidedLevels(
                    expected=expected, off_plane_share=above_share, expected_above_share=above, parallax=parallax
                )
                parts = [[run for run in right if run.input == name] for name in INPUTS]
                parts += [right, wrong, *([run for run in undecided if run.kind == kind] for kind in UNDECIDED), plain]
                cells = "".join(f"{share(part, levels):>17s}" for part in parts)
                print(f"{expected:9g}{above_share:7g}{above:9g}{parallax:9g}{cells}", flush=True)
    for surface in sorted({run.surface for run in undecided}):
        print(f"{surface:12s}{share([run for run in undecided if run.surface == surface], LEVELS)} % detected")


def main() -> None:
    """Parse arguments and run one step."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("step", choices=("prepare", "table"))
    parser.add_argument("folder", type=Path)
    options = parser.parse_args()
    {"prepare": prepare, "table": table}[options.step](options.folder)


if __name__ == "__main__":
    main()
