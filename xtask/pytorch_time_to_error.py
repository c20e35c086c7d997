"""PyTorch's time to an error: a 2x64 LSTM with Adam on one folder of recordings, free running on those of another; one line of JSON.

The other side of `cargo xtask bench time-to-error`, with the same recordings, the same two features (the input and its change), the same
scaling and the same lanes that walk from recording to recording with their state carried. Counted is the time of the optimiser's steps;
validations are not.
"""

import argparse
import json
import math
import pathlib
import sys
import time

import numpy as np
import torch

CHUNK = 100

parser = argparse.ArgumentParser()
parser.add_argument("training", type=pathlib.Path)
parser.add_argument("test", type=pathlib.Path)
parser.add_argument("--target-mm", type=float, required=True)
parser.add_argument("--seed", type=int, required=True)
parser.add_argument("--threads", type=int, required=True)
parser.add_argument("--steps", type=int, required=True)
parser.add_argument("--lanes", type=int, default=16)
parser.add_argument("--learning-rate", type=float, required=True)
parser.add_argument("--validations", type=int, default=25)
parser.add_argument("--limit-s", type=float, default=math.inf, help="give up after so much time of steps")
arguments = parser.parse_args()
torch.set_num_threads(arguments.threads)
torch.manual_seed(arguments.seed)
random = np.random.default_rng(arguments.seed)

def read(file):
    with file.open() as lines:
        header = lines.readline().strip().split(",")
        table = np.loadtxt(lines, delimiter=",")
    return table[:, header.index("pressure_bar")], table[:, header.index("displacement_mm")]


recordings = [
    (folder == arguments.test, *read(file)) for folder in (arguments.training, arguments.test) for file in sorted(folder.glob("*.csv"))
]
training = [(pressure, output) for out, pressure, output in recordings if not out]
pressures = np.concatenate([pressure for pressure, _ in training])
outputs = np.concatenate([output for _, output in training])
changes = np.concatenate([np.diff(pressure, prepend=pressure[0]) for pressure, _ in training])
centre, half = 0.5 * (pressures.min() + pressures.max()), 0.5 * (pressures.max() - pressures.min())
spread = 2.0 * np.sqrt(np.mean(changes**2))
middle, reach = outputs.mean(), outputs.std()


def features(pressure):
    change = np.diff(pressure, prepend=pressure[0])
    return np.clip(np.stack([(pressure - centre) / half, change / spread], axis=1), -2.0, 2.0)


tracks = [
    (out, torch.tensor(features(pressure), dtype=torch.float32), torch.tensor((output - middle) / reach, dtype=torch.float32))
    for out, pressure, output in recordings
]
walked = [(inputs, wanted) for out, inputs, wanted in tracks if not out]


class Model(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.lstm = torch.nn.LSTM(2, 64, 2)
        self.dense = torch.nn.Linear(64, 1)
        with torch.no_grad():
            for layer in range(2):
                # Forget gates begin open, as is usual.
                getattr(self.lstm, f"bias_ih_l{layer}")[64:128] += 1.0

    def forward(self, sequence, state):
        hidden, state = self.lstm(sequence, state)
        return self.dense(hidden)[..., 0], state


model = Model()
optimiser = torch.optim.Adam(model.parameters(), lr=arguments.learning_rate)


class Walk:
    """Lanes that go through the recordings in shuffled order."""

    def __init__(self):
        self.order = []
        self.places = [None] * arguments.lanes

    def fill(self):
        inputs = torch.zeros(CHUNK, arguments.lanes, 2)
        wanted = torch.zeros(CHUNK, arguments.lanes)
        known = torch.zeros(CHUNK, arguments.lanes)
        carried = torch.ones(arguments.lanes)
        for lane, place in enumerate(self.places):
            if place is None or place[1] >= len(walked[place[0]][1]):
                if not self.order:
                    self.order = list(random.permutation(len(walked)))
                place = (self.order.pop(), 0)
                carried[lane] = 0.0
            track, start = place
            end = min(start + CHUNK, len(walked[track][1]))
            inputs[: end - start, lane] = walked[track][0][start:end]
            wanted[: end - start, lane] = walked[track][1][start:end]
            known[: end - start, lane] = 1.0
            self.places[lane] = (track, start + CHUNK)
        return inputs, wanted, known, carried


def rate(step):
    """A short rise, then half a cosine to a hundredth."""
    rise = 0.02 * arguments.steps
    share = max(0.0, (step - rise) / (arguments.steps - rise))
    return arguments.learning_rate * min(1.0, (step + 1) / rise) * (0.01 + 0.99 * 0.5 * (1.0 + math.cos(math.pi * share)))


@torch.no_grad()
def validated():
    squares, count = 0.0, 0
    for out, inputs, wanted in tracks:
        if out:
            predicted, _ = model(inputs[:, None, :], None)
            squares += float(((predicted[:, 0] - wanted) ** 2).sum())
            count += len(wanted)
    return reach * math.sqrt(squares / count)


walk = Walk()
state = (torch.zeros(2, arguments.lanes, 64), torch.zeros(2, arguments.lanes, 64))
history, wall_s, cpu_s, reached = [], 0.0, 0.0, None
interval = max(1, arguments.steps // arguments.validations)
for step in range(arguments.steps):
    began, began_cpu = time.perf_counter(), time.process_time()
    inputs, wanted, known, carried = walk.fill()
    state = tuple((part * carried[None, :, None]).detach() for part in state)
    for group in optimiser.param_groups:
        group["lr"] = rate(step)
    optimiser.zero_grad(set_to_none=True)
    predicted, state = model(inputs, state)
    (((predicted - wanted) ** 2 * known).sum() / known.sum()).backward()
    torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
    optimiser.step()
    wall_s += time.perf_counter() - began
    cpu_s += time.process_time() - began_cpu
    if (step + 1) % interval == 0 or step + 1 == arguments.steps:
        error = validated()
        history.append({"steps": step + 1, "wall_s": wall_s, "cpu_s": cpu_s, "rmse_mm": error})
        print(history[-1], file=sys.stderr, flush=True)
        if error <= arguments.target_mm and reached is None:
            reached = history[-1]
            break
        if wall_s > arguments.limit_s:
            break
print(json.dumps({"torch": torch.__version__, "seed": arguments.seed, "reached": reached, "history": history}))
