"""PyTorch's training throughput for the 2x64 LSTM: forward, backward, Adam; one line of JSON a shape and thread count.

The other side of `cargo xtask bench training`; it counts multiply-accumulates as host-tool/examples/training_throughput.rs does.
"""

import json
import os
import time

import torch

INPUTS, UNITS, LAYERS = 1, 64, 2
MACS_PER_STEP = 4 * UNITS * (INPUTS + UNITS) + 4 * UNITS * (UNITS + UNITS) + UNITS


class Model(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.lstm = torch.nn.LSTM(INPUTS, UNITS, LAYERS)
        self.dense = torch.nn.Linear(UNITS, 1)

    def forward(self, sequence):
        hidden, _ = self.lstm(sequence)
        return self.dense(hidden)


def measure(batch, steps):
    """Best of several bursts, in multiply-accumulates a second."""
    torch.manual_seed(0)
    model = Model()
    optimiser = torch.optim.Adam(model.parameters(), lr=1e-4)
    phase = torch.arange(steps * batch, dtype=torch.float32).reshape(steps, batch, 1)
    sequence, wanted = torch.sin(0.05 * phase), torch.zeros(steps, batch, 1)

    def step():
        optimiser.zero_grad(set_to_none=True)
        torch.nn.functional.mse_loss(model(sequence), wanted).backward()
        optimiser.step()

    for _ in range(10):
        step()
    best = float("inf")
    for _ in range(12):
        start = time.perf_counter()
        for _ in range(20):
            step()
        best = min(best, (time.perf_counter() - start) / 20)
    return 3 * MACS_PER_STEP * batch * steps / best


for threads in range(1, min(2, os.cpu_count() or 1) + 1):
    torch.set_num_threads(threads)
    for batch, steps in [(16, 50), (32, 100)]:
        rate = measure(batch, steps)
        print(json.dumps({"batch": batch, "steps": steps, "threads": threads, "activation": "tanh", "macs_per_second": rate}), flush=True)
