"""Measures PyTorch's training throughput on the 2x64 LSTM, as host-tool's example `training_throughput` measures ours.

    python3 training_throughput.py

One line of JSON a shape and thread count: forward, backward and Adam step; one weight counts three multiply-accumulates a step and
lane. The time is the best of twelve bursts of twenty steps.
"""

import json
import os
import time

import torch

MACS = 49_472


def measure(batch, steps, threads):
    torch.set_num_threads(threads)
    lstm, dense = torch.nn.LSTM(1, 64, 2), torch.nn.Linear(64, 1)
    parameters = list(lstm.parameters()) + list(dense.parameters())
    optimiser = torch.optim.Adam(parameters, lr=1e-4)
    x = torch.sin(torch.arange(batch * steps) * 0.05).reshape(steps, batch, 1)
    target = torch.zeros(steps, batch, 1)

    def step():
        optimiser.zero_grad(set_to_none=True)
        ((dense(lstm(x)[0]) - target) ** 2).mean().backward()
        optimiser.step()

    for _ in range(5):
        step()
    best = float("inf")
    for _ in range(12):
        start = time.perf_counter()
        for _ in range(20):
            step()
        best = min(best, (time.perf_counter() - start) / 20)
    return 3 * MACS * batch * steps / best


for batch, steps in ((16, 50), (32, 100)):
    for threads in [count for count in (1, 2) if count <= (os.cpu_count() or 1)]:
        rate = measure(batch, steps, threads)
        print(json.dumps({"batch": batch, "steps": steps, "threads": threads, "macs_per_second": float(f"{rate:.4e}")}), flush=True)
