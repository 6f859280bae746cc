"""Names and numbers as a reader sees them: one mapping of titles for all tables, figures and pages."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

ALL = "all"
OURS = "default"
BASELINES = ("standard", "generalized")  # what an estimator gets without the preprocessing step
DIFFICULTIES = ("easy", "medium", "hard")

LEARNED_TITLES: Mapping[str, str] = {
    "aliked": "ALIKED + LightGlue",
    "disk": "DISK + LightGlue",
    "xfeat": "XFeat + LighterGlue",
}
PEER_TITLES: Mapping[str, str] = {"adalam": "AdaLAM", "gms": "GMS", **LEARNED_TITLES}
INPUT_TITLES: Mapping[str, str] = {
    "standard": "X_L",
    "generalized": "all similar",
    "snn": "snn",
    **PEER_TITLES,
    "paper-standard": "X_L of the printed method",
    "paper": "ours, as printed",
    "fast": "ours, fast",
    "default": "ours",
}
RANKING_TITLES: Mapping[str, str] = {
    "lowe": "distance ratio (Lowe)",
    "blogs": "similarity weight (BLOGS)",
    "2keypoint": "2keypoints",
    "sfm": "supporting F matrices",
    "final": "final probability",
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
    return INPUT_TITLES.get(name, name)


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
