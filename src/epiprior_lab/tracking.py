"""MLflow, in ``mlflow.db`` and ``mlartifacts/`` at the root of the repository, for people to look at.

No stage reads it, and where tracking fails the stage logs a warning and goes on. No other module imports mlflow.
"""

import contextlib
import importlib.metadata
import logging
import math
import os
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from epiprior.errors import EpipriorError
from epiprior.ranking.models import OPTIONAL, TARGETS
from epiprior.types import Float32Array

_LOG = logging.getLogger(__name__)
# Without it MLflow's page takes the runs for those of a language model, and opens on empty charts of traces.
_SHOWN_AS_TRAINING = ("mlflow.experimentKind", "custom_model_development")


class TrackingError(EpipriorError, RuntimeError):
    """An explicit command on MLflow cannot be carried out; the message says why."""


@dataclass(frozen=True, kw_only=True)
class Run:
    """One run of MLflow, with a nested run per fold.

    The experiment is named below ``epiprior/``; `promote` looks for the tags ``preset`` and ``exported``. Metrics, of
    all and of each fold, are left out where not finite. Figures are by file name; `onnx` is a model to log, if any, and
    `rows`, shape (M, C), are a few rows to show what it takes.
    """

    experiment: str
    name: str
    tags: Mapping[str, str]
    parameters: Mapping[str, Any]
    metrics: Mapping[str, float]
    folds: Sequence[Mapping[str, float]]
    figures: Mapping[str, Figure]
    onnx: bytes | None
    rows: Float32Array


def repository_root() -> Path:
    """Return ``DVC_ROOT``, or the nearest folder upwards that holds ``dvc.yaml``; TrackingError if there is none."""
    if named := os.environ.get("DVC_ROOT"):
        return Path(named)
    here = Path.cwd()
    for folder in (here, *here.parents):
        if (folder / "dvc.yaml").is_file():
            return folder
    raise TrackingError(f"no dvc.yaml in {here} or above it, and DVC_ROOT is not set")


def track(runs: Sequence[Run], *, root: Path | None = None) -> bool:
    """Log runs at `root`, by default `repository_root`; False, a warning and no error if something failed."""
    try:
        root = root or repository_root()
        with _mlflow(root) as client:
            for run in runs:
                _log(client, root, run)
    except Exception as error:  # noqa: BLE001 - whatever fails in tracking must not fail the study
        _LOG.warning("MLflow: not everything was tracked: %s: %s", type(error).__name__, error)
        return False
    return True


def promote(preset: str, *, root: Path | None = None) -> dict[str, str]:
    """Register the newest exported classifiers of a preset as ``champion``; return versions by registered name.

    TrackingError if no finished run of an exported family is found, or MLflow fails.
    """
    root = root or repository_root()
    if not (root / "mlflow.db").is_file():
        raise TrackingError(f"{root / 'mlflow.db'}: no such file; run the stage train first")
    with _mlflow(root) as client:
        runs = {target: _newest_exported(client, target, preset) for target in TARGETS}
        runs = {target: run for target, run in runs.items() if run is not None}
        try:
            return dict(_register(client, f"epiprior-{preset}-{target}", run) for target, run in runs.items())
        except Exception as error:
            raise TrackingError(f"MLflow cannot register the models of preset {preset!r}: {error}") from error


def _register(client: Any, name: str, run: Any) -> tuple[str, str]:
    """Make the run's model the newest version of a registered model, and its champion."""
    if not client.search_registered_models(f"name = '{name}'"):
        client.create_registered_model(name)
    (model,) = run.outputs.model_outputs
    source = f"models:/{model.model_id}"
    version = client.create_model_version(name, source, run_id=run.info.run_id, model_id=model.model_id).version
    client.set_registered_model_alias(name, "champion", version)
    return name, str(version)


def _newest_exported(client: Any, target: str, preset: str) -> Any:
    """Return the newest run; None where there is none of a target that not every preset has."""
    experiment = client.get_experiment_by_name(f"epiprior/{target}")
    runs = experiment and client.search_runs(
        [experiment.experiment_id],
        f"tags.preset = '{preset}' and tags.exported = 'true' and attributes.status = 'FINISHED'",
        order_by=["attributes.start_time DESC"],
        max_results=1,
    )
    if not runs and target in OPTIONAL:
        return None
    if not runs:
        raise TrackingError(f"no finished run of an exported {target} classifier of preset {preset!r}")
    return runs[0]


@contextlib.contextmanager
def _mlflow(root: Path) -> Iterator[Any]:
    """Yield a client of the database at `root`; MLflow's global state is put back afterwards."""
    os.environ["MLFLOW_DISABLE_TELEMETRY"] = "true"  # read on import: nothing is reported to anyone
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # deprecations between MLflow and its own dependencies
        import mlflow

        for name in ("mlflow", "alembic"):
            logging.getLogger(name).setLevel(logging.WARNING)
        uri = f"sqlite:///{(root / 'mlflow.db').resolve().as_posix()}"
        state: Any = mlflow  # untyped in part
        before = state.get_tracking_uri() if state.is_tracking_uri_set() else None
        state.set_tracking_uri(uri)
        try:
            yield state.MlflowClient(tracking_uri=uri, registry_uri=uri)
        finally:
            state.set_tracking_uri(before)


def _log(client: Any, root: Path, run: Run) -> None:
    name = f"epiprior/{run.experiment}"
    found = client.get_experiment_by_name(name)
    location = (root / "mlartifacts" / run.experiment).resolve().as_uri()
    experiment = found.experiment_id if found else client.create_experiment(name, artifact_location=location)
    client.set_experiment_tag(experiment, *_SHOWN_AS_TRAINING)
    parent = client.create_run(experiment, run_name=run.name, tags=dict(run.tags)).info.run_id
    _log_batch(client, parent, run.metrics, {**run.tags, **run.parameters})
    for number, metrics in enumerate(run.folds):
        tags = {"mlflow.parentRunId": parent, "fold": str(number)}
        fold = client.create_run(experiment, run_name=f"{run.name}-fold-{number}", tags=tags).info.run_id
        _log_batch(client, fold, metrics, {})
        client.set_terminated(fold)
    for file, figure in run.figures.items():
        client.log_figure(parent, figure, file)
    if run.onnx is not None:
        _log_model(parent, run.onnx, run.rows)
    client.set_terminated(parent)


def _log_batch(client: Any, run: str, metrics: Mapping[str, float], parameters: Mapping[str, Any]) -> None:
    from mlflow.entities import Metric, Param

    now = int(time.time() * 1000)
    client.log_batch(
        run,
        metrics=[Metric(key, value, now, 0) for key, value in metrics.items() if math.isfinite(value)],
        params=[Param(key, str(value)) for key, value in parameters.items()],
    )


def _log_model(run: str, graph: bytes, rows: Float32Array) -> None:
    """Log an ONNX model with its signature and an example."""
    import mlflow
    import onnx

    needed = ("onnx", "onnxruntime", "numpy")
    with mlflow.start_run(run_id=run, log_system_metrics=False):
        mlflow.onnx.log_model(
            onnx.load_from_string(graph),
            name="model",
            signature=mlflow.models.infer_signature({"rows": rows}, {"probability": rows[:, 0]}),  # of the same type
            input_example={"rows": rows},
            onnx_execution_providers=["CPUExecutionProvider"],
            pip_requirements=[f"{name}=={importlib.metadata.version(name)}" for name in needed],
        )
