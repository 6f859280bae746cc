import pytest

import epiprior


def test_every_public_name_is_there_and_no_other():
    assert [name for name in epiprior.__all__ if not hasattr(epiprior, name)] == []
    with pytest.raises(AttributeError, match="nonsense"):
        epiprior.nonsense  # noqa: B018
