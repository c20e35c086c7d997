"""Recordings of a known plant: play operators written anew in NumPy."""

import os
import shutil
import subprocess

import numpy as np
import pytest

import catheter

PERIOD_S = 0.02
THRESHOLDS = np.array([0.0, 0.25, 0.5, 0.9, 1.4])
WEIGHTS = np.array([1.1, 0.7, 0.5, 0.4, 0.3])


def play(values, threshold):
    """A play operator at rest at zero, one step a sample."""
    state, output = 0.0, np.empty(len(values))
    for index, value in enumerate(values):
        state = min(max(state, value - threshold), value + threshold)
        output[index] = state
    return output


def plant(pressure_bar):
    """Displacement in mm, without noise."""
    return sum(weight * play(pressure_bar, threshold) for threshold, weight in zip(THRESHOLDS, WEIGHTS))


def pressure(seed, samples=1200):
    """Two sines within 0 and 3 bar that begin at zero."""
    random = np.random.default_rng(seed)
    time_s = PERIOD_S * np.arange(samples)
    first, second = random.uniform(0.1, 0.3), random.uniform(0.4, 0.9)
    wave = 0.7 * (1 - np.cos(2 * np.pi * first * time_s)) / 2 + 0.3 * np.sin(np.pi * second * time_s) ** 2
    return time_s, 3.0 * random.uniform(0.85, 1.0) * wave


def recorded(seed, noise_mm=0.0):
    time_s, pressure_bar = pressure(seed)
    noise = noise_mm * np.random.default_rng(seed + 1000).standard_normal(len(time_s))
    return catheter.Recording(time_s, pressure_bar, plant(pressure_bar) + noise, name=f"run{seed}")


@pytest.fixture(scope="session")
def recordings():
    return [recorded(seed) for seed in range(5)]


@pytest.fixture(scope="session")
def fitted(recordings):
    return catheter.fit(recordings)


@pytest.fixture(scope="session")
def command():
    """Runs the command `catheter`; the tests that need it are left out where there is none."""
    program = os.environ.get("CATHETER") or shutil.which("catheter")
    if program is None:
        pytest.skip("there is no command `catheter`; set CATHETER to its path")

    def run(*arguments):
        result = subprocess.run([program, *map(str, arguments)], capture_output=True, text=True, check=False)
        assert result.returncode == 0, result.stderr

    return run
