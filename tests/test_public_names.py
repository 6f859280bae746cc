import subprocess
import sys

import pytest

import epiprior


@pytest.mark.parametrize("name", epiprior.__all__)
def test_every_public_name_is_there(name):
    assert getattr(epiprior, name) is not None


def test_names_stay_functions_after_everything_is_imported():
    # A module of the package that has a public function's name would hide it.
    code = "import epiprior, epiprior.cli, epiprior.estimators.run; print(all(map(callable, ("
    code += (
        "epiprior.standard_matches, epiprior.rank_matches, epiprior.list_estimators, epiprior.estimate_fundamental))))"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "True\n"


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="nonsense"):
        epiprior.nonsense  # noqa: B018
