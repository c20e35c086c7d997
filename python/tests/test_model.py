"""Models: simulation against NumPy, files, shapes."""

import numpy as np
import pytest

import catheter
from conftest import THRESHOLDS, WEIGHTS, plant, pressure

PHYSICS = f"""
format_version = 1
kind = "prandtl-ishlinskii"
sample_period_s = 0.02
rest_input = 0.0
thresholds = {THRESHOLDS.tolist()}
weights = {WEIGHTS.tolist()}
weights_95 = []
input_gain = 0.0
constant = 0.25
input = {{ quantity = "pressure", unit = "bar", minimum = 0.0, maximum = 3.0 }}
output = {{ quantity = "displacement", unit = "mm", minimum = 0.0, maximum = 9.0 }}
provenance = {{ program = "by hand", method = "by hand", rmse = 0.0, nrmse = 0.0, samples = 0, data = [] }}
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "model.toml"
    path.write_text(PHYSICS)
    return path


def test_play_operators_are_those_of_numpy(file):
    _, pressure_bar = pressure(1)
    model = catheter.load(file)
    np.testing.assert_allclose(model.simulate(pressure_bar), plant(pressure_bar) + 0.25, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(catheter.simulate(file, pressure_bar), model.simulate(pressure_bar))
    np.testing.assert_array_equal(catheter.simulate(model, pressure_bar[:, None]), model.simulate(pressure_bar))


def test_a_gap_starts_afresh(file):
    _, pressure_bar = pressure(2)
    model = catheter.load(file)
    parts = np.concatenate([model.simulate(pressure_bar[:700]), model.simulate(pressure_bar[700:])])
    np.testing.assert_array_equal(model.simulate(pressure_bar, gaps=[700]), parts)
    for gaps in ([0], [1200], [5, 5], [7, 3]):
        with pytest.raises(catheter.CatheterError, match="gaps"):
            model.simulate(pressure_bar, gaps=gaps)


def test_a_model_says_what_it_is(file):
    model = catheter.load(file)
    assert "Prandtl-Ishlinskii" in model.kind and model.arithmetic == "physics"
    assert (model.input_columns, model.output_column) == (["pressure_bar"], "displacement_mm")
    assert model.input_range == (0.0, 3.0) and model.parameters > 0
    # Play operators alone do not depend on the rate.
    assert model.sample_period_s is None


def test_wrong_shapes_are_refused(file):
    model = catheter.load(file)
    for inputs, message in ((np.zeros((5, 2)), "2 column"), (np.zeros((5, 2, 2)), "shape"), ([np.nan], "NaN at sample 0"), ([], "no sample")):
        with pytest.raises(catheter.CatheterError, match=message):
            model.simulate(inputs)


def test_a_recording_of_other_units_is_refused(file):
    time_s, pressure_bar = pressure(3)
    recording = catheter.Recording(time_s, pressure_bar, pressure_bar, input_columns="voltage_V")
    with pytest.raises(catheter.CatheterError, match="voltage in V"):
        catheter.load(file).predict(recording)


def test_what_is_no_model_is_refused(tmp_path, file):
    for name, content in (("text", b"hello"), ("broken.toml", b"format_version = "), ("empty.blob", b""), ("x.safetensors", b"{}")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(catheter.CatheterError, match=name):
            catheter.load(tmp_path / name)
    with pytest.raises(catheter.CatheterError, match="cannot be read"):
        catheter.load(tmp_path / "nothing")
    with pytest.raises(catheter.CatheterError, match="folder"):
        catheter.load(tmp_path)
    with pytest.raises(TypeError, match="path of a model"):
        catheter.simulate(3, [1.0])
    with pytest.raises(catheter.CatheterError, match="is a folder"):
        catheter.load(file).save(tmp_path)


def test_a_saved_model_is_the_same_model(file, tmp_path):
    _, pressure_bar = pressure(4)
    model = catheter.load(file)
    model.save(tmp_path / "copy")
    np.testing.assert_array_equal(catheter.simulate(tmp_path / "copy", pressure_bar), model.simulate(pressure_bar))
