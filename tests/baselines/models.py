"""The baselines of `measured.py`: what a user would reach for without this project.

Everything runs free: a model sees the inputs from the first sample of a recording to its last and never an output. All outputs are
written about in per cent of their range in the test recordings.

Settings are chosen by cross-validation over the training recordings (whole recordings left out; five blocks where there is only one),
by the mean square error of the rows left out. Nothing of the test recordings decides anything, except which baseline is called `best`
in the results: that is the strongest on the test side, an oracle that nobody who starts from training recordings can be sure to meet.
`picked` is the baseline with the least cross-validated error, which such a person would take.
"""

import os

# One thread: the machine may be shared, and none of the systems here is large.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import csv
import hashlib
import itertools
import json
import time

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import nnls
from scipy.signal import lfilter
from sklearn.ensemble import RandomForestRegressor

MOST_FOLDS = 6
BLOCKS = 5


class Recording:
    """A prepared file on an even grid; `at_stamps` takes a prediction back to the stamps of the file, where it is scored."""

    def __init__(self, path, inputs, output, period_s=None):
        with path.open(newline="") as file:
            rows = csv.reader(file)
            header = next(rows)
            table = np.array([[float(cell) for cell in row] for row in rows])
        columns = {name: table[:, index] for index, name in enumerate(header)}
        self.time, self.measured = columns["time_s"], columns[output]
        steps = np.diff(self.time)
        self.period_s = period_s or float(np.median(steps))
        self.even = bool(np.all(np.abs(steps - self.period_s) < 0.02 * self.period_s))
        inputs = np.column_stack([columns[name] for name in inputs])
        if self.even:
            self.grid, self.u, self.y = self.time, inputs, self.measured
        else:
            # Clock jitter and gaps: straight lines between the samples, on the grid of the median step.
            self.grid = np.arange(self.time[0], self.time[-1] + 1e-9, self.period_s)
            self.u = np.column_stack([np.interp(self.grid, self.time, column) for column in inputs.T])
            self.y = np.interp(self.grid, self.time, self.measured)

    def at_stamps(self, prediction):
        return prediction if self.even else np.interp(self.time, self.grid, prediction)


class Scale:
    """Inputs to -1..1 and the output to 0..1 over the training recordings."""

    def __init__(self, recordings):
        u, y = np.vstack([r.u for r in recordings]), np.concatenate([r.y for r in recordings])
        self.centre, self.half = (u.max(0) + u.min(0)) / 2, np.maximum((u.max(0) - u.min(0)) / 2, 1e-12)
        self.low, self.range = y.min(), max(np.ptp(y), 1e-12)
        # Which inputs push and which pull, by a straight fit.
        slopes = np.linalg.lstsq(np.column_stack([(u - self.centre) / self.half, np.ones(len(u))]), y, rcond=None)[0][:-1]
        self.sign = np.where(slopes < 0, -1.0, 1.0)

    def inputs(self, recording):
        return (recording.u - self.centre) / self.half * self.sign

    def output(self, recording):
        return (recording.y - self.low) / self.range


def folds_of(recordings, how):
    """The number of the fold of each row of all recordings, one below the other."""
    if how == "blocks" or len(recordings) == 1:
        return np.concatenate([np.arange(len(r.y)) * BLOCKS // len(r.y) for r in recordings])
    count = min(MOST_FOLDS, len(recordings))
    return np.concatenate([np.full(len(r.y), index * count // len(recordings)) for index, r in enumerate(recordings)])


# ---- Building blocks ----------------------------------------------------------------------------------------------------------------


def play(x, thresholds):
    """Play operators of one input, all starting at its first value; samples x thresholds."""
    out = np.empty((len(x), len(thresholds)))
    state = np.full(len(thresholds), x[0])
    for index, value in enumerate(x):
        np.minimum(np.maximum(state, value - thresholds), value + thresholds, out=state)
        out[index] = state
    return out


SPACINGS = {
    "even": lambda count: np.linspace(0, 0.95, count),
    "geometric": lambda count: np.r_[0.0, np.geomspace(0.01, 0.95, count - 1)],
}


def plays(u, thresholds):
    """Play operators of all inputs, samples x (inputs x thresholds)."""
    return np.hstack([play(column, thresholds) for column in u.T])


class Operators:
    """Signals with non-negative weights: play operators (the output follows the input), or stop operators beside a line of free slope
    (the output leads it, as a friction force does)."""

    def __init__(self, family, spacing, count, train, outputs):
        self.family, self.thresholds = family, SPACINGS[spacing](count)
        self.loop = np.ones(train[0].shape[1])
        if family == "stops":
            # Which way round each loop goes, by the weight of one stop operator beside a line.
            stops = np.vstack([u - plays(u, np.array([0.1])) for u in train])
            terms = np.column_stack([np.vstack(train), stops, np.ones(len(stops))])
            weights = np.linalg.lstsq(terms, np.concatenate(outputs), rcond=None)[0]
            self.loop = np.where(weights[len(self.loop) : -1] < 0, -1.0, 1.0)

    def __call__(self, u):
        memory = plays(u, self.thresholds)
        if self.family == "plays":
            return memory
        count = len(self.thresholds)
        stops = np.repeat(u, count, axis=1) - memory
        # The stop operator of threshold zero is nothing; the line, both ways, stands in its place.
        keep = np.tile(self.thresholds > 0, u.shape[1])
        return np.hstack([u, -u, (stops * np.repeat(self.loop, count))[:, keep]])


def lag(x, samples):
    """First-order lag, at rest before the first sample."""
    if samples == 0:
        return x
    a = 1 / (1 + samples)
    return lfilter([a], [1, a - 1], x, axis=0, zi=(1 - a) * x[:1])[0]


def delay(x, samples):
    return np.vstack([np.repeat(x[:1], samples, 0), x[: len(x) - samples]]) if samples else x


class Sums:
    """Second moments of rows, so that many fits on parts of them cost little."""

    def __init__(self, features, target):
        self.n = len(target)
        self.x, self.y = features.sum(0), target.sum()
        self.xx, self.xy = features.T @ features, features.T @ target

    def __sub__(self, other):
        result = object.__new__(Sums)
        for name in ("n", "x", "y", "xx", "xy"):
            setattr(result, name, getattr(self, name) - getattr(other, name))
        return result

    def non_negative(self, ridge):
        """Non-negative weights and a free constant; `ridge` is relative to the mean square of the columns of a unit input."""
        mean_x, mean_y = self.x / self.n, self.y / self.n
        gram = self.xx / self.n - np.outer(mean_x, mean_x)
        moment = self.xy / self.n - mean_x * mean_y
        upper = cholesky(gram + (ridge + 1e-9) * np.eye(len(gram)))
        try:
            weights = nnls(upper, solve_triangular(upper, moment, trans="T"))[0]
        except RuntimeError:  # No convergence: drop what is negative.
            weights = np.maximum(np.linalg.lstsq(upper, solve_triangular(upper, moment, trans="T"), rcond=None)[0], 0)
        return weights, mean_y - mean_x @ weights


class Task:
    """What every baseline gets: scaled training recordings with folds, and scaled test inputs."""

    def __init__(self, train, test, how):
        self.scale = Scale(train)
        self.train, self.test = [self.scale.inputs(r) for r in train], [self.scale.inputs(r) for r in test]
        self.outputs = [self.scale.output(r) for r in train]
        self.y = np.concatenate(self.outputs)
        self.folds = folds_of(train, how)
        self.fold_names = np.unique(self.folds)
        self.lengths = [len(y) for y in self.outputs]

    def error(self, predict_fold):
        """Root mean square of what is left out; `predict_fold(fold, rows)` gives the predictions of these rows."""
        total = 0.0
        for fold in self.fold_names:
            rows = self.folds == fold
            total += np.sum((predict_fold(fold, rows) - self.y[rows]) ** 2)
        return float(np.sqrt(total / len(self.y)))

    def split(self, column):
        return np.split(column, np.cumsum(self.lengths)[:-1])


# ---- Baselines: each gives (cross-validated error, setting, predictions of the test recordings), all on the scaled output -----------


def static(task):
    """A polynomial in all inputs, held beyond their training range."""
    most = 5 if task.train[0].shape[1] == 1 else 3

    def terms(u, degree):
        u = np.clip(u, -1, 1)
        powers = itertools.chain.from_iterable(
            itertools.combinations_with_replacement(range(u.shape[1]), d) for d in range(degree + 1)
        )
        return np.column_stack([np.prod(u[:, list(power)], axis=1) for power in powers])

    def fit(x, y):
        return np.linalg.lstsq(x, y, rcond=1e-9)[0]

    best = (np.inf,)
    for degree in range(1, most + 1):
        x = np.vstack([terms(u, degree) for u in task.train])
        error = task.error(lambda fold, rows: x[rows] @ fit(x[~rows], task.y[~rows]))
        if error < best[0]:
            best = (error, {"degree": degree}, fit(x, task.y))
    error, setting, weights = best
    return error, setting, [terms(u, setting["degree"]) @ weights for u in task.test]


DEAD_TIMES = (0, 1, 2, 4, 8, 16)
LAGS = (0, 1, 2, 4, 8, 16, 32, 64)
RIDGES = (1e-6, 1e-4, 1e-3, 1e-2)


def plays_and_lag(task):
    """Twenty play (or stop) operators by NNLS, with dead time and a first-order lag before or behind them."""
    count = max(1, 20 // task.train[0].shape[1])
    best = (np.inf,)
    for family, spacing in itertools.product(("plays", "stops"), SPACINGS):
        operators = Operators(family, spacing, count, task.train, task.outputs)
        plain = [operators(u) for u in task.train]
        for lag_samples, order in itertools.product(LAGS, ("before", "behind")):
            if lag_samples == 0 and order == "behind":
                continue
            if order == "before":
                lagged = [operators(lag(u, lag_samples)) for u in task.train]
            else:
                lagged = [lag(x, lag_samples) for x in plain]
            for dead_time in DEAD_TIMES:
                x = np.vstack([delay(signals, dead_time) for signals in lagged])
                parts = {fold: Sums(x[task.folds == fold], task.y[task.folds == fold]) for fold in task.fold_names}
                whole = Sums(x, task.y)
                for ridge in RIDGES:

                    def predict(fold, rows):
                        weights, constant = (whole - parts[fold]).non_negative(ridge)
                        return x[rows] @ weights + constant

                    error = task.error(predict)
                    if error < best[0]:
                        setting = {"family": family, "spacing": spacing, "dead_time": dead_time, "lag": lag_samples, "order": order}
                        best = (error, setting | {"ridge": ridge}, operators, whole.non_negative(ridge))
    error, setting, operators, (weights, constant) = best
    predictions = []
    for u in task.test:
        if setting["order"] == "before":
            x = operators(lag(u, setting["lag"]))
        else:
            x = lag(operators(u), setting["lag"])
        predictions.append(delay(x, setting["dead_time"]) @ weights + constant)
    return error, setting, predictions


class Curve:
    """A rising curve of straight pieces; beyond its end knots it goes on straight."""

    def __init__(self, z, y, pieces):
        self.knots = np.linspace(z.min(), max(z.max(), z.min() + 1e-9), pieces + 1)
        self.slopes, self.constant = Sums(self.ramps(z), y).non_negative(1e-7)

    def ramps(self, z):
        low, high = self.knots[:-1].copy(), self.knots[1:].copy()
        start = low.copy()
        low[0], high[-1] = -np.inf, np.inf
        return np.clip(z[:, None], low, high) - start

    def __call__(self, z):
        return self.ramps(z) @ self.slopes + self.constant

    def slope(self, z):
        return self.slopes[np.clip(np.searchsorted(self.knots, z) - 1, 0, len(self.slopes) - 1)]


def modified_pi(task):
    """Prandtl-Ishlinskii followed by a rising curve; weights and curve in turns, the weights by Gauss-Newton under NNLS."""

    def fit(x, y, pieces, ridge):
        weights, _ = Sums(x, y).non_negative(ridge)
        if not weights.any():
            weights = np.full(x.shape[1], 1 / x.shape[1])
        z = x @ weights
        curve = Curve(z, y, pieces)
        error = np.mean((curve(z) - y) ** 2)
        for _ in range(12):
            slope = curve.slope(z)
            # Linearised in the weights: slope x (new weights) = what is missing + slope x (weights).
            target = y - curve(z) + slope * z
            wanted, _ = Sums(x * slope[:, None], target).non_negative(ridge)
            for share in (1.0, 0.5, 0.25, 0.1):
                trial = weights + share * (wanted - weights)
                if not trial.any():
                    continue
                trial_z = x @ trial
                trial_curve = Curve(trial_z, y, pieces)
                trial_error = np.mean((trial_curve(trial_z) - y) ** 2)
                if trial_error < error:
                    break
            else:
                break
            gain = error - trial_error
            weights, z, curve, error = trial, trial_z, trial_curve, trial_error
            if gain < 1e-4 * error:
                break
        return weights, curve

    best = (np.inf,)
    counts = (8, 16) if task.train[0].shape[1] == 1 else (6, 10)
    for family, spacing, count in itertools.product(("plays", "stops"), SPACINGS, counts):
        operators = Operators(family, spacing, count, task.train, task.outputs)
        x = np.vstack([operators(u) for u in task.train])
        for pieces, ridge in itertools.product((1, 3, 6, 10), (1e-5, 1e-3)):

            def predict(fold, rows):
                weights, curve = fit(x[~rows], task.y[~rows], pieces, ridge)
                return curve(x[rows] @ weights)

            error = task.error(predict)
            if error < best[0]:
                setting = {"family": family, "spacing": spacing, "operators": count, "pieces": pieces, "ridge": ridge}
                best = (error, setting, operators, fit(x, task.y, pieces, ridge))
    error, setting, operators, (weights, curve) = best
    return error, setting, [curve(operators(u) @ weights) for u in task.test]


def arx(task):
    """ARX on inputs and their powers, simulated from the equilibrium of the first input: no measured output starts it.

    Least squares one step ahead, or refined by Steiglitz and McBride's filtering, which comes nearer to the simulation error. A step
    may be several samples long (`stride`): each phase is then a series of its own, on means of the inputs since its last step.
    """

    def terms(u, setting):
        """Inputs of each step: powers of trailing means, now and at earlier steps."""
        stride = setting["stride"]
        mean = np.mean([delay(u, index) for index in range(stride)], axis=0)
        powers = np.hstack([mean**power for power in range(1, setting["degree"] + 1)])
        earliest = len(u) - 1
        return np.hstack([delay(powers, min((setting["dead_time"] + tap) * stride, earliest)) for tap in range(setting["taps"])])

    def stacked(parts, stride):
        """All phases of all recordings side by side, series x steps x columns; behind its end a series repeats its last value."""
        series = [part[phase::stride] for part in parts for phase in range(stride)]
        longest = max(len(one) for one in series)
        return np.stack([np.concatenate([one, np.repeat(one[-1:], longest - len(one), 0)]) for one in series])

    def simulate(model, xs, stride):
        """`y[t] = -a y[t - stride..] + b x[t] + constant`, from the equilibrium of each recording's first row."""
        a, b, constant = model
        drive = stacked(xs, stride) @ b + constant
        first = np.repeat(drive[::stride, :1], stride, axis=0)
        out = first / (1 + a.sum()) + lfilter([1.0], np.r_[1.0, a], drive - first, axis=1)
        results = [np.empty(len(x)) for x in xs]
        for index, series in enumerate(out):
            part = results[index // stride][index % stride :: stride]
            part[:] = series[: len(part)]
        return results

    def fit(x, y, used, setting):
        """Coefficients from the steps that are used, all stacked; nothing when the model does not stand still by itself."""
        poles = setting["poles"]
        a = np.zeros(poles)
        used = used[:, poles:]
        for _ in range(setting["refinements"] + 1):
            filtered = np.r_[1.0, a]
            gain = 1 / filtered.sum()
            fy, fx = (lfilter([1.0], filtered, v - v[:, :1], axis=1) + v[:, :1] * gain for v in (y, x))
            past = np.stack([-fy[:, poles - 1 - index : fy.shape[1] - 1 - index] for index in range(poles)], axis=2)
            rows = np.concatenate([past, fx[:, poles:], np.full((*used.shape, 1), gain)], axis=2)[used]
            penalty = np.full(rows.shape[1], setting["ridge"] * len(rows))
            penalty[:poles], penalty[-1] = 0, 0
            solution = np.linalg.lstsq(rows.T @ rows + np.diag(penalty), rows.T @ fy[:, poles:][used], rcond=1e-12)[0]
            a, b, constant = solution[:poles], solution[poles:-1], solution[-1]
            if np.max(np.abs(np.roots(np.r_[1.0, a]))) > 0.9999:
                return None
        return a, b, constant

    shortest = min(task.lengths)
    best = (np.inf,)
    grid = {"stride": (1, 3, 10), "degree": (1, 3), "dead_time": (0, 1, 2, 4, 8), "taps": (1, 3)}
    inner = {"poles": (1, 2, 3), "refinements": (0, 5), "ridge": (1e-9, 1e-5)}
    for outer in itertools.product(*grid.values()):
        outer = dict(zip(grid, outer))
        if (outer["dead_time"] + outer["taps"] + 3) * outer["stride"] > shortest // 2:
            continue
        stride = outer["stride"]
        xs = [terms(u, outer) for u in task.train]
        x, y, folds = (stacked(parts, stride) for parts in (xs, task.outputs, task.split(task.folds)))
        valid = stacked([np.ones(length, bool) for length in task.lengths], stride)
        for index, length in enumerate(np.repeat(task.lengths, stride)):
            valid[index, len(range(index % stride, length, stride)) :] = False
        for rest in itertools.product(*inner.values()):
            setting = outer | dict(zip(inner, rest))

            def predict(fold, rows):
                model = fit(x, y, valid & (folds != fold), setting)
                return np.inf if model is None else np.concatenate(simulate(model, xs, stride))[rows]

            error = task.error(predict)
            if error < best[0]:
                model = fit(x, y, valid, setting)
                if model is not None:
                    best = (error, setting, model)
    error, setting, model = best
    return error, setting, simulate(model, [terms(u, setting) for u in task.test], setting["stride"])


def forest(task):
    """Random forest on the inputs now and at earlier times, and on play operators."""
    thresholds = np.geomspace(0.02, 0.9, 8)
    spans = [span for span in (16, 128) if span <= max(task.lengths) // 4] or [16]

    def features(u, span):
        lags = [0] + [2**power for power in range(8) if 2**power <= span]
        return np.hstack([delay(u, min(samples, len(u))) for samples in lags] + [plays(u, thresholds)])

    def fit(x, y, leaf, trees):
        return RandomForestRegressor(trees, min_samples_leaf=leaf, max_features=0.4, random_state=0, n_jobs=1).fit(x, y)

    best = (np.inf,)
    for span in spans:
        x = np.vstack([features(u, span) for u in task.train]).astype(np.float32)
        for leaf in (2, 8, 32):
            error = task.error(lambda fold, rows: fit(x[~rows], task.y[~rows], leaf, 25).predict(x[rows]))
            if error < best[0]:
                best = (error, {"span": span, "leaf": leaf})
    error, setting = best
    x = np.vstack([features(u, setting["span"]) for u in task.train]).astype(np.float32)
    trained = fit(x, task.y, setting["leaf"], 100)
    return error, setting, [trained.predict(features(u, setting["span"]).astype(np.float32)) for u in task.test]


BASELINES = {"static": static, "modified_pi": modified_pi, "plays_lag": plays_and_lag, "arx": arx, "forest": forest}
# To be raised with every change that moves a baseline's figures: results of another version are made anew.
VERSIONS = {"static": 1, "modified_pi": 1, "plays_lag": 1, "arx": 2, "forest": 1}
REFERENCE_ONLY = ("static",)

# ---- Scores -------------------------------------------------------------------------------------------------------------------------


def score(recordings, predictions, names, groups):
    """Errors of each test recording, of each group over its common range in per cent, and the mean of the groups."""
    each = {}
    for recording, prediction, name in zip(recordings, predictions, names):
        wrong, measured = recording.at_stamps(prediction) - recording.measured, recording.measured
        each[name] = {"rmse": float(np.sqrt(np.mean(wrong**2))), "range": float(np.ptp(measured)), "n": len(measured)}
    percent = {}
    for name, group in groups.items():
        members = [each[member] for member in group["recordings"]]
        mean_square = sum(member["rmse"] ** 2 * member["n"] for member in members) / sum(member["n"] for member in members)
        percent[name] = 100 * float(np.sqrt(mean_square)) / group["range"]
    return {"percent": float(np.mean(list(percent.values()))), "groups": percent, "recordings": each}


def run(prepared, out, role, wanted):
    """Fits and judges every baseline on the maps, prints a table and writes the results after each map; what `out` holds and is still
    true is not made again."""
    index = json.loads((prepared / "index.json").read_text())
    earlier = json.loads(out.read_text()) if out.exists() else {}
    results = {}
    print(f"{'map':32}" + "".join(f"{name:>13}" for name in BASELINES) + "  best, picked")
    for name, entry in index.items():
        if (role != "all" and entry["role"] != role) or (wanted and name not in wanted):
            continue
        row = results[name] = one_map(prepared, entry, earlier.get(name, {}).get("baselines", {}))
        cells = "".join(f"{row['baselines'][baseline]['percent']:13.2f}" for baseline in BASELINES)
        print(f"{name:32}{cells}  {row['best']}, {row['picked']}", flush=True)
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(json.dumps(earlier | results, indent=1) + "\n")


def fingerprint(prepared, entry):
    """What the results of a map depend on beside the version of the baseline."""
    hashed = hashlib.sha256(json.dumps([entry["inputs"], entry["output"], entry["folds"], sorted(entry["groups"].items())]).encode())
    for path in entry["train"] + entry["test"]:
        hashed.update((prepared / path).read_bytes())
    return hashed.hexdigest()[:16]


def one_map(prepared, entry, earlier):
    """The results of one map; those of an earlier run are kept where nothing that they depend on has changed."""
    mark = fingerprint(prepared, entry)
    marks = {name: f"{mark}-{version}" for name, version in VERSIONS.items()}
    found = {name: earlier[name] for name in BASELINES if earlier.get(name, {}).get("fingerprint") == marks[name]}
    missing = [name for name in BASELINES if name not in found]
    if missing:
        load = lambda path, period_s=None: Recording(prepared / path, entry["inputs"], entry["output"], period_s)
        first = load(entry["train"][0])
        train = [load(path, first.period_s) for path in entry["train"]]
        test = [load(path, first.period_s) for path in entry["test"]]
        task = Task(train, test, entry["folds"])
    for name in missing:
        start = time.monotonic()
        error, setting, predictions = BASELINES[name](task)
        predictions = [prediction * task.scale.range + task.scale.low for prediction in predictions]
        found[name] = score(test, predictions, entry["test"], entry["groups"]) | {
            "cv_rmse": error * task.scale.range,
            "setting": setting,
            "seconds": round(time.monotonic() - start, 1),
            "fingerprint": marks[name],
        }
    judged = [name for name in BASELINES if name not in REFERENCE_ONLY]
    return {
        "role": entry["role"],
        "shift": entry["shift"],
        "best": min(judged, key=lambda name: found[name]["percent"]),
        "picked": min(judged, key=lambda name: found[name]["cv_rmse"]),
        "baselines": {name: found[name] for name in BASELINES},
    }
