"""Stage `report`: tables, figures and the page of an evaluation, of rendered scenes or of photographs."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from epiprior_lab.compute.tasks import single_threaded
from epiprior_lab.evaluation.protocol import make_protocol, pairs_of
from epiprior_lab.evaluation.records import KindRecord, read_frame, read_table
from epiprior_lab.pairsets import known_sets
from epiprior_lab.params import STUDY, Params, StudyParams, load_params, read_arguments
from epiprior_lab.report import pictures as drawn
from epiprior_lab.report.figures import roll_figure
from epiprior_lab.report.material import Material
from epiprior_lab.report.report import HAND_OVER_COLUMNS, read_classifiers, read_material, write_report

KINDS = {"study": Path("data/kinds/kinds.csv"), "photographs": Path("data/real-kinds/kinds.csv")}
GALLERY = Path("data/photographs-gallery")
OF_OTHER_STAGES = {name: f"timings/{name}.png" for name in ("decision", "overhead", "estimators")}
OF_STUDY = {"cascade": "cascade.png", **{name: f"analysis/{name}.png" for name in ("steps", "ablations", "limits")}}


def study_material(params: StudyParams, common: Material, out: Path) -> Material:
    """Draw the pictures of the study, and add what else its report shows to what both show."""
    own, results, figures = params.evaluate, common.results, out / "figures"
    shown = {group: pairs_of(own, group) for group in own.groups}
    by_id = {(group, pair.pair_id): pair for group, pairs in shown.items() for pair in pairs}
    hard = results.hard[0]
    example = by_id[hard, drawn.rescued_pair(results, hard, params.report.success_px)]
    densities = {
        key[1]: (*drawn.density_of_roll(by_id[key]), true) for key, true in drawn.rolled_pairs(results).items()
    }
    roll_figure(densities, figures / "roll.png")
    count = params.report.contact_sheet_pairs or 0
    sheet = drawn.contact_sheet({g: pairs[:count] for g, pairs in shown.items()}, figures / "contact_sheet.jpg")
    pictures = {"contact_sheet": sheet, "example": drawn.example_picture(example, figures / "example.jpg")}
    made = {name: out / path for name, path in OF_STUDY.items()}
    return replace(
        common,
        classifiers=read_classifiers(Path("data/training"), params.features.presets),
        hand_over=read_table(Path("data/hand_over/search.csv"), HAND_OVER_COLUMNS),
        pictures={**pictures, "roll": figures / "roll.png", **common.pictures, **made},
    )


def photograph_material(params: Params, common: Material, out: Path) -> Material:
    """Draw the gallery of photographs, and add what else their report shows to what both show."""
    gallery, own, cases = params.report.gallery, params.evaluate, []
    if gallery is not None:
        how: dict[str, Any] = {"rescued": gallery.rescued, "lost": gallery.lost, "success_px": params.report.success_px}
        cases = drawn.choose_cases(common.results, gallery.estimator, **how)
        shown = dict.fromkeys(case.group for case in cases)
        pairs = {(group, pair.pair_id): pair for group in shown for pair in pairs_of(own, group)}
        drawn.draw_cases(cases, pairs, make_protocol(params), photographs=GALLERY, frames=out / "gallery")
    return replace(common, known_sets=known_sets(), cases=cases, gallery=GALLERY)


def main() -> None:
    """Write everything in ``<out>`` but what other stages write, and the gallery that stays here."""
    arguments = read_arguments(main.__doc__, params=STUDY, out=Path("reports"))
    params, out = load_params(arguments.params), arguments.out
    kind = "study" if isinstance(params, StudyParams) else "photographs"
    material = read_material(params.evaluate, params.report, kind, make_protocol(params))
    pictures = {name: out / path for name, path in OF_OTHER_STAGES.items()}
    material = replace(material, kinds=read_frame(KindRecord, KINDS[kind]), pictures=pictures)
    with single_threaded():
        if isinstance(params, StudyParams):
            material = study_material(params, material, out)
        else:
            material = photograph_material(params, material, out)
        write_report(material, out)


if __name__ == "__main__":
    main()
