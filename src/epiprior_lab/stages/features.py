"""Stage `features`: candidate rows of the training pairs, labelled from depth."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path

from epiprior_lab.datasets import Pair, read_pair_set
from epiprior_lab.ground_truth import LabelSettings
from epiprior_lab.parallel import Task, default_workers, map_tasks
from epiprior_lab.params import load_params
from epiprior_lab.rows import extract_rows, rows_to_bytes


def extract(pair: Pair, preset: str, labels: LabelSettings) -> list[bytes]:
    """Return the rows of one pair, one serialised table per roll hypothesis."""
    return [rows_to_bytes(rows) for rows in extract_rows(pair, preset, labels)]


def main() -> None:
    """Write ``data/features/<preset>/<pair_id>-<hypothesis>.npz`` for every training pair."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--preset", required=True, choices=("paper", "default"))
    preset = parser.parse_args().preset
    params = load_params()
    truth = asdict(params.ground_truth)
    labels = LabelSettings(**{name: truth[name] for name in LabelSettings.__dataclass_fields__})
    out = Path("data/features") / preset
    out.mkdir(parents=True, exist_ok=True)
    pairs = [pair for folder in params.features.pair_sets for pair in read_pair_set(Path(folder)).pairs]
    tasks = [
        Task(name=pair.pair_id, payload={"pair": pair, "preset": preset, "labels": labels}, files=pair.files)
        for pair in pairs
    ]
    store = Path("data/.tasks/features") / preset
    found = map_tasks(extract, tasks, workers=default_workers(), description=f"features, preset {preset}", store=store)
    for pair, tables in zip(pairs, found, strict=True):
        for k, table in enumerate(tables):
            (out / f"{pair.pair_id}-{k}.npz").write_bytes(table)


if __name__ == "__main__":
    main()
