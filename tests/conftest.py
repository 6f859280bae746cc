"""Settings of every test run: nothing phones home, figures need no screen; a model that is made by hand."""

import os

import pytest

os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.setdefault("DVC_NO_ANALYTICS", "1")
os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
os.environ.setdefault("DO_NOT_TRACK", "1")


@pytest.fixture(scope="session")
def model_folder(tmp_path_factory):
    from tiny_model import make_model

    return make_model(tmp_path_factory.mktemp("models") / "default")


@pytest.fixture(scope="session")
def model(model_folder):
    from epiprior.ranking.models import load_model

    return load_model(model_folder)


@pytest.fixture
def tiny_model(model, monkeypatch):
    """Let every ranking take the model that is made by hand."""
    monkeypatch.setattr("epiprior.rank.load_model", lambda name: model)
