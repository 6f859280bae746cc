import dataclasses
from pathlib import Path

import pytest
import yaml

from epiprior.errors import SettingsError
from epiprior.estimators import names
from epiprior.estimators.handover import INPUTS
from epiprior_lab.params import Params, load_params

STUDY = Path(__file__).parents[2] / "params.yaml"


@pytest.fixture
def document():
    return yaml.safe_load(STUDY.read_text(encoding="utf-8"))


@pytest.fixture
def load(tmp_path):
    def load(document):
        path = tmp_path / "params.yaml"
        path.write_text(yaml.safe_dump(document), encoding="utf-8")
        return load_params(path)

    return load


def test_the_studys_file_is_read_whole():
    params = load_params(STUDY)
    assert params.scenes.families == ("facades-easy", "facades-hard", "open", "rolled")
    assert params.evaluate.seeds == (0, 1, 2, 3, 4)
    assert params.train.exported.default == "lightgbm"
    document = yaml.safe_load(STUDY.read_text(encoding="utf-8"))
    assert yaml.safe_load(yaml.safe_dump(_plain(dataclasses.asdict(params)))) == document


def _plain(value):
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, tuple) else value


def test_params_cannot_be_changed():
    with pytest.raises(dataclasses.FrozenInstanceError):
        load_params(STUDY).scenes.seed = 3


@pytest.mark.parametrize("section", [field.name for field in dataclasses.fields(Params)])
def test_unknown_and_missing_keys_are_named_with_their_section(section, document, load):
    known = next(iter(document[section]))
    value = document[section].pop(known)
    with pytest.raises(SettingsError, match=rf"params\.yaml: missing key {section}\.{known}"):
        load(document)
    document[section] |= {known: value, "sheed": 1}
    with pytest.raises(SettingsError, match=rf"params\.yaml: unknown key {section}\.sheed"):
        load(document)


@pytest.mark.parametrize(
    ("section", "key", "value", "message"),
    [
        ("scenes", "jpeg_quality", 101, "scenes.jpeg_quality = 101: expected 1 to 100"),
        ("scenes", "image_width", 1024.0, "scenes.image_width = 1024.0: expected int"),
        ("scenes", "seed", True, "scenes.seed = True: expected int"),
        ("scenes", "seed", "7", "scenes.seed = '7': expected int"),
        ("scenes", "families", [], r"scenes.families = \(\): expected a list"),
        ("scenes", "families", "open", "scenes.families = 'open': expected a list"),
        ("scenes", "families", ["open", "open"], "scenes.families = .*repeated"),
        ("scenes", "pairs", 3, r"scenes\.pairs: expected a mapping"),
        ("ground_truth", "tolerance_px", float("nan"), "ground_truth.tolerance_px = nan"),
        ("ground_truth", "tolerance_px", "1e-3", "ground_truth.tolerance_px = '1e-3': expected float"),
        ("train", "exported", {"paper": "tree", "default": "xgboost"}, "train.exported.default = 'xgboost'"),
        ("hand_over", "top_k", [4], "hand_over.top_k = 4: expected 8 to"),
        ("hand_over", "one_to_one", [1], "hand_over.one_to_one = 1: expected bool"),
        ("hand_over", "min_probability", [None, 1.5], "hand_over.min_probability = 1.5: expected 0 to 1"),
        (
            "hand_over",
            "weighted",
            {"estimators": ["usax"], "top_k": [8]},
            "hand_over.weighted.estimators: 'usax' is not",
        ),
        ("evaluate", "inputs", ["raw"], "evaluate.inputs = 'raw': expected one of standard, snn"),
        ("evaluate", "inputs", ["snn"], "evaluate.inputs of magsac.* are snn: expected standard or generalized"),
        ("evaluate", "other_inputs", {"usax": ["standard"]}, "evaluate.other_inputs.usax: not among estimators"),
        ("evaluate", "other_inputs", {"usac": ["lowe"]}, "evaluate.other_inputs.usac = 'lowe': expected one of"),
        ("evaluate", "other_inputs", {"usac": ["snn", "snn"]}, "evaluate.other_inputs.usac = .*repeated"),
        (
            "evaluate",
            "other_inputs",
            {"usac": ["standard", "generalized"]},
            "evaluate.inputs of usac are standard, gen",
        ),
        ("evaluate", "other_inputs", ["usac"], "evaluate.other_inputs = .*expected a mapping"),
        ("overhead", "seeds", [], r"overhead.seeds = \(\): expected a list"),
        ("report", "strict_px", 20.0, "report.strict_px = 20.0: above success_px"),
    ],
)
def test_wrong_types_and_ranges_are_named(section, key, value, message, document, load):
    document[section][key] = value
    with pytest.raises(SettingsError, match=rf"params\.yaml: {message}"):
        load(document)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("hard_families", ["open", "closed"], "report.bounds.hard_families: 'closed' is not among facades-easy"),
        ("contribution", {"usac": -1}, "report.bounds.contribution.usac = -1: expected 0 to 100"),
        ("contribution", {"usax": 0.5}, "report.bounds.contribution: 'usax' is not among usac"),
        ("champion", "nobody", "report.bounds.champion: 'nobody' is not among usac"),
    ],
)
def test_bounds_are_about_what_is_studied(key, value, message, document, load):
    document["report"]["bounds"][key] = value
    with pytest.raises(SettingsError, match=rf"params\.yaml: {message}"):
        load(document)


def test_every_estimator_is_evaluated_on_its_inputs():
    params = load_params(STUDY).evaluate
    assert set(params.estimators) == set(names())
    assert params.inputs_by_estimator["magsac++"] == ("standard", "snn", "default")
    assert params.inputs_by_estimator["beem"] == ("standard", "snn", "paper", "default")
    assert params.inputs_by_estimator["generalized-ransac"] == ("generalized", "snn", "default")
    assert set(params.all_inputs) == set(INPUTS)


def test_weighted_estimators_are_tried_with_more_matches():
    params = load_params(STUDY).hand_over
    assert params.top_k_for("usac") == params.top_k
    assert params.top_k_for("beem") == params.weighted.top_k


def test_nested_sections_are_named_whole(document, load):
    document["scenes"]["pairs"]["train"]["open"] = 0
    with pytest.raises(SettingsError, match=r"params\.yaml: scenes\.pairs\.train\.open = 0: expected 1 to"):
        load(document)


def test_pairs_are_counted_for_exactly_the_families(document, load):
    del document["scenes"]["pairs"]["test"]["open"]
    with pytest.raises(SettingsError, match=r"scenes\.pairs\.test counts .*, expected the families"):
        load(document)


def test_null_is_accepted_only_where_it_means_no_limit(document, load):
    document["hand_over"]["top_k"] = [None]
    assert load(document).hand_over.top_k == (None,)
    document["hand_over"]["threshold_px"] = [None]
    with pytest.raises(SettingsError, match=r"hand_over\.threshold_px = None"):
        load(document)


@pytest.mark.parametrize("text", ["scenes: [", "", "- 1", "\x00"])
def test_a_file_that_is_no_mapping_is_named(text, tmp_path):
    path = tmp_path / "params.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(SettingsError, match=r"params\.yaml"):
        load_params(path)


def test_an_absent_file_is_named(tmp_path):
    with pytest.raises(SettingsError, match=r"absent\.yaml"):
        load_params(tmp_path / "absent.yaml")
