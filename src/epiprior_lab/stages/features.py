"""Stage `features`: candidate rows of the training pairs for every preset, labelled from depth."""

from collections.abc import Sequence
from pathlib import Path

from epiprior_lab.compute.tasks import Task, map_tasks
from epiprior_lab.features.rows import extract_rows, rows_to_bytes
from epiprior_lab.pairsets import Pair, read_pair_set
from epiprior_lab.params import TruthParams, load_study


def extract(pair: Pair, presets: Sequence[str], labels: TruthParams) -> dict[str, list[bytes]]:
    """Return the rows of one pair per preset, one serialised table per roll hypothesis."""
    return {preset: [rows_to_bytes(rows) for rows in extract_rows(pair, preset, labels)] for preset in presets}


def main() -> None:
    """Write ``data/features/<preset>/<pair_id>-<roll hypothesis>.npz`` for every preset and training pair."""
    params = load_study()
    shared = {"presets": params.features.presets, "labels": params.truth}
    pairs = [pair for folder in params.features.pair_sets for pair in read_pair_set(Path(folder)).pairs]
    tasks = [Task(name=pair.pair_id, payload={"pair": pair, **shared}, files=pair.files) for pair in pairs]
    found = map_tasks(extract, tasks, description="features", store=Path("data/.tasks/features"))
    for preset in params.features.presets:
        out = Path("data/features") / preset
        out.mkdir(parents=True, exist_ok=True)
        for pair, tables in zip(pairs, found, strict=True):
            for k, table in enumerate(tables[preset]):
                (out / f"{pair.pair_id}-{k}.npz").write_bytes(table)


if __name__ == "__main__":
    main()
