"""Stage `timing`: a leaf that measures time; no other stage reads what it writes."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console
from rich.progress import track

from epiprior.verification.cascade import load_cascade_rule
from epiprior_lab.evaluation.protocol import MODELS, make_protocol, pairs_of
from epiprior_lab.evaluation.records import TimingRecord, to_frame, write_frame
from epiprior_lab.evaluation.timing import spread_pairs, time_pair
from epiprior_lab.params import STUDY, load_params


def main() -> None:
    """Write ``<out>/pairs.csv``, a row per run, and what the report makes of it."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--params", type=Path, default=STUDY)
    parser.add_argument("--out", type=Path, default=Path("reports/timings"))
    arguments = parser.parse_args()
    params = load_params(arguments.params)
    own, seeds, protocol = params.evaluate, params.timing.seeds, make_protocol(params)
    rule = load_cascade_rule(MODELS / "cascade.json")
    groups = [name for name in own.groups if name not in (own.apart or ())]
    pairs = [(g, pair) for g in groups for pair in spread_pairs(pairs_of(own, g), params.timing.pairs_per_group)]
    time_pair(pairs[0][1], protocol, rule, group=groups[0], seeds=seeds[:1])  # compiles kernels, loads models
    records = []
    for group, pair in track(pairs, description="timing", console=Console(stderr=True)):
        records += time_pair(pair, protocol, rule, group=group, seeds=seeds)
    write_frame(to_frame(TimingRecord, records), arguments.out / "pairs.csv")


if __name__ == "__main__":
    main()
