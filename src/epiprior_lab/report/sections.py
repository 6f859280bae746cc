"""The sections of a report in the order of its page, made of the report's tables alone; empty ones vanish."""

from epiprior_lab.report import method_sections as method
from epiprior_lab.report import result_sections as results
from epiprior_lab.report.material import CASCADE, Maker, Material
from epiprior_lab.report.page import Section
from epiprior_lab.report.prose import say


def all_sections(material: Material) -> list[Section]:
    """Return the sections in the order of the page: how well, how measured, what falls short, and bounds last.

    A section that needs a table which is not there is left out.
    """
    # Title, what makes the section, and the table that it needs.
    makers: list[tuple[str, Maker, str | None]] = [
        ("How well it works", results.summary, None),
        ("A rescued pair", _plain("example", "example"), None),
        ("Successes", results.successes, None),
        ("Against every other estimator", results.duels, "duels"),
        ("Poses and distances", results.poses, None),
        ("Rankings", results.rankings, None),
        ("Calibration", results.calibration, None),
        ("Cascade", results.cascade, CASCADE),
        ("Turned and shrunk photographs", results.changed, "changed"),
        ("Time", _plain("time", "decision", "overhead", "estimators"), None),
        ("Pairs", method.pairs, None),
        ("How it was measured", method.method, None),
        ("Hand-over", method.hand_over, "hand_over"),
        ("Classifiers", method.classifiers, "classifiers"),
        ("Roll", _plain("roll", "roll"), None),
        ("Analysis", _plain("analysis", "steps", "ablations", "limits"), None),
        ("Confidence", method.confidence, "confidence"),
        ("Verification", method.statuses, None),
        ("What limits the results", method.limits, "limits"),
        ("Gallery", method.gallery, None),
        ("Bounds", method.bounds, "bounds"),
    ]
    return [
        Section(title=title, blocks=[block for block in make(material) if block])
        for title, make, needed in makers
        if needed is None or needed in material.tables
    ]


def _plain(name: str, *pictures: str) -> Maker:
    """Return what makes a section of prose and pictures alone."""
    return lambda m: iter([say(name), *(m.picture(one) for one in pictures)])
