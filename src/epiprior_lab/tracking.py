"""MLflow: what the training measured, for people to look at. The only module that imports mlflow.

The database ``mlflow.db`` and the artifacts ``mlartifacts/`` lie at the root of the repository. They are
write-only: no stage reads them, and where tracking fails the stage says so and goes on.
"""

from __future__ import annotations

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
from epiprior.ranking.models import TARGETS
from epiprior.types import BoolArray, Float32Array, FloatArray
from epiprior_lab.training.calibration import reliability
from epiprior_lab.training.cross_validation import CrossValidation
from epiprior_lab.training.metrics import precision_recall

ALIAS = "champion"
_LOG = logging.getLogger(__name__)
_EXAMPLE_ROWS = 5
_CURVE_POINTS = 500
# Without it MLflow's page takes the runs for those of a language model, and opens on empty charts of traces.
_SHOWN_AS_TRAINING = ("mlflow.experimentKind", "custom_model_development")


class TrackingError(EpipriorError, RuntimeError):
    """An explicit command on MLflow cannot be carried out; the message says why."""


@dataclass(frozen=True, kw_only=True)
class TrackedFamily:
    """All that is logged of one family of classifiers for one target and preset.

    Parameters
    ----------
    target, preset : str
        Which classifier of which model.
    exported : bool
        Whether this family is the one that the preset ships.
    grouped : CrossValidation
        By scene.
    ungrouped : CrossValidation or None
        By row; of an exported family only.
    labels : ndarray, shape (N,), bool
        Labels of their rows.
    importances : ndarray, shape (C,), float64, or None
        Of the final refit.
    onnx : bytes
        The final refit.
    example : ndarray, shape (M, C), float32
        Rows to show what it takes.
    parameters : mapping
        Seed, folds, caps, hash of the training data: whatever describes the run.
    """

    target: str
    preset: str
    exported: bool
    grouped: CrossValidation
    ungrouped: CrossValidation | None
    labels: BoolArray
    importances: FloatArray | None
    onnx: bytes
    example: Float32Array
    parameters: Mapping[str, Any]


def repository_root() -> Path:
    """Return the root: ``DVC_ROOT``, or the nearest folder upwards that holds ``dvc.yaml``.

    Raises
    ------
    TrackingError
        If there is none.
    """
    named = os.environ.get("DVC_ROOT")
    if named:
        return Path(named)
    here = Path.cwd()
    for folder in (here, *here.parents):
        if (folder / "dvc.yaml").is_file():
            return folder
    raise TrackingError(f"no dvc.yaml in {here} or above it, and DVC_ROOT is not set")


def track(families: Sequence[TrackedFamily], *, root: Path | None = None) -> bool:
    """Log one parent run per family, with a nested run per fold.

    Parameters
    ----------
    families : sequence of TrackedFamily
        May be empty.
    root : Path, optional
        Where the database lies; by default `repository_root`.

    Returns
    -------
    bool
        False if something failed. That was logged as a warning; nothing is raised.
    """
    try:
        with _mlflow(root or repository_root()) as client:
            for family in families:
                _log_family(client, root or repository_root(), family)
    except Exception as error:  # noqa: BLE001 - whatever fails in tracking must not fail the study
        _LOG.warning("MLflow: not everything was tracked: %s: %s", type(error).__name__, error)
        return False
    return True


def promote(preset: str, *, root: Path | None = None) -> dict[str, str]:
    """Register the newest exported classifiers of a preset and give them the alias ``champion``.

    Parameters
    ----------
    preset : str
        Name of the preset.
    root : Path, optional
        Where the database lies; by default `repository_root`.

    Returns
    -------
    dict
        Registered name -> version, for both targets.

    Raises
    ------
    TrackingError
        If no finished run of an exported family is found, or MLflow fails.
    """
    root = root or repository_root()
    if not (root / "mlflow.db").is_file():
        raise TrackingError(f"{root / 'mlflow.db'}: no such file; run the stage train first")
    with _mlflow(root) as client:
        runs = {target: _newest_exported(client, target, preset) for target in TARGETS}
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
    client.set_registered_model_alias(name, ALIAS, version)
    return name, str(version)


def _newest_exported(client: Any, target: str, preset: str) -> Any:
    experiment = client.get_experiment_by_name(_experiment_name(target))
    runs = client.search_runs(
        [experiment.experiment_id] if experiment else ["none"],
        f"tags.preset = '{preset}' and tags.exported = 'true' and attributes.status = 'FINISHED'",
        order_by=["attributes.start_time DESC"],
        max_results=1,
    )
    if not runs:
        raise TrackingError(f"no finished run of an exported {target} classifier of preset {preset!r}")
    return runs[0]


# Without it MLflow's page takes the runs for those of a language model, and opens on empty charts of traces.
_SHOWN_AS_TRAINING = ("mlflow.experimentKind", "custom_model_development")


def _experiment_name(target: str) -> str:
    return f"epiprior/{target}"


@contextlib.contextmanager
def _mlflow(root: Path) -> Iterator[Any]:
    """Yield a client of the database at `root`; MLflow's global state is put back afterwards."""
    # Read on import: nothing is reported to anyone.
    os.environ["MLFLOW_DISABLE_TELEMETRY"] = "true"
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


def _log_family(client: Any, root: Path, family: TrackedFamily) -> None:
    """Log the parent run: parameters, metrics, figures, model; and its folds."""
    name = _experiment_name(family.target)
    found = client.get_experiment_by_name(name)
    location = (root / "mlartifacts" / family.target).resolve().as_uri()
    experiment = found.experiment_id if found else client.create_experiment(name, artifact_location=location)
    client.set_experiment_tag(experiment, *_SHOWN_AS_TRAINING)
    tags = {
        "preset": family.preset,
        "target": family.target,
        "family": family.grouped.family,
        "exported": str(family.exported).lower(),
    }
    run_name = f"{family.preset}-{family.grouped.family}"
    run = client.create_run(experiment, run_name=run_name, tags=tags).info.run_id
    deviations = {f"{key}.deviation": value for key, value in family.grouped.deviations().items()}
    leaky = {} if family.ungrouped is None else family.ungrouped.metrics
    others = {f"ungrouped.{key}": value for key, value in leaky.items()}
    others |= {f"calibrated.{key}": value for key, value in family.grouped.calibrated_metrics.items()}
    seconds = family.grouped.seconds_per_10000_rows
    timing = {"seconds_per_10000_rows": sum(seconds) / len(seconds)}
    parameters = {**tags, **family.parameters, "columns": ", ".join(family.grouped.columns)}
    _log_batch(client, run, {**family.grouped.metrics, **deviations, **others, **timing}, parameters)
    for number, metrics in enumerate(family.grouped.fold_metrics):
        fold = client.create_run(
            experiment,
            run_name=f"{family.preset}-{family.grouped.family}-fold-{number}",
            tags={"mlflow.parentRunId": run, "fold": str(number)},
        ).info.run_id
        _log_batch(client, fold, {**metrics, "seconds_per_10000_rows": seconds[number]}, {})
        client.set_terminated(fold)
    for file, figure in _figures(family).items():
        client.log_figure(run, figure, file)
    _log_model(run, family)
    client.set_terminated(run)


def _log_batch(client: Any, run: str, metrics: Mapping[str, float], parameters: Mapping[str, Any]) -> None:
    from mlflow.entities import Metric, Param

    now = int(time.time() * 1000)
    client.log_batch(
        run,
        metrics=[Metric(key, value, now, 0) for key, value in metrics.items() if math.isfinite(value)],
        params=[Param(key, str(value)) for key, value in parameters.items()],
    )


def _log_model(run: str, family: TrackedFamily) -> None:
    """Log the final refit as an ONNX model with signature and example."""
    import mlflow
    import onnx

    example = {"rows": family.example[:_EXAMPLE_ROWS]}
    output = {"probability": family.grouped.probability[:_EXAMPLE_ROWS].astype("float32")}
    needed = ("onnx", "onnxruntime", "numpy")
    requirements = [f"{name}=={importlib.metadata.version(name)}" for name in needed]
    with mlflow.start_run(run_id=run, log_system_metrics=False):
        mlflow.onnx.log_model(
            onnx.load_from_string(family.onnx),
            name="model",
            signature=mlflow.models.infer_signature(example, output),
            input_example=example,
            onnx_execution_providers=["CPUExecutionProvider"],
            pip_requirements=requirements,
        )


def _figures(family: TrackedFamily) -> dict[str, Figure]:
    """Return the curves and importances, by file name."""
    figures = {
        "precision_recall.png": _precision_recall_figure(family),
        "reliability.png": _reliability_figure(family),
    }
    if family.importances is not None:
        figures["importances.png"] = _importances_figure(family.grouped.columns, family.importances)
    return figures


def _precision_recall_figure(family: TrackedFamily) -> Figure:
    figure = Figure(figsize=(5, 4), layout="constrained")
    axes = figure.add_subplot(xlabel="recall", ylabel="precision", xlim=(0, 1), ylim=(0, 1))
    for label, item in (("grouped by scene", family.grouped), ("ungrouped", family.ungrouped)):
        if item is None:
            continue
        precision, recall, _ = precision_recall(item.probability, family.labels)
        step = max(1, len(precision) // _CURVE_POINTS)
        axes.plot(recall[::step], precision[::step], label=label)
    axes.legend()
    return figure


def _reliability_figure(family: TrackedFamily) -> Figure:
    figure = Figure(figsize=(5, 4), layout="constrained")
    axes = figure.add_subplot(xlabel="predicted probability", ylabel="share of right ones")
    curve = reliability(family.grouped.probability, family.labels)
    axes.plot([0, 1], [0, 1], color="0.7", linewidth=1)
    axes.plot(curve.predicted, curve.observed, marker="o")
    return figure


def _importances_figure(columns: tuple[str, ...], importances: FloatArray) -> Figure:
    figure = Figure(figsize=(6, 0.3 * len(columns) + 1), layout="constrained")
    axes = figure.add_subplot(xlabel="importance")
    order = importances.argsort()
    axes.barh([columns[i] for i in order], importances[order])
    return figure
