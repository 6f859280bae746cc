"""What the command line prints: lines for people, JSON for programs."""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from epiprior.explain import Explanation
    from epiprior.types import FundamentalEstimate


def complain(text: str) -> None:
    """Print one line on stderr, whatever the text."""
    typer.echo(f"epiprior: {' '.join(text.split())}", err=True)


def say(text: str) -> None:
    """Print on stdout; where its reader has closed it, say so once on stderr and let the work go on."""
    try:
        typer.echo(text)
    except BrokenPipeError:
        drop_stdout()
        complain("the output was closed early; the work goes on without it")


def drop_stdout() -> None:
    """Discard what could not be written, so that the interpreter does not fail on it again when it ends."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (OSError, ValueError):
        return


def print_json(value: Any) -> None:
    """Print JSON, with null for every number that JSON does not have."""
    say(json.dumps(_finite(value), indent=2, allow_nan=False))


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _finite(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(inner) for inner in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def print_table(header: Sequence[str], rows: Sequence[Sequence[str]], title: str | None = None) -> None:
    """Print rows below a header; on a narrow terminal cells are wrapped."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    for name in header:
        # A hash or a command is of use only as a whole.
        table.add_column(name, overflow="fold")
    for row in rows:
        table.add_row(*map(escape, row))
    console = Console()
    with console.capture() as printed:
        console.print(table)
    say(printed.get().rstrip("\n"))


def entries(value: Any, name: str = "") -> list[tuple[str, str]]:
    """Return nested mappings as rows of a dotted name and a value; a list is one value."""
    if isinstance(value, Mapping):
        below = (entries(inner, f"{name}.{key}" if name else str(key)) for key, inner in value.items())
        return [row for rows in below for row in rows]
    if isinstance(value, list | tuple):
        return [(name, ", ".join(str(item) for item in value))]
    return [(name, f"{value:.4g}" if isinstance(value, float) else str(value))]


def summary(found: FundamentalEstimate) -> str:
    """Return an estimate in one line."""
    sure = f", confidence {found.confidence:.2f}" if math.isfinite(found.confidence) else ""
    text = f"{found.estimator}: {found.status.value}{sure}, geometry {found.geometry.value}, "
    text += f"support {found.support} of {len(found.x1)} matches"
    return f"{text}; {found.message}" if found.message else text


def print_estimate(found: FundamentalEstimate) -> None:
    """Print an estimate for people."""
    say(summary(found))
    for name, matrix in (("F", found.F), ("H", found.H)):
        for k, row in enumerate([] if matrix is None else matrix.tolist()):
            say(f"{' ' if k else name}  " + "  ".join(f"{value: .9e}" for value in row))
    matches = f"{found.input} matches; " if found.input else ""
    say(f"{matches}roll {found.roll_deg:.0f} deg; {found.version}; {sum(found.seconds.values()):.2f} s")


def estimate_as_json(found: FundamentalEstimate, preset: str, seed: int) -> dict[str, Any]:
    """Return an estimate as JSON's types; null are a preset that ranked nothing and an unknown confidence."""
    return {
        "status": found.status.value,
        "confidence": float(found.confidence),
        "geometry": found.geometry.value,
        "F": None if found.F is None else found.F.tolist(),
        "H": None if found.H is None else found.H.tolist(),
        "support": int(found.support),
        "matches": len(found.x1),
        "iterations": None if found.iterations is None else int(found.iterations),
        "estimator": found.estimator,
        "version": found.version,
        "input": found.input,
        "preset": preset if found.input == preset else None,
        "roll_deg": float(found.roll_deg),
        "seed": seed,
        "seconds": {step: float(value) for step, value in found.seconds.items()},
        "message": found.message,
    }


def print_explanation(found: Explanation) -> None:
    """Print for people why a match has its probability."""
    from epiprior.explain import HEADER

    ranked, row = found.ranked, found.row
    (x1, y1), (x2, y2) = ranked.x1[row], ranked.x2[row]
    at = f"({x1:.1f}, {y1:.1f}) to ({x2:.1f}, {y2:.1f})"
    say(f"match {found.match}: {at}, probability {found.probability:.3g}; roll {ranked.roll_deg:.0f} deg")
    for sentence in filter(None, found.sentences()):
        say(sentence)
    for name, *cells in (HEADER, *(column.cells() for column in found.rounds[-1].decisive())):
        say(f"{name:<31}" + "".join(f"{cell:>11}" for cell in cells))


def explanation_as_json(found: Explanation) -> dict[str, Any]:
    """Return an explanation as JSON's types; matches are named by their numbers."""
    ranked, row, best = found.ranked, found.row, found.best
    first = found.match - row  # number of the first match of this roll hypothesis
    held = zip(found.partners.tolist(), found.partner_probability.tolist(), found.partner_voted.tolist(), strict=True)
    return {
        "match": found.match,
        "set": found.set,
        "roll_deg": float(ranked.roll_deg),
        "x1": ranked.x1[row].tolist(),
        "x2": ranked.x2[row].tolist(),
        "probability": found.probability,
        "turned": found.turned,
        "in_x": found.in_x,
        "rounds": [asdict(judged) for judged in found.rounds],
        "two_keypoints": [
            {
                "match": first + partner,
                "x1": ranked.x1[partner].tolist(),
                "x2": ranked.x2[partner].tolist(),
                "probability": probability,
                "voted": voted,
            }
            for partner, probability, voted in held
        ],
        "rough_matrices": len(ranked.rough_matrices),
        "supporting_matrices": int(ranked.supporting_matrices[row]),
        "self_made": found.self_made,
        "best_matrix": best and {**asdict(best), "F": best.F.tolist(), "made_of": (first + best.made_of).tolist()},
    }
