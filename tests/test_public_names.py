import subprocess
import sys

import pytest

import epiprior


def test_every_public_name_is_there():
    assert [name for name in epiprior.__all__ if not hasattr(epiprior, name)] == []


def test_names_stay_functions_after_everything_is_imported():
    # A module of the package that has a public function's name would hide it.
    functions = (
        "epiprior.standard_matches, epiprior.rank_matches, epiprior.list_estimators, epiprior.estimate_fundamental"
    )
    code = f"import epiprior, epiprior.cli, epiprior.estimators.run; print(all(map(callable, ({functions}))))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "True\n"


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="nonsense"):
        epiprior.nonsense  # noqa: B018
