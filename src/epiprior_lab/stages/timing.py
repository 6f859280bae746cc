"""Stage `timing`: a leaf that measures time; no other stage reads what it writes."""

from pathlib import Path

import joblib
from rich.console import Console
from rich.progress import track

from epiprior.verification.cascade import load_cascade_rule
from epiprior_lab.evaluation.learned import LEARNED
from epiprior_lab.evaluation.peers import interpreter
from epiprior_lab.evaluation.protocol import MODELS, make_protocol, pairs_of
from epiprior_lab.evaluation.records import TimingRecord, to_frame, write_frame
from epiprior_lab.evaluation.timing import spread_pairs, time_learned_pairs, time_pair
from epiprior_lab.params import STUDY, StudyParams, load_params, read_arguments
from epiprior_lab.report.report import read_material
from epiprior_lab.report.timing import write_timings


def main() -> None:
    """Write ``<out>/pairs.csv``, a row per run, and what the report makes of it."""
    arguments = read_arguments(main.__doc__, params=STUDY, out=Path("reports/timings"))
    params = load_params(arguments.params)
    own, seeds, protocol = params.evaluate, params.timing.seeds, make_protocol(params)
    rule = load_cascade_rule(MODELS / "cascade.json")
    groups = [name for name in own.groups if name not in (own.apart or ())]
    pairs = [(g, pair) for g in groups for pair in spread_pairs(pairs_of(own, g), params.timing.pairs_per_group)]
    time_pair(pairs[0][1], protocol, rule, group=groups[0], seeds=seeds[:1])  # compiles kernels, loads models
    records = []
    for group, pair in track(pairs, description="timing", console=Console(stderr=True)):
        records += time_pair(pair, protocol, rule, group=group, seeds=seeds)
    for peer in (name for name in own.peers or () if name in LEARNED):
        how = {"python": interpreter(), "threads": joblib.cpu_count()}
        records += time_learned_pairs(pairs, peer, protocol, seeds=seeds, **how)
    timings = to_frame(TimingRecord, records)
    write_frame(timings, arguments.out / "pairs.csv")
    kind = "study" if isinstance(params, StudyParams) else "photographs"
    write_timings(timings, read_material(own, params.report, kind, protocol), arguments.out)


if __name__ == "__main__":
    main()
