"""Makes the files in this folder: small networks of PyTorch, Keras and ONNX with the outputs that these frameworks give.

    pip install torch keras onnx onnxruntime onnxscript safetensors
    python3 make_import_vectors.py [lstm] [others] [inputs]

Each network learns a few play operators for some seconds, so that its weights are those of a trained network. `NAME.safetensors` or
`NAME.onnx` is the network, `NAME.csv` what the framework computes in f32, in bar and mm. The versions used are in `versions.json`.
"""

import json
import os
import pathlib
import sys

os.environ["KERAS_BACKEND"] = "torch"

import keras
import numpy as np
import onnx
import onnxruntime
import torch
from onnx import TensorProto, helper, numpy_helper
from safetensors.torch import save_file

HERE = pathlib.Path(__file__).parent
sys.path.insert(0, str(HERE.parents[2] / "python" / "python" / "catheter"))
import network_state

PERIOD_S = 0.02
SAMPLES = 160
CHANNELS = {
    "input_channel": "pressure:bar",
    "output_channel": "displacement:mm",
    "sample_period_s": PERIOD_S,
    "input_range": (0.0, 3.0),
    "output_range": (0.0, 12.0),
}
SCALING = {"input_offset": 1.5, "input_scale": 1.5, "output_offset": 5.0, "output_scale": 4.0}


def pressure(samples, seed):
    """Two sines under a slow envelope, 0 to 3 bar, in values that f32 holds exactly."""
    time = np.arange(samples) * PERIOD_S
    phase = np.random.default_rng(seed).uniform(0, 2 * np.pi, 3)
    wave = 0.7 * np.sin(2 * np.pi * 0.4 * time + phase[0]) + 0.3 * np.sin(2 * np.pi * 1.1 * time + phase[1])
    return (1.5 + 1.5 * wave * (0.7 + 0.3 * np.sin(2 * np.pi * 0.09 * time + phase[2]))).astype(np.float32)


def displacement(pressure_bar):
    total = np.zeros(len(pressure_bar))
    for threshold, weight in ((0.0, 1.6), (0.25, 1.2), (0.6, 0.9)):
        state, played = 0.0, []
        for value in pressure_bar.astype(float):
            state = max(value - threshold, min(value + threshold, state))
            played.append(state)
        total += weight * np.array(played)
    return total.astype(np.float32)


def network_input(pressure_bar, difference, scaled):
    """What the network sees, [batch, time, features]."""
    normalised = pressure_bar
    if scaled:
        normalised = (pressure_bar - np.float32(SCALING["input_offset"])) / np.float32(SCALING["input_scale"])
    columns = [normalised]
    if difference:
        columns.append(np.diff(normalised, prepend=normalised[:1]))
    return np.stack(columns, axis=-1)[None].astype(np.float32)


def to_mm(output, scaled):
    output = np.asarray(output, dtype=np.float32).ravel()
    return output * np.float32(SCALING["output_scale"]) + np.float32(SCALING["output_offset"]) if scaled else output


class Stacked(torch.nn.Module):
    """LSTM layers with a linear output; `last` gives only the last step."""

    def __init__(self, features, units, layers=1, last=False):
        super().__init__()
        self.recurrent = torch.nn.LSTM(features, units, layers, batch_first=True)
        self.head = torch.nn.Linear(units, 1)
        self.last = last

    def forward(self, x):
        y, _ = self.recurrent(x)
        return self.head(y[:, -1, :] if self.last else y)


class TwoModules(torch.nn.Module):
    """Two LSTM modules of different widths, the second without a bias."""

    def __init__(self):
        super().__init__()
        self.wide = torch.nn.LSTM(1, 10, batch_first=True)
        self.narrow = torch.nn.LSTM(10, 6, batch_first=True, bias=False)
        self.head = torch.nn.Linear(6, 1)

    def forward(self, x):
        return self.head(self.narrow(self.wide(x)[0])[0])


def train_torch(module, difference, scaled, window=None, steps=150):
    source = pressure(900, 1)
    x = torch.tensor(network_input(source, difference, scaled))
    target = displacement(source)
    if scaled:
        target = (target - np.float32(SCALING["output_offset"])) / np.float32(SCALING["output_scale"])
    y = torch.tensor(target)
    if window:
        x = x[0].unfold(0, window, 1).transpose(1, 2)
        y = y[window - 1 :]
    optimiser = torch.optim.Adam(module.parameters(), lr=0.02)
    for _ in range(steps):
        optimiser.zero_grad()
        ((module(x).flatten() - y.flatten()) ** 2).mean().backward()
        optimiser.step()
    return module.eval()


def torch_cases():
    check = pressure(SAMPLES, 7)
    torch.manual_seed(1)
    single = train_torch(Stacked(1, 12), False, True)
    double = train_torch(Stacked(2, 8, layers=2), True, False)
    pair = train_torch(TwoModules(), False, True)
    window = train_torch(Stacked(1, 8, last=True), False, True, window=25)
    with torch.no_grad():
        run = lambda module, difference, scaled: to_mm(module(torch.tensor(network_input(check, difference, scaled))), scaled)
        network_state.save_torch(single, HERE / "torch_single.safetensors", **CHANNELS, **SCALING)
        network_state.save_check(HERE / "torch_single.csv", check, run(single, False, True))
        # As it comes from the framework, without our metadata and with a prefix.
        save_file({f"estimator.{name}": value for name, value in double.state_dict().items()}, HERE / "torch_double.safetensors")
        network_state.save_check(HERE / "torch_double.csv", check, run(double, True, False))
        network_state.save_torch(pair, HERE / "torch_pair.safetensors", **CHANNELS, **SCALING)
        network_state.save_check(HERE / "torch_pair.csv", check, run(pair, False, True))
        network_state.save_torch(window, HERE / "torch_window.safetensors", **CHANNELS, **SCALING, window=25)
        windows = torch.tensor(network_input(check, False, True))[0].unfold(0, 25, 1).transpose(1, 2)
        expected = np.concatenate([np.full(24, np.nan, np.float32), to_mm(window(windows), True)])
        network_state.save_check(HERE / "torch_window.csv", check, expected)
    return single, double, window


def keras_model(units, activation):
    layers = [keras.layers.Input((None, 1))]
    layers += [keras.layers.LSTM(width, return_sequences=True, activation=activation) for width in units]
    layers += [keras.layers.Dropout(0.1), keras.layers.Dense(1)]
    return keras.Sequential(layers)


def keras_cases():
    source, check = pressure(900, 1), pressure(SAMPLES, 8)
    target = ((displacement(source) - SCALING["output_offset"]) / SCALING["output_scale"])[None, :, None]
    for name, units, activation in (("keras_single", (12,), "tanh"), ("keras_double", (10, 6), "tanh"), ("keras_relu", (10,), "relu")):
        keras.utils.set_random_seed(2)
        model = keras_model(units, activation)
        model.compile(optimizer=keras.optimizers.Adam(0.01, clipnorm=1.0), loss="mse")
        model.fit(network_input(source, False, True), target, epochs=60, verbose=0)
        network_state.save_keras(model, HERE / f"{name}.safetensors", **CHANNELS, **SCALING)
        expected = to_mm(keras.ops.convert_to_numpy(model(network_input(check, False, True), training=False)), True)
        network_state.save_check(HERE / f"{name}.csv", check, expected)


def export_torch(module, features, name, length):
    """The graph as PyTorch writes it, checked by the ONNX runtime."""
    example = torch.zeros(1, length, features)
    torch.onnx.export(module, (example,), str(HERE / f"{name}.onnx"), dynamo=False, opset_version=17, verbose=False)
    graph = onnx.load(HERE / f"{name}.onnx")
    for node in graph.graph.node:
        node.doc_string = ""
    graph.doc_string = ""
    onnx.save(graph, HERE / f"{name}.onnx")


def by_hand(module):
    """One LSTM node and MatMul and Add, batch first (layout 1), with the metadata that our importer reads."""
    state = {name: value.detach().numpy() for name, value in module.state_dict().items()}
    units = state["recurrent.weight_hh_l0"].shape[1]

    def gates(rows):
        i, f, g, o = np.split(rows, 4)
        return np.concatenate([i, o, f, g])

    weights = {
        "W": gates(state["recurrent.weight_ih_l0"])[None],
        "R": gates(state["recurrent.weight_hh_l0"])[None],
        "B": np.concatenate([gates(state["recurrent.bias_ih_l0"]), gates(state["recurrent.bias_hh_l0"])])[None],
        "kernel": state["head.weight"].T.copy(),
        "bias": state["head.bias"],
    }
    nodes = [
        helper.make_node("LSTM", ["x", "W", "R", "B"], ["steps"], name="lstm", hidden_size=units),
        helper.make_node("Squeeze", ["steps", "axes"], ["hidden"], name="one_direction"),
        helper.make_node("MatMul", ["hidden", "kernel"], ["product"], name="dense"),
        helper.make_node("Add", ["product", "bias"], ["y"], name="dense_bias"),
    ]
    graph = helper.make_graph(
        nodes,
        "by_hand",
        [helper.make_tensor_value_info("x", TensorProto.FLOAT, ["time", 1, 1])],
        [helper.make_tensor_value_info("y", TensorProto.FLOAT, ["time", 1, 1])],
        [numpy_helper.from_array(np.ascontiguousarray(value), name) for name, value in weights.items()]
        + [numpy_helper.from_array(np.array([1]), "axes")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    entries = network_state._metadata("PyTorch, graph by hand", **CHANNELS, **SCALING)
    helper.set_model_props(model, entries)
    onnx.checker.check_model(model, full_check=True)
    onnx.save(model, HERE / "onnx_by_hand.onnx")


def onnx_cases(single, double, window):
    check = pressure(SAMPLES, 9)

    def infer(name, x):
        session = onnxruntime.InferenceSession(HERE / f"{name}.onnx")
        return session.run(None, {session.get_inputs()[0].name: x})[0]

    by_hand(single)
    x = network_input(check, False, True).transpose(1, 0, 2)
    network_state.save_check(HERE / "onnx_by_hand.csv", check, to_mm(infer("onnx_by_hand", x), True))
    export_torch(double, 2, "onnx_torch_double", SAMPLES)
    network_state.save_check(HERE / "onnx_torch_double.csv", check, to_mm(infer("onnx_torch_double", network_input(check, True, False)), False))
    export_torch(window, 1, "onnx_torch_window", 25)
    windows = np.lib.stride_tricks.sliding_window_view(network_input(check, False, True)[0, :, 0], 25)[:, None, :, None]
    outputs = np.concatenate([infer("onnx_torch_window", np.ascontiguousarray(part)).ravel() for part in windows])
    network_state.save_check(HERE / "onnx_torch_window.csv", check, np.concatenate([np.full(24, np.nan, np.float32), to_mm(outputs, True)]))


def lagged(pressure_bar, lags, scaled):
    """What a network without memory sees, [samples, lags], the oldest first; before the first sample the input rests where it begins."""
    normalised = network_input(pressure_bar, False, scaled)[0, :, 0]
    padded = np.concatenate([np.full(lags - 1, normalised[0]), normalised])
    return np.ascontiguousarray(np.lib.stride_tricks.sliding_window_view(padded, lags)).astype(np.float32)


class Recurrent(torch.nn.Module):
    """GRU layers with dense layers behind them."""

    def __init__(self, features, units, layers, *behind):
        super().__init__()
        self.recurrent = torch.nn.GRU(features, units, layers, batch_first=True)
        self.behind = torch.nn.Sequential(*behind)

    def forward(self, x):
        return self.behind(self.recurrent(x)[0])


def train_dense(module, lags):
    source = pressure(900, 1)
    x = torch.tensor(lagged(source, lags, True))
    y = torch.tensor((displacement(source) - np.float32(SCALING["output_offset"])) / np.float32(SCALING["output_scale"]))
    optimiser = torch.optim.Adam(module.parameters(), lr=0.02)
    for _ in range(150):
        optimiser.zero_grad()
        ((module(x).flatten() - y) ** 2).mean().backward()
        optimiser.step()
    return module.eval()


def other_cases():
    """GRU and dense layers."""
    nn = torch.nn
    check = pressure(SAMPLES, 10)
    torch.manual_seed(3)
    single = train_torch(Recurrent(1, 12, 1, nn.Linear(12, 1)), False, True)
    double = train_torch(Recurrent(2, 8, 2, nn.Linear(8, 10), nn.Tanh(), nn.Linear(10, 6), nn.Linear(6, 1)), True, False)
    hard = train_torch(Recurrent(1, 8, 1, nn.Linear(8, 10), nn.Hardtanh(), nn.Linear(10, 6), nn.Sigmoid(), nn.Linear(6, 1)), False, True)
    dense = train_dense(nn.Sequential(nn.Linear(10, 16), nn.Tanh(), nn.Linear(16, 12), nn.ReLU(), nn.Linear(12, 1)), 10)
    with torch.no_grad():
        run = lambda module, difference, scaled: to_mm(module(torch.tensor(network_input(check, difference, scaled))), scaled)
        network_state.save_torch(single, HERE / "torch_gru.safetensors", **CHANNELS, **SCALING)
        network_state.save_check(HERE / "torch_gru.csv", check, run(single, False, True))
        network_state.save_torch(
            double, HERE / "torch_gru_dense.safetensors", **CHANNELS, features=("input", "difference"), largest_step=0.1
        )
        network_state.save_check(HERE / "torch_gru_dense.csv", check, run(double, True, False))
        network_state.save_torch(dense, HERE / "torch_dense.safetensors", **CHANNELS, **SCALING, features=("lag:9..0",))
        network_state.save_check(HERE / "torch_dense.csv", check, to_mm(dense(torch.tensor(lagged(check, 10, True))), True))

    def infer(name, x):
        session = onnxruntime.InferenceSession(HERE / f"{name}.onnx")
        return session.run(None, {session.get_inputs()[0].name: x})[0]

    export_torch(hard, 1, "onnx_torch_gru", SAMPLES)
    network_state.save_check(HERE / "onnx_torch_gru.csv", check, to_mm(infer("onnx_torch_gru", network_input(check, False, True)), True))
    example = torch.zeros(1, 10)
    torch.onnx.export(dense, (example,), str(HERE / "onnx_torch_dense.onnx"), dynamo=False, opset_version=17, verbose=False)
    outputs = np.concatenate([infer("onnx_torch_dense", row[None]).ravel() for row in lagged(check, 10, True)])
    network_state.save_check(HERE / "onnx_torch_dense.csv", check, to_mm(outputs, True))

    source = pressure(900, 1)
    target = ((displacement(source) - SCALING["output_offset"]) / SCALING["output_scale"])[None, :, None]
    keras.utils.set_random_seed(4)
    layers = [keras.layers.Input((None, 1)), keras.layers.GRU(10, return_sequences=True), keras.layers.Dense(8, activation="relu")]
    model = keras.Sequential([*layers, keras.layers.Dense(6, activation="sigmoid"), keras.layers.Dense(1)])
    model.compile(optimizer=keras.optimizers.Adam(0.01, clipnorm=1.0), loss="mse")
    model.fit(network_input(source, False, True), target, epochs=60, verbose=0)
    network_state.save_keras(model, HERE / "keras_gru_dense.safetensors", **CHANNELS, **SCALING)
    expected = to_mm(keras.ops.convert_to_numpy(model(network_input(check, False, True), training=False)), True)
    network_state.save_check(HERE / "keras_gru_dense.csv", check, expected)


def several_inputs():
    """A network that sees two pressures, the change of the second, and the first three samples ago."""
    scaling = [(1.5, 1.5), (1.0, 0.8)]
    normalised = lambda pressures: [(values - np.float32(o)) / np.float32(s) for values, (o, s) in zip(pressures, scaling)]

    def seen(pressures):
        first, second = normalised(pressures)
        past = np.concatenate([np.repeat(first[:1], 3), first[:-3]])
        # The training script divided the change by a tenth of a bar.
        change = np.diff(pressures[1], prepend=pressures[1][:1]) / np.float32(0.1)
        return torch.tensor(np.stack([second, first, change, past], axis=-1)[None].astype(np.float32))

    draw = lambda samples, seed: [pressure(samples, seed), (0.6 * pressure(samples, seed + 100)).astype(np.float32)]
    source, check = draw(900, 21), draw(SAMPLES, 27)
    target = (displacement(source[0]) - 0.8 * displacement(source[1]) - 2) / 4
    torch.manual_seed(5)
    module = Stacked(4, 10)
    optimiser = torch.optim.Adam(module.parameters(), lr=0.02)
    for _ in range(150):
        optimiser.zero_grad()
        ((module(seen(source)).flatten() - torch.tensor(target)) ** 2).mean().backward()
        optimiser.step()
    network_state.save_torch(
        module.eval(),
        HERE / "torch_two_inputs.safetensors",
        input_channel=["bending_pressure:bar", "extending_pressure:bar"],
        output_channel="displacement:mm",
        sample_period_s=PERIOD_S,
        input_range=[(0.0, 3.0), (0.0, 1.8)],
        output_range=(-6.0, 12.0),
        input_offset=[offset for offset, _ in scaling],
        input_scale=[scale for _, scale in scaling],
        output_offset=2.0,
        output_scale=4.0,
        features=("input2", "input", "difference2", "lag:3"),
        difference_scale=[1.0, 0.1],
    )
    with torch.no_grad():
        expected = module(seen(check)).numpy().ravel() * np.float32(4) + np.float32(2)
    network_state.save_check(HERE / "torch_two_inputs.csv", np.stack(check, axis=-1), expected)


torch.set_num_threads(1)
wanted = sys.argv[1:] or ["lstm", "others", "inputs"]
if "lstm" in wanted:
    onnx_cases(*torch_cases())
    keras_cases()
if "others" in wanted:
    other_cases()
if "inputs" in wanted:
    several_inputs()
versions = {
    "torch": torch.__version__.split("+")[0],
    "keras": f"{keras.__version__}, backend torch",
    "onnx": onnx.__version__,
    "onnxruntime": onnxruntime.__version__,
    "numpy": np.__version__,
}
(HERE / "versions.json").write_text(json.dumps(versions, indent=2) + "\n")
