"""Stage `report` of the second pipeline: tables, figures, the page, and the gallery that stays here."""

from __future__ import annotations

from pathlib import Path

from epiprior.verification.cascade import load_cascade_rule
from epiprior_lab.compute.tasks import single_threaded
from epiprior_lab.pairsets import read_pair_set
from epiprior_lab.params import PHOTOGRAPHS, load_params
from epiprior_lab.report.photographs.gallery import choose_cases, draw_cases
from epiprior_lab.report.photographs.report import make_tables, write_report
from epiprior_lab.report.photographs.results import Photographs
from epiprior_lab.stages.real_evaluate import real_hand_overs

OUT = Path("reports/real")
GALLERY = Path("data/photographs-gallery")


def main() -> None:
    """Write everything in ``reports/real`` but the timings, and ``data/photographs-gallery``."""
    params = load_params(PHOTOGRAPHS)
    report, sets = params.report, params.evaluate.groups
    photographs = Photographs.read(Path("data/photographs"), sets=sets, apart=params.evaluate.apart or ())
    assert report.gallery is not None
    cases = choose_cases(photographs, report.gallery, success_px=report.success_px, seeds=params.evaluate.seeds)
    shown = {case.set_name for case in cases}
    pairs = {
        (name, pair.pair_id): pair
        for name in sets
        if name in shown
        for pair in read_pair_set(Path("data/real") / name).pairs
    }
    with single_threaded():
        tables = make_tables(photographs, load_cascade_rule(Path("models/cascade.json")), report)
        draw_cases(
            cases,
            pairs,
            hand_overs=real_hand_overs(params),
            photographs=GALLERY,
            frames=OUT / "gallery",
        )
        write_report(photographs, tables, cases, OUT, report, gallery=GALLERY)


if __name__ == "__main__":
    main()
