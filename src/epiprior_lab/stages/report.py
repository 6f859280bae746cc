"""Stage `report`: tables, figures and the page."""

from __future__ import annotations

from pathlib import Path

from epiprior_lab.compute.tasks import single_threaded
from epiprior_lab.evaluation.estimates import study_pairs
from epiprior_lab.params import load_study
from epiprior_lab.report.contact_sheet import contact_sheet
from epiprior_lab.report.example import example_figure, rescued_pair
from epiprior_lab.report.report import write_report
from epiprior_lab.report.study import Study

OUT = Path("reports")
SHOWN = "facades-hard"  # the family whose rescued pair is drawn


def main() -> None:
    """Write everything in ``reports/`` but the timings."""
    params = load_study()
    families = params.scenes.families
    study = Study.read(
        Path("data"), Path("data/hand_over/search.csv"), families=families, presets=params.features.presets
    )
    with single_threaded():
        shown = {family: study_pairs("test", family)[: params.report.contact_sheet_pairs] for family in families}
        pair = rescued_pair(study, study_pairs("test", SHOWN), SHOWN)
        photographs = {
            "contact_sheet": contact_sheet(shown, OUT / "figures" / "contact_sheet.jpg"),
            "example": example_figure(pair, OUT / "figures" / "example.jpg"),
        }
        write_report(study, photographs, OUT, params.report)


if __name__ == "__main__":
    main()
