"""Recordings from arrays and files, and what is refused."""

import numpy as np
import pytest

import catheter

TIME_S = 0.02 * np.arange(50)


def test_arrays_come_back_as_they_went_in():
    inputs = np.stack([np.sin(TIME_S), np.cos(TIME_S)], axis=1)
    recording = catheter.Recording(TIME_S, inputs, TIME_S**2, name="a1", group="monday", extra={"temperature_c": 20 + TIME_S})
    np.testing.assert_array_equal(recording.time_s, TIME_S)
    np.testing.assert_array_equal(recording.inputs, inputs)
    np.testing.assert_array_equal(recording.output, TIME_S**2)
    np.testing.assert_array_equal(recording.extra["temperature_c"], 20 + TIME_S)
    assert (recording.name, recording.group, len(recording)) == ("a1", "monday", 50)
    assert recording.input_columns == ["pressure_bar", "pressure2_bar"] and recording.output_column == "displacement_mm"
    assert recording.sample_period_s == pytest.approx(0.02)
    assert "a1" in repr(recording)


def test_whatever_numpy_takes_is_taken():
    for output in (list(range(50)), np.arange(50, dtype=np.int8), np.arange(100, dtype=np.float32)[::2], np.arange(50).reshape(50, 1)):
        recording = catheter.Recording(list(TIME_S), output, output)
        assert recording.inputs.dtype == np.float64 and recording.inputs.shape == (50,)


def test_a_pause_is_a_gap():
    time_s = TIME_S + 100 * (np.arange(50) >= 20)
    recording = catheter.Recording(time_s, np.sin(9 * time_s), np.cos(9 * time_s))
    assert recording.gaps.tolist() == [20]


def test_a_file_is_read_back_to_the_same_bits(tmp_path):
    recording = catheter.Recording(TIME_S, np.sin(TIME_S), np.cos(TIME_S), extra={"pressure_measured_bar": np.sin(TIME_S) + 0.1})
    recording.save(tmp_path / "deep" / "run.csv")
    (read,) = catheter.read_recordings(tmp_path)
    for one, other in ((read.time_s, TIME_S), (read.inputs, np.sin(TIME_S)), (read.output, np.cos(TIME_S))):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(read.extra["pressure_measured_bar"], np.sin(TIME_S) + 0.1)


def test_foreign_files_are_read_by_their_columns(tmp_path):
    (tmp_path / "run.csv").write_text("t_s,voltage_V,angle_deg\n0,1,2\n0.1,2,3\n0.2,4,5\n")
    (recording,) = catheter.read_recordings([tmp_path / "run.csv"], columns="time=t_s,input=voltage_V,output=angle_deg")
    assert recording.input_columns == ["voltage_V"] and recording.output.tolist() == [2, 3, 5]
    with pytest.raises(catheter.CatheterError, match="run.csv:1"):
        catheter.read_recordings(tmp_path)
    with pytest.raises(catheter.CatheterError, match="cannot be read"):
        catheter.read_recordings(tmp_path / "nothing.csv")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((TIME_S, TIME_S[:-1], TIME_S), "50 times but 49 samples of `inputs`"),
        ((TIME_S, TIME_S, TIME_S[:-1]), "50 times but 49 samples of `output`"),
        ((TIME_S, np.zeros((2, 50)), TIME_S), "50 times but 2 samples"),
        ((TIME_S, np.zeros((50, 2, 2)), TIME_S), "shape"),
        ((TIME_S, np.zeros((50, 0)), TIME_S), "no columns"),
        ((TIME_S, 1.0, TIME_S), "shape"),
        ((TIME_S, TIME_S, np.zeros((50, 2))), "`output` has 2 columns"),
        ((np.zeros(50), TIME_S, TIME_S), "sample 1"),
        ((TIME_S[::-1], TIME_S, TIME_S), "does not come after"),
        ((TIME_S, np.where(TIME_S == 0.1, np.nan, TIME_S), TIME_S), "NaN at sample 5"),
        ((TIME_S, TIME_S, np.where(TIME_S == 0.1, -np.inf, TIME_S)), "-inf at sample 5"),
        (([0.0], [1.0], [1.0]), "at least two"),
        (([], [], []), "at least two"),
        ((TIME_S, ["a"] * 50, TIME_S), "`inputs` is no array of real numbers"),
        ((TIME_S, None, TIME_S), "`inputs`"),
    ],
)
def test_wrong_arrays_are_refused(arguments, message):
    with pytest.raises(catheter.CatheterError, match=message):
        catheter.Recording(*arguments)


def test_wrong_names_are_refused():
    with pytest.raises(catheter.CatheterError, match="unit"):
        catheter.Recording(TIME_S, TIME_S, TIME_S, input_columns="voltage")
    with pytest.raises(catheter.CatheterError, match="1 inputs but 2 names"):
        catheter.Recording(TIME_S, TIME_S, TIME_S, input_columns=["a_V", "b_V"])
    with pytest.raises(catheter.CatheterError, match="none of"):
        catheter.Recording(TIME_S, TIME_S, TIME_S, extra={"colour": TIME_S})
    with pytest.raises(catheter.CatheterError, match="49 samples of `temperature_c`"):
        catheter.Recording(TIME_S, TIME_S, TIME_S, extra={"temperature_c": TIME_S[1:]})


def test_the_error_is_a_value_error():
    assert issubclass(catheter.CatheterError, ValueError)
