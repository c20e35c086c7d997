"""A fit from arrays: the ladder, the model, the folder it leaves, and the same figures as the command."""

import json
import threading
import time

import numpy as np
import pytest

import catheter
from conftest import PERIOD_S, plant, pressure, recorded


def test_the_chosen_model_predicts_a_new_input_as_the_plant_does(fitted):
    _, pressure_bar = pressure(99)
    assert np.abs(fitted.model.simulate(pressure_bar) - plant(pressure_bar)).max() < 1e-6


def test_the_ladder_names_every_rung_with_its_error_and_interval(fitted):
    names = [rung["name"] for rung in fitted.ladder]
    assert fitted.chosen in names and len(set(names)) == len(names) >= 4
    for rung in fitted.ladder:
        low, high = rung["cv_interval"]
        assert 0 <= low <= high and low <= rung["cv_rmse"] <= high
        assert rung["parameters"] > 0 and rung["step_instructions"] >= 0
    assert fitted.unit == "mm" and fitted.output_range > 1
    assert fitted.splits["kind"] == "recordings" and fitted.noise >= 0
    assert fitted.repeatability is None or fitted.repeatability >= 0


def test_every_rung_gives_a_model_and_others_are_refused(fitted):
    _, pressure_bar = pressure(98, 100)
    for rung in fitted.ladder:
        assert fitted.rung(rung["name"]).simulate(pressure_bar).shape == (100,)
    with pytest.raises(KeyError, match="there is no rung"):
        fitted.rung("magic")


def test_the_promise_holds_on_noisy_data():
    fit = catheter.fit([recorded(seed, noise_mm=0.02) for seed in range(6)])
    _, pressure_bar = pressure(97)
    noise = 0.02 * np.random.default_rng(7).standard_normal(len(pressure_bar))
    error = np.sqrt(np.mean((fit.model.simulate(pressure_bar) - plant(pressure_bar) - noise) ** 2))
    chosen = next(rung for rung in fit.ladder if rung["name"] == fit.chosen)
    low, high = chosen["cv_interval"]
    assert low <= error <= high
    assert error < 0.024


def test_equal_seeds_give_equal_models(recordings, fitted):
    again = catheter.fit(recordings, threads=1)
    _, pressure_bar = pressure(96)
    np.testing.assert_array_equal(again.model.simulate(pressure_bar), fitted.model.simulate(pressure_bar))


def test_a_second_input_is_used():
    def one(seed):
        time_s, pressure_bar = pressure(seed)
        other = np.sin(0.7 * time_s + seed)
        return catheter.Recording(time_s, np.stack([pressure_bar, other], axis=1), plant(pressure_bar) - 0.4 * other, name=f"two{seed}")

    fit = catheter.fit([one(seed) for seed in range(4)])
    new = one(50)
    assert fit.model.input_columns == ["pressure_bar", "pressure2_bar"]
    assert np.sqrt(np.mean((fit.model.simulate(new.inputs) - new.output) ** 2)) < 0.02
    with pytest.raises(catheter.CatheterError, match=r"1 column.*\(n, 2\)"):
        fit.model.simulate(new.inputs[:, 0])


def test_the_folder_of_a_fit_holds_a_model_that_loads_to_the_same_output(fitted, tmp_path):
    written = fitted.save(tmp_path / "result")
    assert (tmp_path / "result" / "report.html").is_file()
    _, pressure_bar = pressure(95)
    np.testing.assert_array_equal(catheter.load(written["model"]).simulate(pressure_bar), fitted.model.simulate(pressure_bar))
    blob = written["blob"]
    assert blob["step_instructions"] > 0
    from_blob = catheter.simulate(blob["file"], pressure_bar)
    assert np.abs(from_blob - plant(pressure_bar)).max() < 1e-3
    assert catheter.load(blob["file"]).arithmetic == "fixed-point"


def test_the_command_gives_the_same_figures(recordings, fitted, command, tmp_path):
    for index, recording in enumerate(recordings):
        recording.save(tmp_path / "data" / f"run{index}.csv")
    command("fit", "--data", tmp_path / "data", "--out", tmp_path / "out", "--no-networks", "--json", tmp_path / "fit.json")
    of_command = json.loads((tmp_path / "fit.json").read_text())
    assert of_command["chosen"] == fitted.chosen
    for one, other in zip(of_command["ladder"], fitted.ladder):
        assert one["name"] == other["name"]
        assert one["cv_rmse"] == pytest.approx(other["cv_rmse"], rel=1e-9, abs=1e-12)
    time_s, pressure_bar = pressure(94)
    new = catheter.Recording(time_s, pressure_bar, plant(pressure_bar) + 0.1)
    new.save(tmp_path / "new.csv")
    model = tmp_path / "model"
    fitted.model.save(model)
    command("evaluate", "--model", model, "--data", tmp_path / "new.csv", "--json", tmp_path / "evaluate.json")
    of_command = json.loads((tmp_path / "evaluate.json").read_text())
    rmse = np.sqrt(np.mean((fitted.model.predict(new) - new.output) ** 2))
    assert of_command["mean_rmse"] == pytest.approx(rmse, rel=1e-9)


def test_other_threads_run_during_a_fit_and_progress_is_told(recordings):
    ticks, lines, done = [], [], threading.Event()

    def tick():
        while not done.is_set():
            ticks.append(time.monotonic())
            time.sleep(0.01)

    thread = threading.Thread(target=tick)
    thread.start()
    start = time.monotonic()
    catheter.fit(recordings, progress=lines.append)
    took = time.monotonic() - start
    done.set()
    thread.join()
    assert len(ticks) > 0.2 * took / 0.01
    assert any("physics rungs" in line for line in lines)


def test_an_exception_of_progress_ends_the_fit(recordings):
    def stop(_):
        raise KeyboardInterrupt

    start = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        catheter.fit(recordings, progress=stop)
    assert time.monotonic() - start < 30


def test_what_cannot_be_fitted_is_refused_with_the_tools_words(recordings):
    with pytest.raises(catheter.CatheterError, match="no recordings"):
        catheter.fit([])
    with pytest.raises(TypeError, match="Recording"):
        catheter.fit([[1, 2, 3]])
    with pytest.raises(TypeError, match="Recording"):
        catheter.fit(3)
    with pytest.raises(catheter.CatheterError, match="1 to 1024"):
        catheter.fit(recordings, threads=0)
    time_s = PERIOD_S * np.arange(100)
    still = catheter.Recording(time_s, np.ones(100), time_s)
    with pytest.raises(catheter.CatheterError, match="never changes"):
        catheter.fit(still)
    other = catheter.Recording(time_s, time_s, time_s, input_columns="voltage_V")
    with pytest.raises(catheter.CatheterError, match="one kind"):
        catheter.fit([*recordings, other])
    with pytest.raises(catheter.CatheterError, match="positive"):
        catheter.fit(recordings, networks=True, network_budget_cpu_s=0.0)
