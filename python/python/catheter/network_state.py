"""Writes the weights of a PyTorch or Keras network for `catheter import-network`.

The file is safetensors: the weights under the framework's own names, and in its metadata what weights do not tell, such as units,
normalisation and sample period. Only numpy and safetensors are needed; PyTorch or Keras is imported by whoever made the network.

    save_torch(module, "network.safetensors", input_channel="pressure:bar", output_channel="displacement:mm", sample_period_s=0.02,
               input_range=(0.0, 3.0), output_range=(0.0, 12.0))
    save_check("check.csv", pressure_bar, displacement_mm)

Normalisation is what the training script did: the network saw `(value - offset) / scale` and gave `(value - offset) / scale`.
"""

import csv

import numpy as np
from safetensors.numpy import save_file

__all__ = ["save_torch", "save_keras", "save_check", "CannotRepresent"]


class CannotRepresent(ValueError):
    """The network has a part that the model file has no place for; the message names it."""


def _numbers(*values):
    return ",".join(repr(float(value)) for value in values)


def _metadata(
    framework,
    *,
    input_channel,
    output_channel,
    sample_period_s,
    input_range=None,
    output_range=None,
    input_offset=0.0,
    input_scale=1.0,
    output_offset=0.0,
    output_scale=1.0,
    features=None,
    difference_scale=None,
    largest_step=None,
    window=None,
):
    """The metadata of both frameworks; the arguments are described at `save_torch`."""
    several = not isinstance(input_channel, str)
    channels = list(input_channel) if several else [input_channel]
    if not 1 <= len(channels) <= 4:
        raise CannotRepresent(f"{len(channels)} inputs: one to four are possible")
    entries = {
        "catheter.framework": framework,
        "catheter.output": output_channel,
        "catheter.sample_period_s": _numbers(sample_period_s),
        "catheter.output_offset": _numbers(output_offset),
        "catheter.output_scale": _numbers(output_scale),
        "catheter.features": ",".join(features or [f"input{_number(index)}" for index in range(len(channels))]),
        "catheter.window": "streaming" if window is None else str(int(window)),
    }
    per_input = {
        "input{}_range": input_range,
        "input{}_offset": input_offset,
        "input{}_scale": input_scale,
        "difference{}_scale": difference_scale,
        "largest_step{}": largest_step,
    }
    for index, channel in enumerate(channels):
        entries[f"catheter.input{_number(index)}"] = channel
        for name, values in per_input.items():
            of_each = several and np.ndim(values) == (2 if values is input_range else 1)
            if of_each and len(values) != len(channels):
                raise ValueError(f"{name.format('')}: {len(values)} values for {len(channels)} inputs")
            value = values[index] if of_each else values
            if value is not None:
                entries[f"catheter.{name.format(_number(index))}"] = _numbers(*np.atleast_1d(value))
    if output_range is not None:
        entries["catheter.output_range"] = _numbers(*output_range)
    return entries


def _number(index):
    """The second input is `input2`; the first has no number."""
    return "" if index == 0 else str(index + 1)


def _torch_activation(part):
    """The name under which `catheter` knows a module that is an activation; None for others."""
    import torch

    if type(part) is torch.nn.Hardtanh:
        return "hard" if (part.min_val, part.max_val) == (-1, 1) else None
    return {torch.nn.Tanh: "tanh", torch.nn.ReLU: "relu", torch.nn.Sigmoid: "sigmoid"}.get(type(part))


def _torch_activations(module):
    """What follows each linear layer of a Sequential, by its name."""
    import torch

    found = {}
    for name, part in module.named_modules():
        if type(part) is torch.nn.Sequential:
            children = [(f"{name}.{child}" if name else child, layer) for child, layer in part.named_children()]
            kept = [(child, layer) for child, layer in children if type(layer) not in (torch.nn.Dropout, torch.nn.Identity)]
            for (child, layer), following in zip(kept, [layer for _, layer in kept[1:]] + [None]):
                if type(layer) is torch.nn.Linear:
                    found[child] = _torch_activation(following) or "linear"
    return found


def save_torch(module, path, *, dense_activation=None, **channels):
    """Writes a `torch.nn.Module` of up to four LSTM, GRU and linear layers and a linear output.

    input_channel, output_channel: quantity and unit, for example "pressure:bar". For a plant with up to four inputs `input_channel` is a list,
    and so is each of input_range, input_offset, input_scale, difference_scale and largest_step that differs between them.
    sample_period_s: time between samples.
    input_range, output_range: smallest and largest value in training, in the channel's unit.
    input_offset, input_scale, output_offset, output_scale: the normalisation of training; none by default.
    features: the network's inputs in their order, "input", "difference" (the change since the last sample) and "lag:N", the input N samples
    ago; "lag:9..0" is the last ten samples, the oldest first; "input2", "difference2" and "lag2:N" are those of the second input. Without it the
    inputs themselves.
    difference_scale: what the difference was divided by; `input_scale` by default.
    largest_step: largest change of the input from one sample to the next in training.
    window: samples of a window that starts from zero state; None carries the state from sample to sample.
    dense_activation: what follows the linear layers before the output, "tanh", "relu", "hard", "sigmoid" or "linear", one for each. In a
    `Sequential` it is found; what a `forward` of one's own does is not.

    Raises CannotRepresent for a module with other layers.
    """
    import torch

    containers = (torch.nn.Sequential, torch.nn.ModuleList, torch.nn.ModuleDict)
    layers, dense = [], []
    for name, part in module.named_modules():
        kind = type(part)
        if kind in (torch.nn.LSTM, torch.nn.LSTMCell, torch.nn.GRU, torch.nn.GRUCell):
            if getattr(part, "bidirectional", False):
                raise CannotRepresent(f"`{name}` is bidirectional: a controller does not know the future")
            if getattr(part, "proj_size", 0):
                raise CannotRepresent(f"`{name}` has a projection (proj_size={part.proj_size})")
            layers.append(name)
        elif kind is torch.nn.Linear:
            layers.append(name)
            dense.append(name)
        elif kind in (torch.nn.Dropout, torch.nn.Identity, *containers) or _torch_activation(part):
            continue
        elif kind.__module__.startswith("torch.nn."):
            raise CannotRepresent(
                f"`{name}` is a {kind.__name__}: LSTM, GRU, their cells, Linear, Tanh, ReLU, Hardtanh from -1 to 1, Sigmoid, Dropout and Identity "
                "are possible"
            )
    if dense_activation is None:
        found = _torch_activations(module)
        dense_activation = [found.get(name) for name in dense[:-1]]
        if None in dense_activation:
            name = dense[dense_activation.index(None)]
            raise CannotRepresent(f"what follows `{name}` stands in the module's forward: give dense_activation, one for each such layer")
        if dense and found.get(dense[-1], "linear") != "linear":
            raise CannotRepresent(f"`{dense[-1]}` has the activation {found[dense[-1]]}: the output must be linear")
    metadata = _metadata(f"PyTorch {torch.__version__.split('+')[0]}", **channels)
    if len(layers) > len(dense):
        metadata["catheter.activation"] = "tanh"
    if len(layers) > 2:
        metadata["catheter.layers"] = ",".join(layers)
    if dense_activation:
        metadata["catheter.dense_activation"] = ",".join(dense_activation)
    state = {name: value.detach().cpu().contiguous().numpy() for name, value in module.state_dict().items()}
    save_file(state, str(path), metadata)


def _keras_activation(layer):
    """The name under which `catheter` knows a Keras layer's cell activation."""
    config = layer.get_config()
    if config["recurrent_activation"] != "sigmoid":
        raise CannotRepresent(f"`{layer.name}` has {config['recurrent_activation']} gates: only sigmoid is possible")
    known = {"tanh": "tanh", "relu": "relu", "hard_tanh": "hard"}
    if config["activation"] not in known:
        raise CannotRepresent(f"`{layer.name}` has the activation {config['activation']}: tanh, relu and hard_tanh are possible")
    return known[config["activation"]]


def save_keras(model, path, **channels):
    """Writes a Keras model of up to four LSTM, GRU and Dense layers and a dense output; the arguments are those of `save_torch`.

    Raises CannotRepresent for a model with other layers.
    """
    import keras

    state, order, activations, dense_activations = {}, [], set(), []
    of_dense = {"linear": "linear", "tanh": "tanh", "relu": "relu", "hard_tanh": "hard", "sigmoid": "sigmoid"}
    for layer in model.layers:
        kind = type(layer).__name__
        if kind == "TimeDistributed":
            layer, kind = layer.layer, type(layer.layer).__name__
        if kind in ("LSTM", "GRU"):
            if layer.get_config()["go_backwards"]:
                raise CannotRepresent(f"`{layer.name}` runs backwards in time")
            if kind == "GRU" and not layer.get_config()["reset_after"]:
                raise CannotRepresent(f"`{layer.name}` has reset_after=False: only reset_after=True, Keras' default, is possible")
            activations.add(_keras_activation(layer))
            order.append(layer.name)
        elif kind == "Dense":
            activation = layer.get_config()["activation"]
            if activation not in of_dense:
                raise CannotRepresent(f"`{layer.name}` has the activation {activation}: {', '.join(of_dense)} are possible")
            dense_activations.append(of_dense[activation])
            order.append(layer.name)
        elif kind in ("InputLayer", "Dropout"):
            continue
        else:
            raise CannotRepresent(f"`{layer.name}` is a {kind}: LSTM, GRU, Dense, TimeDistributed(Dense) and Dropout are possible")
        for weight in layer.weights:
            name = weight.name.split("/")[-1].split(":")[0]
            # The states of dropout's random numbers are no weights.
            if name in ("kernel", "recurrent_kernel", "bias"):
                state[f"{layer.name}/{name}"] = np.ascontiguousarray(keras.ops.convert_to_numpy(weight))
    if len(activations) > 1:
        raise CannotRepresent(f"the recurrent layers have different activations: {', '.join(sorted(activations))}")
    if dense_activations and dense_activations[-1] != "linear":
        raise CannotRepresent(f"the output has the activation {dense_activations[-1]}: it must be linear")
    metadata = _metadata(f"Keras {keras.__version__}", **channels)
    metadata.update({"catheter.activation": activation for activation in activations})
    if len(order) > 2:
        metadata["catheter.layers"] = ",".join(order)
    if dense_activations[:-1]:
        metadata["catheter.dense_activation"] = ",".join(dense_activations[:-1])
    save_file(state, str(path), metadata)


def save_check(path, input_values, expected, sequence=None):
    """Writes check vectors: input samples and the output the framework gave, both in the channels' units, not normalised.

    input_values: one value a sample, or a row of them, [samples, inputs].
    sequence: a number per sample that changes where the network starts from zero state again; a NaN in `expected` is not compared.
    """
    inputs = np.asarray(input_values, dtype=float)
    inputs = inputs if inputs.ndim == 2 else inputs.reshape(-1, 1)
    columns = [*inputs.T, np.asarray(expected, dtype=float).ravel()]
    names = [*(f"input{_number(index)}" for index in range(inputs.shape[1])), "output"]
    if sequence is not None:
        columns.append(np.asarray(sequence, dtype=int).ravel())
        names.append("sequence")
    if len({len(column) for column in columns}) != 1:
        raise ValueError(f"the columns have different lengths: {[len(column) for column in columns]}")
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        for row in zip(*(column.tolist() for column in columns)):
            writer.writerow("" if value != value else f"{value:.9g}" if isinstance(value, float) else value for value in row)
