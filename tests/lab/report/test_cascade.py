import pandas as pd

from epiprior.verification.cascade import CascadeRule
from epiprior_lab.params import CascadeParams
from epiprior_lab.report.cascade import learnt_page, rule_in_words
from epiprior_lab.report.page import render_markdown
from epiprior_lab.selection.cascade_rule import NEVER, LearntRule


def test_the_rule_in_words():
    columns = ("preprocessed", "lost", "held_out_preprocessed", "held_out_lost")
    outcomes = pd.DataFrame([[0.5, 0.01, 0.6, 0.02]] * 2, index=["usac", "all"], columns=columns)
    params = CascadeParams(seeds=(0,), tolerance=0.01, strict_tolerance=0.04, min_confidence=(0.5, 0.9))
    learnt = LearntRule(rule=CascadeRule(min_confidence=0.9), outcomes=outcomes)
    text = render_markdown(learnt_page(learnt, params, 10.0, 3.0, "cascade.png"))
    assert "| usac | 50.0 % | 1.0 % | 60.0 % | 2.0 % |" in text
    kept = "least 0.9, or if a homography relates the images and its confidence is at most 0.1; otherwise the pair is"
    assert kept in " ".join(text.split())
    assert "1.0%" in text
    assert "every pair is preprocessed" in rule_in_words(NEVER)
