"""The helper that writes networks of PyTorch: what it writes, and what it refuses. PyTorch is played by a stand-in of its names."""

import csv
import shutil
import subprocess
import sys
import types
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("safetensors")

from safetensors import safe_open  # noqa: E402

import catheter  # noqa: E402
from catheter import network_state  # noqa: E402

CHANNELS = {
    "input_channel": "pressure:bar",
    "output_channel": "displacement:mm",
    "sample_period_s": 0.02,
    "input_range": (0.0, 3.0),
    "output_range": (0.0, 12.0),
}


class Tensor:
    """An array with the methods of a tensor that the helper calls."""

    def __init__(self, values):
        self.values = np.asarray(values, dtype=np.float32)

    def detach(self):
        return self

    cpu = contiguous = detach

    def numpy(self):
        return self.values


@pytest.fixture
def torch(monkeypatch):
    """Classes with the names that `torch.nn` has."""
    module = types.ModuleType("torch")
    module.__version__ = "2.0.0+cpu"
    names = ("ModuleList", "ModuleDict", "LSTM", "LSTMCell", "GRU", "GRUCell", "RNN", "Linear", "Dropout", "Identity")
    names += ("Tanh", "ReLU", "Sigmoid", "Hardtanh", "LayerNorm")
    module.nn = types.SimpleNamespace(**{name: type(name, (), {"__module__": "torch.nn.modules"}) for name in names})
    module.nn.Sequential = Sequential
    monkeypatch.setitem(sys.modules, "torch", module)
    return module


class Sequential:
    """Parts one after the other."""

    def __init__(self, *parts):
        self.parts = [(str(index), part) for index, part in enumerate(parts)]

    def named_children(self):
        return self.parts


class Network:
    """A module with named parts and a state."""

    def __init__(self, state=None, **parts):
        self.parts, self.state = parts, state or {}

    def named_modules(self):
        inside = [(f"{name}.{child}", layer) for name, part in self.parts.items() for child, layer in getattr(part, "parts", [])]
        return [("", self), *self.parts.items(), *inside]

    def state_dict(self):
        return self.state


def weights(units=2, seed=0):
    """The state of one LSTM layer with a linear output, with PyTorch's names and shapes."""
    random = np.random.default_rng(seed)
    shapes = {
        "lstm.weight_ih_l0": (4 * units, 1),
        "lstm.weight_hh_l0": (4 * units, units),
        "lstm.bias_ih_l0": (4 * units,),
        "lstm.bias_hh_l0": (4 * units,),
        "linear.weight": (1, units),
        "linear.bias": (1,),
    }
    return {name: Tensor(0.5 * random.standard_normal(shape)) for name, shape in shapes.items()}


def test_a_network_is_written_with_what_weights_do_not_tell(torch, tmp_path):
    network = Network(weights(), lstm=torch.nn.LSTM(), drop=torch.nn.Dropout(), linear=torch.nn.Linear())
    network_state.save_torch(network, tmp_path / "network.safetensors", **CHANNELS)
    with safe_open(tmp_path / "network.safetensors", framework="numpy") as file:
        assert sorted(file.keys()) == sorted(network.state)
        np.testing.assert_array_equal(file.get_tensor("linear.weight"), network.state["linear.weight"].values)
        metadata = file.metadata()
    assert metadata["catheter.framework"] == "PyTorch 2.0.0" and metadata["catheter.activation"] == "tanh"
    assert metadata["catheter.input"] == "pressure:bar" and metadata["catheter.input_range"] == "0.0,3.0"
    assert metadata["catheter.window"] == "streaming" and "catheter.layers" not in metadata


def test_the_command_imports_it_and_the_package_runs_it_as_numpy_does(torch, command, tmp_path):
    network = Network(weights(), lstm=torch.nn.LSTM(), linear=torch.nn.Linear())
    network_state.save_torch(network, tmp_path / "network.safetensors", **CHANNELS)
    pressure_bar = 1.5 + np.sin(0.1 * np.arange(200))
    expected = lstm({name: value.values.astype(float) for name, value in network.state.items()}, pressure_bar)
    network_state.save_check(tmp_path / "check.csv", pressure_bar, expected)
    model = tmp_path / "model.safetensors"
    command("import-network", tmp_path / "network.safetensors", "--check", tmp_path / "check.csv", "--out", model)
    np.testing.assert_allclose(catheter.simulate(model, pressure_bar), expected, atol=1e-5)


def lstm(state, values):
    """An LSTM with PyTorch's order of gates: input, forget, candidate, output."""

    def sigmoid(x):
        return 1 / (1 + np.exp(-x))

    units = state["linear.weight"].shape[1]
    hidden, cell, outputs = np.zeros(units), np.zeros(units), []
    bias = state["lstm.bias_ih_l0"] + state["lstm.bias_hh_l0"]
    for value in values:
        gates = state["lstm.weight_ih_l0"][:, 0] * value + state["lstm.weight_hh_l0"] @ hidden + bias
        enter, forget, candidate, leave = np.split(gates, 4)
        cell = sigmoid(forget) * cell + sigmoid(enter) * np.tanh(candidate)
        hidden = sigmoid(leave) * np.tanh(cell)
        outputs.append(state["linear.weight"][0] @ hidden + state["linear.bias"][0])
    return np.array(outputs)


def metadata_of(network, path, **options):
    network_state.save_torch(network, path, **CHANNELS, **options)
    with safe_open(path, framework="numpy") as file:
        return file.metadata()


def test_gru_and_dense_layers_are_written_with_what_follows_them(torch, tmp_path):
    nn = torch.nn
    hard = nn.Hardtanh()
    hard.min_val, hard.max_val = -1.0, 1.0
    behind = nn.Sequential(nn.Linear(), nn.Dropout(), nn.Tanh(), nn.Linear(), hard, nn.Linear(), nn.Linear())
    metadata = metadata_of(Network(weights(), gru=nn.GRU(), behind=behind), tmp_path / "a")
    assert metadata["catheter.dense_activation"] == "tanh,hard,linear"
    assert metadata["catheter.layers"] == "gru,behind.0,behind.3,behind.5,behind.6"
    assert metadata["catheter.activation"] == "tanh"
    lagged = metadata_of(Network(weights(), net=nn.Sequential(nn.Linear(), nn.ReLU(), nn.Linear())), tmp_path / "b", features=("lag:9..0",))
    assert (lagged["catheter.features"], lagged["catheter.dense_activation"]) == ("lag:9..0", "relu")
    assert "catheter.activation" not in lagged


def test_what_stands_in_a_forward_is_asked_for(torch, tmp_path):
    nn = torch.nn
    network = Network(weights(), gru=nn.GRU(), middle=nn.Linear(), head=nn.Linear())
    with pytest.raises(network_state.CannotRepresent, match="`middle`.*dense_activation"):
        network_state.save_torch(network, tmp_path / "x", **CHANNELS)
    assert metadata_of(network, tmp_path / "x", dense_activation=["sigmoid"])["catheter.dense_activation"] == "sigmoid"
    with pytest.raises(network_state.CannotRepresent, match="output must be linear"):
        network_state.save_torch(Network(weights(), net=nn.Sequential(nn.Linear(), nn.Tanh())), tmp_path / "y", **CHANNELS)


def test_parts_that_have_no_place_are_refused_by_name(torch, tmp_path):
    bidirectional, projected = torch.nn.LSTM(), torch.nn.LSTM()
    bidirectional.bidirectional, projected.proj_size = True, 3
    for part, message in (
        (torch.nn.RNN(), "`part` is a RNN"),
        (torch.nn.LayerNorm(), "`part` is a LayerNorm"),
        (bidirectional, "`part` is bidirectional"),
        (projected, "proj_size=3"),
    ):
        with pytest.raises(network_state.CannotRepresent, match=message):
            network_state.save_torch(Network(part=part), tmp_path / "x", **CHANNELS)
    assert not (tmp_path / "x").exists()


def test_check_vectors_leave_out_what_is_not_compared(tmp_path):
    network_state.save_check(tmp_path / "check.csv", [1.0, 2.0], [0.5, np.nan], sequence=[0, 1])
    rows = list(csv.reader((tmp_path / "check.csv").open(encoding="utf-8")))
    assert rows == [["input", "output", "sequence"], ["1", "0.5", "0"], ["2", "", "1"]]
    with pytest.raises(ValueError, match="different lengths"):
        network_state.save_check(tmp_path / "check.csv", [1.0], [1.0, 2.0])


def test_the_helper_works_in_a_checkout_that_was_not_installed(tmp_path):
    package = tmp_path / "catheter"
    package.mkdir()
    for name in ("__init__.py", "network_state.py"):
        shutil.copy(Path(catheter.__file__).with_name(name), package)
    code = "import catheter; from catheter import network_state; print(catheter.__file__); catheter.fit"
    result = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert str(package) in result.stdout
    assert "pip install ./python" in result.stderr
