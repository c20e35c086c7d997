"""Blobs and C source from Python."""

import ctypes
import hashlib
import shutil
import subprocess

import numpy as np
import pytest

import catheter
from conftest import plant, pressure


@pytest.fixture(scope="module")
def blob(fitted, recordings, tmp_path_factory):
    path = tmp_path_factory.mktemp("export") / "model.blob"
    return path, catheter.export(fitted.model, recordings, path)


def test_a_blob_runs_as_the_model_does(fitted, blob):
    path, report = blob
    assert report["bytes"] == path.stat().st_size
    assert report["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    assert report["rmse_f32_vs_fixed"] < 1e-3 and report["output_unit"] == "mm"
    _, pressure_bar = pressure(60)
    assert np.abs(catheter.simulate(path, pressure_bar) - plant(pressure_bar)).max() < 1e-3


def test_a_saved_blob_is_the_same_file(blob, tmp_path):
    catheter.load(blob[0]).save(tmp_path / "copy.blob")
    assert (tmp_path / "copy.blob").read_bytes() == blob[0].read_bytes()


def test_c_source_has_the_bits_of_the_blob(fitted, recordings, blob, tmp_path):
    report = catheter.export_c(blob[0], tmp_path / "model.c")
    assert sorted(report["c"]) == [str(tmp_path / "model.c"), str(tmp_path / "model.h")]
    catheter.export_c(fitted.model, tmp_path / "again.c", recordings)
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("there is no C compiler `cc`")
    library = tmp_path / "model.so"
    flags = ["-O2", "-ffp-contract=off", "-shared", "-fPIC", "-DMODEL_SELF_TEST"]
    subprocess.run([compiler, *flags, str(tmp_path / "model.c"), "-lm", "-o", str(library)], check=True)
    model = ctypes.CDLL(str(library))
    assert model.model_self_test() == 0
    model.model_step.restype, model.model_step.argtypes = ctypes.c_float, [ctypes.c_void_p, ctypes.c_float]
    # Larger than any state.
    state = ctypes.create_string_buffer(1 << 20)
    model.model_reset(state)
    _, pressure_bar = pressure(61)
    in_c = [model.model_step(state, value) for value in pressure_bar]
    np.testing.assert_array_equal(in_c, catheter.simulate(blob[0], pressure_bar))


def test_what_has_no_form_on_the_chip_is_refused(fitted, recordings, blob, tmp_path):
    off_chip = [rung["name"] for rung in fitted.ladder if not rung["on_chip"]]
    if off_chip:
        with pytest.raises(catheter.CatheterError, match="no form"):
            catheter.export(fitted.rung(off_chip[0]), recordings, tmp_path / "x.blob")
    with pytest.raises(catheter.CatheterError, match="already a blob"):
        catheter.export(blob[0], recordings, tmp_path / "x.blob")
    with pytest.raises(catheter.CatheterError, match="calibration"):
        catheter.export(fitted.model, [], tmp_path / "x.blob")
    with pytest.raises(catheter.CatheterError, match="calibration"):
        catheter.export_c(fitted.model, tmp_path / "x.c")
    with pytest.raises(catheter.CatheterError, match="ends in .c"):
        catheter.export_c(blob[0], tmp_path / "x.txt")
    with pytest.raises(catheter.CatheterError, match="is a folder"):
        catheter.export(fitted.model, recordings, tmp_path)
    other = catheter.Recording(recordings[0].time_s, recordings[0].inputs, recordings[0].output, input_columns="voltage_V")
    with pytest.raises(catheter.CatheterError, match="voltage in V"):
        catheter.export(fitted.model, other, tmp_path / "x.blob")
    assert not (tmp_path / "x.blob").exists()
