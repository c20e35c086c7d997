"""Makes the files that `tests/formats.rs` reads, with the ordinary tool of each format.

    python3 -m venv formats-venv && formats-venv/bin/pip install numpy==2.4.6 scipy==1.17.1 mcap==1.6.0
    formats-venv/bin/python crates/recording/tests/formats/make.py

The same 80 samples stand in every file: `reference.csv` has them with all digits in s, bar and mm.
"""

import csv
import gzip
import json
import pathlib
import sys

import mcap
import numpy as np
import scipy
import scipy.io
from mcap.writer import CompressionType, Writer

HERE = pathlib.Path(__file__).parent
time_s = np.arange(80) * 0.02
pressure_bar = 1.0 + 0.75 * np.sin(2.0 * np.pi * 0.7 * time_s)
displacement_mm = 0.4 * pressure_bar + 0.05 * np.cos(2.0 * np.pi * 0.7 * time_s) - 0.1
OWN = ["time_s", "pressure_bar", "displacement_mm"]
columns = dict(zip(OWN, [time_s, pressure_bar, displacement_mm]))


def write_csv(path, names, rows, encoding="utf-8", **how):
    with open(HERE / path, "w", encoding=encoding, newline="") as file:
        writer = csv.writer(file, **how)
        writer.writerow(names)
        writer.writerows(rows)


rows = [[repr(float(value)) for value in row] for row in zip(*columns.values())]
write_csv("reference.csv", OWN, rows, lineterminator="\n")
with gzip.GzipFile(HERE / "gzip.csv.gz", "wb", mtime=0) as file:
    file.write((HERE / "reference.csv").read_bytes())
# What a spreadsheet saves as "CSV UTF-8" where the comma is the decimal sign.
commas = [[value.replace(".", ",") for value in row] for row in rows]
write_csv("excel.csv", ["Zeit (s)", "Druck (bar)", "Weg (mm)"], commas, "utf-8-sig", dialect="excel", delimiter=";")
write_csv("tab.tsv", OWN, rows, dialect="excel-tab")
lab = [[repr(float(t * 1000)), repr(float(p * 100)), repr(float(x * 1000))] for t, p, x in zip(*columns.values())]
write_csv("units.csv", ["time_ms", "pressure_kPa", "displacement_um"], lab)

np.savez(HERE / "savez.npz", **columns)
np.savez_compressed(HERE / "compressed.npz", **columns, rig="no. 3", channels=np.zeros((2, 3, 4)))
stacked = np.stack(list(columns.values()), axis=1)
np.savez_compressed(HERE / "matrix.npz", log=np.asfortranarray(stacked), log32=stacked.astype(">f4"), count=np.arange(80, dtype="<i2"))

scipy.io.savemat(HERE / "compressed.mat", columns, do_compression=True)
scipy.io.savemat(HERE / "columns.mat", columns, oned_as="column")
run = {"t": time_s, "p": pressure_bar, "x": displacement_mm, "n": np.arange(80, dtype=np.uint8), "name": "run 7"}
scipy.io.savemat(HERE / "structure.mat", {"run": run, "cell": np.array([1, "a"], dtype=object)}, do_compression=True)


def write_mcap(path, compression, split):
    with open(HERE / path, "wb") as file:
        writer = Writer(file, chunk_size=2048, compression=compression)
        writer.start()
        schema = writer.register_schema("rig.Sample", "jsonschema", b'{"type": "object"}')
        other = writer.register_channel("/log", "json", schema)
        channel = writer.register_channel("/rig", "json", schema)
        writer.add_message(other, 0, json.dumps({"text": "started", "level": 2}).encode(), 0)
        for t, p, x in zip(*(values.tolist() for values in columns.values())):
            sample = {"rig": {"p": p, "x": x}, "ok": True} if split else dict(zip(OWN, [t, p, x]))
            stamp = 1_700_000_000_000_000_000 + round(t * 1e9)
            writer.add_message(channel, stamp, json.dumps(sample).encode(), stamp)
        writer.finish()


write_mcap("zstd.mcap", CompressionType.ZSTD, False)
write_mcap("lz4.mcap", CompressionType.LZ4, False)
write_mcap("nested.mcap", CompressionType.NONE, True)

versions = {"python": sys.version.split()[0], "numpy": np.__version__, "scipy": scipy.__version__, "mcap": mcap.__version__}
(HERE / "VERSIONS").write_text("".join(f"{name} {version}\n" for name, version in versions.items()))
