"""Discovery from Python: an effect that was put in is named, and the model with it loads."""

import numpy as np
import pytest

import catheter
from conftest import PERIOD_S, plant, pressure


def delayed(seed, delay_samples=6):
    """The plant behind a dead time, with a little noise."""
    time_s, pressure_bar = pressure(seed)
    late = np.concatenate([np.full(delay_samples, pressure_bar[0]), pressure_bar[:-delay_samples]])
    noise = 0.004 * np.random.default_rng(seed + 500).standard_normal(len(time_s))
    return catheter.Recording(time_s, pressure_bar, plant(late) + noise, name=f"late{seed}")


def test_a_dead_time_is_named_and_the_gap_closes(tmp_path):
    stages = []
    recordings = [delayed(seed) for seed in range(4)]
    found = catheter.discover(recordings, holdout=delayed(20), out=tmp_path / "found", progress=stages.append)
    assert found["verdict"] == "named" and stages
    (effect,) = found["effects"]
    assert effect["name"] == "dead-time"
    low, high = effect["intervals"]["delay_s"]
    assert low - 0.001 < 6 * PERIOD_S < high + 0.001
    assert found["rmse_after"] < 0.5 * found["rmse_before"]
    new = delayed(21)
    model = catheter.load(tmp_path / "found" / "model.toml")
    assert model.sample_period_s == pytest.approx(PERIOD_S)
    error = model.predict(new) - new.output
    assert np.sqrt(np.mean(error**2)) < 2 * found["rmse_after"]


def test_too_little_is_refused():
    time_s, pressure_bar = pressure(1, 50)
    with pytest.raises(catheter.CatheterError, match="too few"):
        catheter.discover(catheter.Recording(time_s, pressure_bar, plant(pressure_bar)))
