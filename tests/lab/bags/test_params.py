import json
from dataclasses import asdict
from pathlib import Path

import pytest
import yaml

from epiprior.errors import SettingsError
from epiprior_lab.bags.params import PATH, load_sfm_params

FILE = Path(__file__).parents[3] / PATH


def document():
    return yaml.safe_load(FILE.read_text(encoding="utf-8"))


def test_the_file_is_read_whole():
    assert json.loads(json.dumps(asdict(load_sfm_params(FILE)))) == json.loads(json.dumps(document()))


@pytest.mark.parametrize(
    ("section", "key", "value", "message"),
    [
        ("bags", "per_scene", {5: 0}, "per_scene"),
        ("bags", "per_scene", {5: 1.5}, "per_scene"),
        ("bags", "stranger_size", 4, "stranger_size = 4"),
        ("bags", "more", 1, "more"),
        ("methods", "names", ["colmap", "orb"], "names"),
        ("methods", "names", ["snn"], "report.against: 'colmap' is not among"),
        ("methods", "learned_kinds", ["odd"], "learned_kinds"),
        ("methods", "learned_sizes", [7], "learned_sizes: 7 is not among"),
        ("mapper", "seed", None, "seed"),
        ("mapper", "min_confidence", 1.5, "min_confidence"),
        ("report", "sizes", [4], "report.sizes: 4 is not among"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, section, key, value, message):
    changed = document()
    changed[section][key] = value
    path = tmp_path / "params.yaml"
    path.write_text(yaml.safe_dump(changed), encoding="utf-8")
    with pytest.raises(SettingsError, match=message) as raised:
        load_sfm_params(path)
    assert str(path) in str(raised.value)
    with pytest.raises(SettingsError, match=r"gone\.yaml"):
        load_sfm_params(tmp_path / "gone.yaml")
