import numpy as np
import onnx
import onnxruntime
import pytest

from epiprior_lab.training.families import fit, to_onnx
from grouped_rows import make_rows

pytestmark = pytest.mark.slow
ROWS = make_rows()


def exported(fitted, rows):
    session = onnxruntime.InferenceSession(to_onnx(fitted), providers=["CPUExecutionProvider"])
    return session.run(None, {"rows": rows})[0]


def splits_of(fitted):
    """Return (column, threshold) of every split of an exported ensemble of trees."""
    node = onnx.load_from_string(to_onnx(fitted)).graph.node[0]
    found = {item.name: onnx.helper.get_attribute_value(item) for item in node.attribute}
    splits = zip(found["nodes_featureids"], found["nodes_values"], found["nodes_modes"], strict=True)
    return [(column, np.float32(value)) for column, value, mode in splits if mode == b"BRANCH_LEQ"]


def rows_on_thresholds(fitted):
    """Return rows, each with one value exactly on a threshold, or one float32 above or below it."""
    splits = splits_of(fitted)
    rng = np.random.default_rng(0)
    rows = ROWS.rows[rng.integers(0, len(ROWS.rows), 4000)].copy()
    for i, split in enumerate(rng.integers(0, len(splits), 4000)):
        column, value = splits[split]
        rows[i, column] = (value, np.nextafter(value, np.float32(9)), np.nextafter(value, np.float32(-9)))[i % 3]
    return rows


@pytest.mark.parametrize("family", ["tree", "random-forest", "lightgbm"])
def test_a_graph_predicts_what_was_fitted_and_carries_nothing_that_changes(family):
    fitted = fit(family, ROWS.rows, ROWS.labels, seed=1, max_rows={"random-forest": 600}.get(family))
    others = np.random.default_rng(3).normal(scale=10, size=(500, 5)).astype(np.float32)
    for rows in (ROWS.rows, others, rows_on_thresholds(fitted)):
        assert np.abs(exported(fitted, rows) - fitted.probability(rows)).max() < 1e-6
    model = onnx.load_from_string(to_onnx(fitted))
    assert (model.producer_name, model.producer_version, model.doc_string) == ("epiprior", "", "")
    assert model.graph.name == "epiprior"
    assert not model.metadata_props
    assert [item.name for item in model.graph.output] == ["probability"]
