"""Names and numbers as a reader sees them: one mapping of titles and colours for all tables, figures and pages."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from epiprior_lab.evaluation.learned import LEARNED

ALL = "all"
OURS = "default"
BASELINES = ("standard", "generalized")  # what an estimator gets without the preprocessing step
DIFFICULTIES = ("easy", "medium", "hard")

RANKERS = ("adalam", "gms")  # peers on our features
PEERS = (*RANKERS, *LEARNED)


@dataclass(frozen=True)
class Look:
    """How one series is drawn: a colour from the palette of Okabe and Ito, or grey; line and marker of matplotlib."""

    label: str
    colour: str
    line: Any = "-"
    marker: str = "o"


INPUTS: Mapping[str, Look] = {
    "standard": Look("X_L", "#8b919b", ":", "s"),
    "generalized": Look("all similar", "#cc79a7", (0, (1, 1)), "v"),
    "snn": Look("snn", "#0072b2", "--", "D"),
    "adalam": Look("AdaLAM", "#009e73", (0, (5, 1)), "P"),
    "gms": Look("GMS", "#56b4e9", (0, (3, 1, 1, 1)), "X"),
    "paper-standard": Look("X_L of the printed method", "#8b919b", "-.", "<"),
    "aliked": Look("ALIKED + LightGlue", "#2b2f36", (0, (7, 2)), "*"),
    "disk": Look("DISK + LightGlue", "#8c5a2b", (0, (3, 2)), ">"),
    "xfeat": Look("XFeat + LighterGlue", "#7d4fb2", (0, (1, 2)), "p"),
    "paper": Look("ours, as printed", "#e69f00", "-.", "^"),
    "fast": Look("ours, fast", "#b35806", (0, (3, 1)), "d"),
    "cascade": Look("cascade of snn and ours", "#117733", (0, (5, 2)), "h"),
    "default": Look("ours", "#d55e00", "-", "o"),
}
RANKINGS: Mapping[str, Look] = {
    "lowe": Look("distance ratio (Lowe)", "#8b919b", ":", "s"),
    "blogs": Look("similarity weight (BLOGS)", "#56b4e9", "--", "D"),
    "2keypoint": Look("2keypoints", "#009e73", "-.", "v"),
    "sfm": Look("supporting F matrices", "#e69f00", (0, (5, 1)), "^"),
    "final": Look("final probability", "#d55e00", "-", "o"),
}
METRIC_TITLES: Mapping[str, str] = {
    "precision_top_100": "precision of the top 100",
    "average_precision": "average precision",
    "accuracy": "accuracy",
    "precision": "precision",
    "log_loss": "log loss",
    "brier_score": "Brier score",
    "expected_calibration_error": "calibration error",
}
TARGET_TITLES: Mapping[str, str] = {
    "two_keypoint": "2keypoint matches",
    "match": "matches",
    "second_round": "matches, second round",
}

Row = Mapping[Any, Any]


def baseline_of(name: str, names: Sequence[str]) -> str:
    """Return which of an estimator's inputs `name` is compared with: the one without preprocessing, same features."""
    printed = "paper-standard"
    return printed if name == "paper" and printed in names else next(n for n in names if n in BASELINES)


def input_title(name: str) -> str:
    """Return an input as tables and figures call it."""
    return INPUTS[name].label if name in INPUTS else name


def group_title(group: str, pairs: int | None = None) -> str:
    """Return the title of a group: ``hard pairs (61)``, ``strecha (120)``."""
    title = f"{group} pairs" if group in (*DIFFICULTIES, ALL) else group
    return title if pairs is None else f"{title} ({pairs})"


def order_of(values: pd.Series[Any]) -> list[str]:
    """Return the different values of a column in the order in which they first appear."""
    return [str(value) for value in values.unique()]


def number(value: float, digits: int = 2) -> str:
    """Return a number with so many decimals; empty for NaN."""
    return "" if np.isnan(value) else f"{value:.{digits}f}"


def share(value: float, digits: int = 0) -> str:
    """Return a share as a percentage; empty for NaN."""
    return "" if np.isnan(value) else f"{100 * value:.{digits}f} %"


def percent(value: float, digits: int = 0) -> str:
    """Return a share as a signed percentage: ``+45 %``; ``new`` where nothing succeeded without the step."""
    if np.isinf(value):
        return "new"
    return f"{100 * value:+.{digits}f} %" if round(100 * value, digits) else "0 %"


def signed(value: float, digits: int = 1) -> str:
    """Return ``+2.4``; never ``-0.0``."""
    return f"{round(value, digits) + 0.0:+.{digits}f}"


def points(value: float) -> str:
    """Return a difference of shares in percentage points: ``+14``."""
    return signed(100 * value, 0)


def interval(row: Row, name: str, say: Any = percent) -> str:
    """Return ``+45 % [+12 %, +90 %]`` of the columns `name`, `name`_low and `name`_high.

    Empty without a value; without brackets where there is no interval.
    """
    value, low, high = (row.get(f"{name}{end}", np.nan) for end in ("", "_low", "_high"))
    if np.isnan(value):
        return ""
    return str(say(value)) + ("" if np.isnan(low) else f" [{say(low)}, {say(high)}]")


def best_bold(numbers: Iterable[float], digits: int = 1) -> list[str]:
    """Return numbers as text, the highest bold; empty for NaN."""
    texts = [number(value, digits) for value in numbers]
    best = max((float(text) for text in texts if text), default=np.nan)
    return [f"**{text}**" if text and float(text) == best else text for text in texts]


def setting(value: Any) -> str:
    """Return a setting of a hand-over: ``yes``, ``0.8``, ``none``."""
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    return "none" if pd.isna(value) else f"{value:g}" if isinstance(value, int | float) else str(value)


def listed(names: Sequence[str]) -> str:
    """Return ``a, b and c``."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
