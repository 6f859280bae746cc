import functools
import json
from dataclasses import asdict, replace
from pathlib import Path

import pytest
import yaml
from pydantic import ValidationError

from calls import refused
from epiprior.errors import SettingsError
from epiprior.estimators import names
from epiprior.estimators.handover import INPUTS
from epiprior_lab.params import PHOTOGRAPHS, STUDY, Params, StudyParams, load_params, load_study

ROOT = Path(__file__).parents[2]
FILES = {"study": ROOT / STUDY, "photographs": ROOT / PHOTOGRAPHS}


def document_of(file="study"):
    return yaml.safe_load(FILES[file].read_text(encoding="utf-8"))


@pytest.fixture
def load(tmp_path):
    def load(document):
        path = tmp_path / "params.yaml"
        path.write_text(yaml.safe_dump(document), encoding="utf-8")
        return load_params(path)

    return load


@pytest.mark.parametrize("file", FILES)
def test_both_files_are_read_whole(file):
    params = load_params(FILES[file])
    assert type(params) is {"study": StudyParams, "photographs": Params}[file]
    assert json.loads(json.dumps(asdict(params))) == document_of(file)


@pytest.mark.parametrize(("file", "section"), [(file, section) for file in FILES for section in document_of(file)])
def test_unknown_and_missing_keys_are_named_with_their_section(file, section, load):
    document = document_of(file)
    known = next(iter(document[section]))
    document[section]["sheed"] = document[section].pop(known)
    message = rf"params\.yaml: missing key {section}\.{known}; unknown key {section}\.sheed"
    refused(SettingsError, message, load, document)
    del document[section]
    refused(SettingsError, rf"params\.yaml: missing key {section}$", load, document)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("scenes.jpeg_quality", 101, " = 101: Input should be less than or equal to 100"),
        ("scenes.seed", True, " = True: Input should be a valid integer"),
        ("scenes.seed", "7", " = '7': Input should be a valid integer"),
        ("scenes.families", [], r" = \[\]: .* at least 1 item"),
        ("scenes.families", ["open", "open"], " = .*repeated"),
        ("scenes", 3, ": expected a mapping, got 3"),
        ("scenes.pairs.train.open", 0, " = 0: Input should be greater than or equal to 1"),
        ("truth.tolerance_px", float("nan"), " = nan: Input should be"),
        ("truth.depth_tolerance", 1.0, " = 1.0: Input should be less than 1"),
        ("truth.hard_share", 0.6, " = 0.6: above easy_share = 0.5"),
        ("train.families", ["tree", "c4.5"], r"\.1 = 'c4.5': Input should be 'tree', 'random-forest'"),
        ("train.exported.default", "svm", ": 'svm' is not among tree, random-forest, lightgbm"),
        ("hand_over.top_k", [8, 4], r"\.1 = 4: Input should be greater than or equal to 8$"),
        ("hand_over.one_to_one", [1], r"\.0 = 1: Input should be a valid boolean$"),
        ("hand_over.weighted.estimators", ["usax"], ": 'usax' is not among usac"),
        ("cascade.min_confidence", [1.5], r"\.0 = 1.5: Input should be less than or equal to 1"),
        ("evaluate.groups", ["facades-easy", "facades-hard", "open", "closed"], ": 'closed' is not among facades-easy"),
        ("evaluate.pairs", "data/scenes", " = 'data/scenes': expected {group} in it"),
        ("evaluate.inputs", ["raw"], r"\.0 = 'raw': Input should be 'standard', 'snn'"),
        ("evaluate.inputs", ["snn"], " of magsac.* are snn: expected standard or generalized"),
        ("evaluate.other_inputs", {"usax": ["standard"]}, ": 'usax' is not among usac"),
        ("scenes.pairs.test", {"open": 3}, " counts .*, expected the families"),
        ("evaluate.apart", ["moon"], ": 'moon' is not among facades-easy"),
        ("report.strict_px", 20.0, " = 20.0: above success_px"),
        ("report.champion", "usax", ": 'usax' is not among usac"),
        ("report.hard_groups", ["open", "closed"], ": 'closed' is not among facades-easy, .*, easy, medium, hard"),
        ("report.gallery", {"estimator": "usax", "rescued": 1, "lost": 1}, r"\.estimator: 'usax' is not among usac"),
    ],
)
def test_wrong_types_and_ranges_are_named(key, value, message, load):
    document = document_of()
    *sections, last = key.split(".")
    functools.reduce(dict.__getitem__, sections, document)[last] = value
    refused(SettingsError, rf"params\.yaml: {key}{message}", load, document)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scenes.seed": "7", "truth.plane_px": 0}, r"truth\.plane_px = 0: .*; scenes\.seed = '7': "),
        ({"report.thresholds_px": [5.0, 3.0]}, "report.success_px: 10.0 is not among 5.0, 3.0"),
        ({"evaluate.other_inputs": {"usac": ["standard", "generalized"]}}, "of usac are standard, generalized: exp"),
    ],
)
def test_settings_that_do_not_agree_are_named_and_all_errors_at_once(changes, message, load):
    document = document_of()
    for key, value in changes.items():
        section, name = key.split(".")
        document[section][name] = value
    refused(SettingsError, message, load, document)
    with pytest.raises(ValidationError, match="tolerance"):  # also of a section that is made by hand
        replace(load_study(FILES["study"]).cascade, tolerance=1.5)


def test_what_follows_from_parameters():
    study, photographs = (load_params(file).evaluate for file in FILES.values())
    assert set(study.estimators) == set(names())
    assert study.inputs_by_estimator["gc-ransac"] == ("standard", "snn", "default")
    assert study.inputs_by_estimator["beem"] == ("standard", "snn", "paper-standard", "paper", "default")
    assert study.inputs_by_estimator["generalized-ransac"] == ("generalized", "snn", "default")
    assert {name for inputs in study.inputs_by_estimator.values() for name in inputs} == set(INPUTS)
    assert study.inputs_and_peers == study.inputs_by_estimator
    assert photographs.inputs_and_peers["usac"] == ("standard", "snn", "default", "aliked", "xfeat")
    assert photographs.inputs_and_peers["epiprior"] == ("standard", "snn", "fast", "default")
    assert replace(photographs, peers=None).inputs_and_peers == photographs.inputs_by_estimator
    for wrong in ({"loftr": ("usac",)}, {"aliked": ("usac2",)}):
        refused(ValidationError, "peer_estimators", replace, photographs, peer_estimators=wrong)
    assert study.pairs_of("open") == Path("data/scenes/test/open")
    assert study.control_points_of("open") == Path("data/ground_truth/test/open/control_points")
    assert photographs.pairs_of("fox") == Path("data/real/fox")
    assert photographs.control_points_of("fox") is None
    assert None in load_study(FILES["study"]).hand_over.weighted.top_k  # no limit


@pytest.mark.parametrize("text", ["scenes: [", "", "- 1", "\x00", None])
def test_an_absent_file_and_one_that_is_no_mapping_are_named(text, tmp_path):
    if text is not None:
        (tmp_path / "params.yaml").write_text(text, encoding="utf-8")
    refused(SettingsError, r"params\.yaml", load_params, tmp_path / "params.yaml")
