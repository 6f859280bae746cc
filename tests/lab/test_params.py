import dataclasses
import json
from pathlib import Path

import pytest
import yaml
from pydantic import ValidationError

from epiprior.errors import SettingsError
from epiprior.estimators import names
from epiprior.estimators.handover import INPUTS
from epiprior_lab.params import PHOTOGRAPHS, STUDY, Params, StudyParams, load_params, load_study

ROOT = Path(__file__).parents[2]
FILES = {"study": ROOT / STUDY, "photographs": ROOT / PHOTOGRAPHS}


def document_of(file):
    return yaml.safe_load(FILES[file].read_text(encoding="utf-8"))


@pytest.fixture
def document():
    return document_of("study")


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
    assert json.loads(json.dumps(dataclasses.asdict(params))) == document_of(file)


def test_params_cannot_be_changed():
    with pytest.raises(dataclasses.FrozenInstanceError):
        load_study(FILES["study"]).scenes.seed = 3


@pytest.mark.parametrize(
    ("file", "section"),
    [("study", field.name) for field in dataclasses.fields(StudyParams)]
    + [("photographs", field.name) for field in dataclasses.fields(Params)],
)
def test_unknown_and_missing_keys_are_named_with_their_section(file, section, load):
    document = document_of(file)
    known = next(iter(document[section]))
    document[section]["sheed"] = document[section].pop(known)
    with pytest.raises(
        SettingsError, match=rf"params\.yaml: missing key {section}\.{known}; unknown key {section}\.sheed"
    ):
        load(document)
    del document[section]
    with pytest.raises(SettingsError, match=rf"params\.yaml: missing key {section}$"):
        load(document)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("scenes.jpeg_quality", 101, " = 101: Input should be less than or equal to 100"),
        ("scenes.image_width", 1024.0, " = 1024.0: Input should be a valid integer"),
        ("scenes.seed", True, " = True: Input should be a valid integer"),
        ("scenes.seed", "7", " = '7': Input should be a valid integer"),
        ("scenes.families", [], r" = \[\]: .* at least 1 item"),
        ("scenes.families", "open", " = 'open': Input should be a valid array"),
        ("scenes.families", ["open", "open"], " = .*repeated"),
        ("scenes.pairs", 3, ": expected a mapping, got 3"),
        ("scenes.pairs.train.open", 0, " = 0: Input should be greater than or equal to 1"),
        ("truth.tolerance_px", float("nan"), " = nan: Input should be"),
        ("truth.tolerance_px", "1e-3", " = '1e-3': Input should be a valid number"),
        ("truth.depth_tolerance", 1.0, " = 1.0: Input should be less than 1"),
        ("truth.hard_share", 0.6, " = 0.6: above easy_share = 0.5"),
        ("train.exported.default", "xgboost", ": 'xgboost' is not among tree"),
        ("hand_over.top_k", [8, 4], r"\.1 = 4: Input should be greater than or equal to 8$"),
        ("hand_over.one_to_one", [1], r"\.0 = 1: Input should be a valid boolean$"),
        ("hand_over.threshold_px", [None], r"\.0 = None: Input should be a valid number"),
        ("hand_over.weighted.estimators", ["usax"], ": 'usax' is not among usac"),
        ("cascade.min_plausibility", [1.5], r"\.0 = 1.5: Input should be less than or equal to 1"),
        ("evaluate.groups", ["facades-easy", "facades-hard", "open", "closed"], ": 'closed' is not among facades-easy"),
        ("evaluate.pairs", "data/scenes", " = 'data/scenes': expected {group} in it"),
        ("evaluate.inputs", ["raw"], r"\.0 = 'raw': Input should be 'standard', 'snn'"),
        ("evaluate.inputs", ["snn"], " of magsac.* are snn: expected standard or generalized"),
        ("evaluate.other_inputs", {"usax": ["standard"]}, ": 'usax' is not among usac"),
        ("evaluate.other_inputs.usac", ["lowe"], r"\.0 = 'lowe': Input should be 'standard'"),
        ("evaluate.other_inputs.usac", ["snn", "snn"], " = .*repeated"),
        ("evaluate.other_inputs", {"usac": ["standard", "generalized"]}, None),
        ("evaluate.other_inputs", ["usac"], " = .*: Input should be an object"),
        ("evaluate.whole", ["adalam"], r"\.0 = 'adalam': Input should be"),
        ("evaluate.apart", ["moon"], ": 'moon' is not among facades-easy"),
        ("analysis.estimators", ["usax"], ": 'usax' is not among usac"),
        ("timing.seeds", [], r" = \[\]: .* at least 1 item"),
        ("report.strict_px", 20.0, " = 20.0: above success_px"),
        ("report.thresholds_px", [5.0, 3.0], None),
        ("report.champion", "usax", ": 'usax' is not among usac"),
        ("report.hard_groups", ["open", "closed"], ": 'closed' is not among facades-easy, .*, easy, medium, hard"),
        ("report.gallery", {"estimator": "usax", "rescued": 1, "lost": 1}, r"\.estimator: 'usax' is not among usac"),
    ],
)
def test_wrong_types_and_ranges_are_named(key, value, message, document, load):
    *sections, last = key.split(".")
    place = document
    for section in sections:
        place = place[section]
    place[last] = value
    expected = {
        "report.thresholds_px": "report.success_px: 10.0 is not among 5.0, 3.0",
        "evaluate.other_inputs": "evaluate.inputs of usac are standard, generalized: expected standard or generalized",
    }
    with pytest.raises(SettingsError, match=rf"params\.yaml: {expected[key] if message is None else key + message}"):
        load(document)


def test_all_errors_are_named_at_once(document, load):
    document["scenes"]["seed"], document["truth"]["plane_px"] = "7", 0
    with pytest.raises(SettingsError, match=r"truth\.plane_px = 0: .*; scenes\.seed = '7': "):
        load(document)


def test_a_section_made_by_hand_is_checked_too():
    params = load_study(FILES["study"])
    with pytest.raises(ValidationError, match="tolerance"):
        dataclasses.replace(params.cascade, tolerance=1.5)


def test_every_estimator_is_evaluated_on_its_inputs():
    params = load_params(FILES["study"]).evaluate
    assert set(params.estimators) == set(names())
    assert params.inputs_by_estimator["magsac++"] == ("standard", "snn", "default")
    assert params.inputs_by_estimator["beem"] == ("standard", "snn", "paper", "default")
    assert params.inputs_by_estimator["generalized-ransac"] == ("generalized", "snn", "default")
    assert set(params.all_inputs) == set(INPUTS)
    assert params.inputs_and_peers == params.inputs_by_estimator


def test_inputs_of_peers_come_last():
    params = load_params(FILES["photographs"]).evaluate
    assert params.inputs_and_peers["usac"] == ("standard", "snn", "default", "adalam", "gms")
    assert "gms" not in params.all_inputs


def test_folders_of_a_group():
    study, photographs = (load_params(file).evaluate for file in FILES.values())
    assert study.pairs_of("open") == Path("data/scenes/test/open")
    assert study.control_points_of("open") == Path("data/ground_truth/test/open/control_points")
    assert photographs.pairs_of("fox") == Path("data/real/fox")
    assert photographs.control_points_of("fox") is None


def test_weighted_estimators_are_tried_with_more_matches():
    params = load_study(FILES["study"]).hand_over
    assert params.top_k_for("usac") == params.top_k
    assert params.top_k_for("beem") == params.weighted.top_k


def test_pairs_are_counted_for_exactly_the_families(document, load):
    del document["scenes"]["pairs"]["test"]["open"]
    with pytest.raises(SettingsError, match=r"scenes\.pairs\.test counts .*, expected the families"):
        load(document)


def test_null_is_accepted_where_it_means_no_limit(document, load):
    document["hand_over"]["top_k"] = [None]
    assert load(document).hand_over.top_k == (None,)


@pytest.mark.parametrize("text", ["scenes: [", "", "- 1", "\x00"])
def test_a_file_that_is_no_mapping_is_named(text, tmp_path):
    path = tmp_path / "params.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(SettingsError, match=r"params\.yaml"):
        load_params(path)


def test_an_absent_file_is_named(tmp_path):
    with pytest.raises(SettingsError, match=r"absent\.yaml"):
        load_study(tmp_path / "absent.yaml")
