"""Hysteresis models of a pneumatic catheter: fit, simulate, discover, export to the microcontroller.

    import catheter

    recordings = catheter.read_recordings("recordings")          # or catheter.Recording(time_s, pressure_bar, displacement_mm)
    fit = catheter.fit(recordings)
    displacement_mm = fit.model.simulate(pressure_bar)
    fit.save("result")

Arrays go in and come out as NumPy's. Times are in s; every other channel has its unit in its name, such as "pressure_bar". The functions
do what the commands of the same names do. `CatheterError`, a ValueError, carries the tool's message.

`catheter.network_state` writes networks of PyTorch and Keras for `catheter import-network`; it is imported on its own.
"""

try:
    from ._native import (
        CatheterError,
        Fit,
        Model,
        Recording,
        __version__,
        discover,
        export,
        export_c,
        fit,
        load,
        read_recordings,
        simulate,
    )
except ModuleNotFoundError as missing:
    if missing.name != "catheter._native":
        raise

    # A checkout that was not installed: `catheter.network_state` is Python alone and shall work there too.
    def __getattr__(name):
        raise AttributeError(f"`catheter.{name}` needs the native part of the package; build it with `pip install ./python`")


__all__ = [
    "CatheterError",
    "Fit",
    "Model",
    "Recording",
    "__version__",
    "discover",
    "export",
    "export_c",
    "fit",
    "load",
    "read_recordings",
    "simulate",
]
