"""Stage `cascade`: when an estimate on simple matches is kept, chosen on validation scenes, tried on test pairs."""

from dataclasses import replace
from pathlib import Path

from epiprior.verification.cascade import save_cascade_rule
from epiprior_lab.evaluation.evaluate import run_pairs
from epiprior_lab.evaluation.inputs import FIRST, PREPROCESSED, model_files, store_matches
from epiprior_lab.evaluation.protocol import MODELS, make_protocol, rendered_pairs
from epiprior_lab.evaluation.records import RunRecord, Tables, to_frame
from epiprior_lab.params import load_study
from epiprior_lab.report.cascade import cascade_figure, learnt_page
from epiprior_lab.selection.cascade_rule import learn_rule, paired_runs

OUT = Path("reports")
STORE = Path("data/.tasks/validation")  # where the stage `hand_over` left the matches


def main() -> None:
    """Write ``models/cascade.json`` and ``reports/cascade.{md,png}``."""
    params = load_study()
    protocol = make_protocol(params)
    compared = {e: [n for n in names if n in (FIRST, PREPROCESSED)] for e, names in protocol.inputs.items()}
    asked, files = protocol.all_inputs, model_files(MODELS, protocol.all_inputs)
    own = replace(protocol, inputs=compared, seeds=params.cascade.seeds)
    records = []
    for group, pairs in rendered_pairs("validation", params.scenes.families).items():
        matched = store_matches(pairs, asked, STORE / "matches", files=files, description=f"match {group}")
        records += run_pairs(pairs, matched, own, group=group, store=STORE)
    evaluate, report = params.evaluate, params.report
    validation = paired_runs(to_frame(RunRecord, records))
    learnt = learn_rule(validation, params.cascade, success_px=report.success_px, strict_px=report.strict_px)
    save_cascade_rule(MODELS / "cascade.json", learnt.rule)
    test = paired_runs(Tables.read([Path(evaluate.out) / group for group in evaluate.groups]).runs)
    runs = {"validation": validation, "test": test}
    cascade_figure(runs, learnt.rule, params.cascade, report.success_px, OUT / "cascade.png")
    page = learnt_page(learnt, params.cascade, report.success_px, report.strict_px, "cascade.png")
    page.write(OUT, markdown="cascade.md", html="")


if __name__ == "__main__":
    main()
