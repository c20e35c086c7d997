"""Makes lstm.json: outputs and gradients of small LSTMs, computed by PyTorch in double precision.

    python3 make_lstm_vectors.py > lstm.json

The tanh case runs torch.nn.LSTM; the relu and hard cases, which PyTorch does not have, run a cell written out below whose gradient comes
from autograd. Written with PyTorch 2.15; any version that has torch.nn.LSTM gives the same numbers to the printed digits.
"""

import json
import sys

import torch

torch.set_default_dtype(torch.float64)

FEATURES, UNITS, LANES, STEPS = 3, (6, 5), 4, 9


def activation(name, limit):
    return {
        "tanh": torch.tanh,
        "relu": lambda x: x.clamp(0.0, limit),
        "hard": lambda x: x.clamp(-1.0, 1.0),
    }[name]


def layer_by_hand(x, w_x, w_h, b, act, limit):
    """One layer over [step, lane, feature], from zero state; rows of the weights in gate order i, f, g, o."""
    units = w_h.shape[1]
    h = torch.zeros(x.shape[1], units)
    c = torch.zeros(x.shape[1], units)
    out = []
    for step in x:
        i, f, g, o = (step @ w_x.T + h @ w_h.T + b).split(units, dim=1)
        c = (torch.sigmoid(f) * c + torch.sigmoid(i) * act(g)).clamp(-limit, limit)
        h = torch.sigmoid(o) * act(c)
        out.append(h)
    return torch.stack(out)


def layer_of_torch(x, w_x, w_h, b):
    """The same by torch.nn.LSTM, with the parameters swapped in so that autograd sees them."""
    lstm = torch.nn.LSTM(w_x.shape[1], w_h.shape[1])
    named = {"weight_ih_l0": w_x, "weight_hh_l0": w_h, "bias_ih_l0": b, "bias_hh_l0": torch.zeros_like(b)}
    return torch.func.functional_call(lstm, named, (x,))[0]


def case(name, limit, seed):
    generator = torch.Generator().manual_seed(seed)

    def random(*shape, scale):
        # Rounded to what f32 can hold, so that both sides start from equal numbers.
        return ((torch.rand(*shape, generator=generator) * 2 - 1) * scale).float().double().requires_grad_()

    parameters = []
    inputs = FEATURES
    for units in UNITS:
        parameters.append([random(4 * units, inputs, scale=0.9), random(4 * units, units, scale=0.9), random(4 * units, scale=0.5)])
        inputs = units
    dense_w, dense_b = random(inputs, scale=1.0), random(1, scale=0.5)
    x = random(STEPS, LANES, FEATURES, scale=1.5)
    target = random(STEPS, LANES, scale=1.0).detach()

    signal = x
    for w_x, w_h, b in parameters:
        if name == "tanh":
            signal = layer_of_torch(signal, w_x, w_h, b)
        else:
            signal = layer_by_hand(signal, w_x, w_h, b, activation(name, limit), limit)
    y = signal @ dense_w + dense_b
    loss = ((y - target) ** 2).mean()
    loss.backward()

    flat = lambda tensor: [float(f"{value:.9g}") for value in tensor.detach().flatten().tolist()]
    named = lambda part: {
        "layers": [
            {"input_weights": flat(part(w_x)), "recurrent_weights": flat(part(w_h)), "bias": flat(part(b))} for w_x, w_h, b in parameters
        ],
        "dense_weights": flat(part(dense_w)),
        "dense_bias": float(part(dense_b).item()),
    }
    return {
        "activation": name,
        "state_limit": limit,
        "features": FEATURES,
        "units": list(UNITS),
        "lanes": LANES,
        "steps": STEPS,
        "input": flat(x),
        "target": flat(target),
        "parameters": named(lambda tensor: tensor),
        "output": flat(y),
        "loss": loss.item(),
        "gradient": named(lambda tensor: tensor.grad),
    }


# The limits of relu and hard are low enough that some cells meet them; torch.nn.LSTM knows no limit, so that of tanh is out of reach.
cases = [case("tanh", 16.0, 1), case("relu", 0.5, 2), case("hard", 0.6, 3)]
json.dump({"made_by": f"PyTorch {torch.__version__.split('+')[0]}", "cases": cases}, sys.stdout, separators=(",", ":"))
sys.stdout.write("\n")
