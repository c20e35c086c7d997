"""What the baselines must be to be believed: causal, blind to test outputs, and right on systems that are known.

    ENV/bin/python -m unittest discover --start-directory tests/baselines
"""

import pathlib
import sys
import tempfile
import types
import unittest

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).parent))
import measured
import models

PERIOD_S = 0.01


def recording(u, y):
    u = np.atleast_2d(np.asarray(u, float).T).T
    return types.SimpleNamespace(u=u, y=np.asarray(y, float), measured=np.asarray(y, float), at_stamps=lambda prediction: prediction)


def walk(seed, count=600):
    """A random signal that goes up and down through all of -1..1."""
    steps = np.random.default_rng(seed).normal(size=count)
    smooth = models.lag(np.cumsum(steps)[:, None], 5)[:, 0]
    return 2 * (smooth - smooth.min()) / np.ptp(smooth) - 1


class Baselines(unittest.TestCase):
    def test_arx_finds_a_lag_exactly(self):
        def plant(u):
            return 3 + models.lag(models.delay(u[:, None], 2), 7)[:, 0]

        train, test = [recording(walk(seed), plant(walk(seed))) for seed in (1, 2)], [recording(walk(3), plant(walk(3)))]
        self.assertLess(self.error(models.arx, train, test), 1e-4)

    def test_twenty_plays_find_a_sum_of_plays_behind_a_dead_time(self):
        def plant(u):
            return models.delay(models.plays(u[:, None], np.array([0.0, 0.3])) @ np.array([[1.0], [0.5]]), 4)[:, 0]

        train, test = [recording(walk(seed), plant(walk(seed))) for seed in (1, 2)], [recording(walk(3), plant(walk(3)))]
        # The threshold 0.3 lies on the grid of no spacing; half of a grid step is left.
        self.assertLess(self.error(models.plays_and_lag, train, test), 0.01)

    def test_a_friction_force_takes_stop_operators(self):
        def plant(u):
            return 0.2 * u + (u[:, None] - models.plays(u[:, None], np.array([0.05])))[:, 0] * 10

        train, test = [recording(walk(seed), plant(walk(seed))) for seed in (1, 2)], [recording(walk(3), plant(walk(3)))]
        self.assertLess(self.error(models.modified_pi, train, test), 0.02)

    def test_no_prediction_depends_on_a_later_input(self):
        train = [recording(walk(seed), models.lag(walk(seed)[:, None], 7)[:, 0]) for seed in (1, 2)]
        changed = walk(3)
        changed[400:] = -changed[400:]
        for name, baseline in models.BASELINES.items():
            task = models.Task(train, [recording(walk(3), walk(3)), recording(changed, changed)], "recordings")
            _, _, (whole, other) = baseline(task)
            np.testing.assert_allclose(whole[:400], other[:400], atol=1e-9, err_msg=name)

    def error(self, baseline, train, test):
        task = models.Task(train, test, "recordings")
        _, _, predictions = baseline(task)
        wrong = [prediction * task.scale.range + task.scale.low - r.y for prediction, r in zip(predictions, test)]
        return max(float(np.sqrt(np.mean(part**2)) / np.ptp(r.y)) for part, r in zip(wrong, test))


class Recordings(unittest.TestCase):
    def test_uneven_stamps_come_back_to_where_they_were(self):
        times = np.cumsum([PERIOD_S, 0.008, 0.012, PERIOD_S, 0.125, PERIOD_S, PERIOD_S, PERIOD_S])
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder) / "a.csv"
            measured.write(path, ["time_s", "u_V", "y_mm"], [[time, time, 2 * time] for time in times])
            read = models.Recording(path, ["u_V"], "y_mm")
        self.assertFalse(read.even)
        np.testing.assert_allclose(read.at_stamps(2 * read.grid)[:-1], read.measured[:-1], atol=1e-7)

    def test_an_episode_sums_its_actions_within_limits(self):
        recipe = {"sum": {"gain": 0.06, "from": 0.5, "low": 0.0, "high": 1.0}}
        self.assertEqual(measured.signal([[5.0], [5.0], [-1.0]], {"a": 0}, "sum:a", recipe), [0.8, 1.0, 0.94])


if __name__ == "__main__":
    unittest.main()
