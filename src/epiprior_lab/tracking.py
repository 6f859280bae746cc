"""MLflow, in ``mlflow.db`` and ``mlartifacts/`` at the root of the repository, for people to look at.

No stage reads it, and where tracking fails the stage logs a warning and goes on. No other module imports mlflow.
"""

import contextlib
import importlib.metadata
import logging
import math
import os
import warnings
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from sklearn.metrics import precision_recall_curve

from epiprior.errors import EpipriorError
from epiprior.ranking.models import OPTIONAL, TARGETS
from epiprior.types import Float32Array
from epiprior_lab.measures import calibration_bins
from epiprior_lab.training.comparison import Comparison

_LOG = logging.getLogger(__name__)
_EXAMPLE_ROWS = 5
_CURVE_POINTS = 500
# Without it MLflow's page takes the runs for those of a language model, and opens on empty charts of traces.
_SHOWN_AS_TRAINING = ("mlflow.experimentKind", "custom_model_development")


class TrackingError(EpipriorError, RuntimeError):
    """An explicit command on MLflow cannot be carried out; the message says why."""


def track(comparisons: Iterable[Comparison], settings: Mapping[str, Any], *, root: Path | None = None) -> None:
    """Log a run per family, with one per fold below it, and the model of the family that is exported.

    Each target is an experiment below ``epiprior/``; `settings` are the parameters of the training; metrics are left
    out where not finite. All goes to `root`, by default DVC's or this folder; if it fails, there is a warning.
    """
    root = root or Path(os.environ.get("DVC_ROOT", ""))
    try:
        with _mlflow(root) as mlflow:
            for comparison in comparisons:
                data, columns = comparison.data, ", ".join(comparison.data.columns)
                described = {"rows": len(data.rows), "pairs": len(data.pairs), "columns": columns}
                for family in comparison.grouped:
                    _log(mlflow, root, comparison, family, {**settings, **described, "data_sha256": data.digest()})
    except Exception as error:  # noqa: BLE001 - whatever fails in tracking must not fail the study
        _LOG.warning("MLflow: not everything was tracked: %s: %s", type(error).__name__, error)


def promote(preset: str, *, root: Path | None = None) -> dict[str, str]:
    """Register the newest exported classifiers of a preset as ``champion``; return versions by registered name.

    TrackingError if no finished run of an exported family is found, or MLflow fails.
    """
    root = root or Path(os.environ.get("DVC_ROOT", ""))
    if not (root / "mlflow.db").is_file():
        raise TrackingError(f"{root / 'mlflow.db'}: no such file; run the stage train first")
    with _mlflow(root) as mlflow:
        runs = {target: _newest_exported(mlflow, target, preset) for target in TARGETS}
        versions = {}
        try:
            for target, run in runs.items():
                if run is not None:
                    name, (model,) = f"epiprior-{preset}-{target}", run.outputs.model_outputs
                    version = mlflow.register_model(f"models:/{model.model_id}", name).version
                    mlflow.MlflowClient().set_registered_model_alias(name, "champion", version)
                    versions[name] = str(version)
        except Exception as error:
            raise TrackingError(f"MLflow cannot register the models of preset {preset!r}: {error}") from error
    return versions


def _newest_exported(mlflow: Any, target: str, preset: str) -> Any:
    """Return the newest run; None where there is none of a target that not every preset has."""
    runs = mlflow.search_runs(
        experiment_names=[f"epiprior/{target}"],
        filter_string=f"tags.preset = '{preset}' and tags.exported = 'true' and attributes.status = 'FINISHED'",
        order_by=["attributes.start_time DESC"],
        max_results=1,
        output_format="list",
    )
    if not runs and target not in OPTIONAL:
        raise TrackingError(f"no finished run of an exported {target} classifier of preset {preset!r}")
    return runs[0] if runs else None


@contextlib.contextmanager
def _mlflow(root: Path) -> Iterator[Any]:
    """Yield mlflow with the database at `root`; its global state is put back afterwards."""
    os.environ["MLFLOW_DISABLE_TELEMETRY"] = "true"  # read on import: nothing is reported to anyone
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # deprecations between MLflow and its own dependencies
        import mlflow as module

        mlflow: Any = module  # untyped in part
        for name in ("mlflow", "alembic"):
            logging.getLogger(name).setLevel(logging.WARNING)
        before = mlflow.get_tracking_uri() if mlflow.is_tracking_uri_set() else None
        mlflow.set_tracking_uri(f"sqlite:///{(root / 'mlflow.db').resolve().as_posix()}")
        try:
            yield mlflow
        finally:
            mlflow.set_tracking_uri(before)


def _log(mlflow: Any, root: Path, comparison: Comparison, family: str, parameters: Mapping[str, Any]) -> None:
    """Log the run of one family."""
    data, grouped, exported = comparison.data, comparison.grouped[family], family == comparison.exported
    seconds = grouped.seconds_per_10000_rows
    metrics = {**grouped.metrics, "seconds_per_10000_rows": sum(seconds) / len(seconds)}
    metrics |= {f"{key}.deviation": value for key, value in grouped.deviations().items()}
    metrics |= {f"calibrated.{key}": value for key, value in grouped.calibrated_metrics.items()}
    if exported:
        metrics |= {f"ungrouped.{key}": value for key, value in comparison.ungrouped.metrics.items()}
    found = mlflow.get_experiment_by_name(f"epiprior/{data.target}")
    location = {"artifact_location": (root / "mlartifacts" / data.target).resolve().as_uri()}
    experiment = found.experiment_id if found else mlflow.create_experiment(f"epiprior/{data.target}", **location)
    mlflow.MlflowClient().set_experiment_tag(experiment, *_SHOWN_AS_TRAINING)
    name, how = f"{comparison.model}-{family}", {"experiment_id": experiment, "log_system_metrics": False}
    tags = {"preset": comparison.model, "target": data.target, "family": family, "exported": str(exported).lower()}
    with mlflow.start_run(run_name=name, tags=tags, **how):
        mlflow.log_params({**tags, **parameters})
        mlflow.log_metrics(_finite(metrics))
        for number, (fold, time) in enumerate(zip(grouped.fold_metrics, seconds, strict=True)):
            with mlflow.start_run(run_name=f"{name}-fold-{number}", nested=True, tags={"fold": str(number)}, **how):
                mlflow.log_metrics(_finite({**fold, "seconds_per_10000_rows": time}))
        for file, figure in _figures(comparison, family).items():
            mlflow.log_figure(figure, file)
        if exported:
            _log_model(mlflow, comparison.refit.onnx, data.rows[:_EXAMPLE_ROWS])


def _finite(metrics: Mapping[str, float]) -> dict[str, float]:
    return {name: value for name, value in metrics.items() if math.isfinite(value)}


def _log_model(mlflow: Any, graph: bytes, rows: Float32Array) -> None:
    """Log a model with its signature and a few rows to show what it takes."""
    import onnx

    needed = ("onnx", "onnxruntime", "numpy")
    mlflow.onnx.log_model(
        onnx.load_from_string(graph),
        name="model",
        signature=mlflow.models.infer_signature({"rows": rows}, {"probability": rows[:, 0]}),  # of the same type
        input_example={"rows": rows},
        onnx_execution_providers=["CPUExecutionProvider"],
        pip_requirements=[f"{name}=={importlib.metadata.version(name)}" for name in needed],
    )


def _figures(comparison: Comparison, family: str) -> dict[str, Figure]:
    """Draw the curves of one family by file name; for the exported one also its importances."""
    data, grouped, exported = comparison.data, comparison.grouped[family], family == comparison.exported
    curves = {"grouped by scene": grouped.probability}
    if exported:
        curves["ungrouped"] = comparison.ungrouped.probability
    precision_recall, axes = _figure("recall", "precision")
    axes.set(xlim=(0, 1), ylim=(0, 1))
    for label, probability in curves.items():
        precision, recall, _ = precision_recall_curve(data.labels, probability)
        step = max(1, len(precision) // _CURVE_POINTS)
        axes.plot(recall[::step], precision[::step], label=label)
    axes.legend()
    reliability, axes = _figure("predicted probability", "share of right ones")
    axes.plot([0, 1], [0, 1], color="0.7", linewidth=1)
    axes.plot(*calibration_bins(grouped.probability, data.labels).curve[:, :2].T, marker="o")
    figures = {"precision_recall.png": precision_recall, "reliability.png": reliability}
    if exported:
        importances, axes = _figure("importance", "")
        importances.set_figheight(0.3 * len(data.columns) + 1)
        order = np.argsort(comparison.refit.importances)
        axes.barh([data.columns[i] for i in order], comparison.refit.importances[order])
        figures["importances.png"] = importances
    return figures


def _figure(x: str, y: str) -> tuple[Figure, Any]:
    figure = Figure(figsize=(5, 4), layout="constrained")
    return figure, figure.add_subplot(xlabel=x, ylabel=y)
