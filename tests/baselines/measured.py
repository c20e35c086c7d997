"""Independent baselines on public measured recordings, and the files that `catheter` is judged on beside them.

    python3 -m venv ENV && ENV/bin/pip install numpy scipy scikit-learn     (Python 3.11 or newer)
    ENV/bin/python tests/baselines/measured.py prepare --data FOLDER --out PREPARED
    ENV/bin/python tests/baselines/measured.py baselines --prepared PREPARED --json baselines.json [--role development] [--map NAME...]

FOLDER holds the public sets (docs/how-to/import-recordings.md says where they come from), `maps.toml` beside this file says what is fitted
and judged. `prepare` needs no packages. It writes one CSV per recording, PREPARED/MAP/{train,test}/*.csv with the columns
`time_s`, inputs, output, and PREPARED/index.json; both programs read these files, so both see the same samples.
"""

import argparse
import csv
import json
import pathlib
import shutil
import sys
import tomllib

MAPS = pathlib.Path(__file__).with_name("maps.toml")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    prepare_parser = commands.add_parser("prepare", help="write the recordings of every map as CSV files")
    prepare_parser.add_argument("--data", type=pathlib.Path, required=True, help="folder with the public sets")
    prepare_parser.add_argument("--out", type=pathlib.Path, required=True, help="new folder, or one that an earlier run made")
    baselines_parser = commands.add_parser("baselines", help="fit and judge the baselines")
    baselines_parser.add_argument("--prepared", type=pathlib.Path, required=True, help="what `prepare` wrote")
    baselines_parser.add_argument("--json", type=pathlib.Path, required=True, help="file for the results")
    baselines_parser.add_argument("--role", choices=["development", "reporting", "all"], default="all")
    baselines_parser.add_argument("--map", nargs="*", help="only these maps")
    distort_parser = commands.add_parser("distort", help="write a map's recordings changed in a way that must not fool a program")
    distort_parser.add_argument("--prepared", type=pathlib.Path, required=True, help="what `prepare` wrote")
    distort_parser.add_argument("--map", required=True, help="name of the map")
    distort_parser.add_argument("--how", choices=DISTORTIONS, required=True)
    distort_parser.add_argument("--out", type=pathlib.Path, required=True, help="folder for train/ and test/")
    arguments = parser.parse_args()
    if arguments.command == "prepare":
        prepare(arguments.data, arguments.out)
    elif arguments.command == "distort":
        distort(arguments.prepared, arguments.map, arguments.how, arguments.out)
    else:
        import models  # Needs NumPy, SciPy and scikit-learn.

        models.run(arguments.prepared, arguments.json, arguments.role, arguments.map)


def prepare(data, out):
    """Writes the recordings of every map and their index."""
    with MAPS.open("rb") as file:
        described = tomllib.load(file)
    index_file = out / "index.json"
    if out.exists() and any(out.iterdir()) and not index_file.exists():
        sys.exit(f"{out}: not empty and not made by `prepare`; name another folder")
    index = {}
    for entry in described["map"]:
        recipe = described["sets"][entry["set"]]
        folder = out / entry["name"]
        shutil.rmtree(folder, ignore_errors=True)
        names = column_names(entry["columns"])
        sides, groups = {}, {}
        train_episodes = entry.get("train_episodes")
        for side in ("train", "test"):
            sides[side] = []
            for name in entry[side]:
                source = data / entry["set"] / name
                if not source.exists():
                    sys.exit(f"{source}: not there; is --data the folder with the public sets?")
                skip = recipe.get("skip", 0) + (recipe.get("skip_train", 0) if side == "train" else 0)
                found = list(recordings(source, recipe, entry["from"], skip))
                if train_episodes is not None:
                    found = found[:train_episodes] if side == "train" else found[train_episodes:]
                for suffix, rows in found:
                    path = folder / side / f"{source.stem}{suffix}.csv"
                    write(path, names, rows)
                    relative = path.relative_to(out).as_posix()
                    sides[side].append(relative)
                    if side == "test":
                        group = groups.setdefault(source.stem, {"recordings": [], "outputs": []})
                        group["recordings"].append(relative)
                        group["outputs"] += [row[-1] for row in rows]
        index[entry["name"]] = {
            "set": entry["set"],
            "role": entry["role"],
            "shift": entry["shift"],
            "licence": recipe["licence"],
            "columns": entry["columns"],
            "inputs": names[1:-1],
            "output": names[-1],
            "folds": entry.get("folds", "recordings"),
            **sides,
            # Recordings that are scored as one, over the range that their outputs have together.
            "groups": {
                name: {"recordings": group["recordings"], "range": max(group["outputs"]) - min(group["outputs"])}
                for name, group in groups.items()
            },
        }
    index_file.write_text(json.dumps(index, indent=1) + "\n")
    counts = {role: sum(entry["role"] == role for entry in index.values()) for role in ("development", "reporting")}
    print(f"{len(index)} maps in {out}: {counts['development']} development, {counts['reporting']} reporting")


def distort(prepared, name, how, out):
    """Writes the recordings of a map, distorted, to the folders `train` and `test` in `out`; prints the range of its test outputs."""
    for side in ("train", "test"):
        sources = [prepared / path for path in json.loads((prepared / "index.json").read_text())[name][side]]
        tables = [(source.stem, *read(source)) for source in sources]
        for stem, header, rows in DISTORTIONS[how](tables, side):
            write(out / side / f"{stem}.csv", header, rows)
    print(output_range(tables))


def copied(tables, side):
    """Every training recording twice. Left out, its copy must be too: what is promised must not get better."""
    copies = [(f"again-{stem}", header, rows) for stem, header, rows in tables]
    return tables + copies if side == "train" else tables


def scaled(tables, _):
    """Other units: inputs a hundredth, outputs times a thousand. Nothing but the numbers may change."""
    return [(stem, header, [[row[0], *(0.01 * u for u in row[1:-1]), 1000 * row[-1]] for row in rows]) for stem, header, rows in tables]


def renamed(tables, side):
    """Training recordings in the opposite order, with names that say nothing."""
    if side == "test":
        return tables
    return [(f"r{index:04}", header, rows) for index, (_, header, rows) in enumerate(reversed(tables))]


def unrelated(tables, _):
    """Outputs of the next recording, so that inputs explain nothing. What is promised must say so."""
    # A single test recording gets outputs half of it later; a single training recording that repeats itself would keep its law.
    result = []
    for index, (stem, header, rows) in enumerate(tables):
        other = tables[(index + 1) % len(tables)][2] if len(tables) > 1 else rows[len(rows) // 2 :] + rows[: len(rows) // 2]
        result.append((stem, header, [[*row[:-1], foreign[-1]] for row, foreign in zip(rows, other)]))
    return result


def raised(tables, side):
    """Test outputs higher by their range. A prediction that moves with them has looked at them."""
    if side == "train":
        return []
    raise_by = output_range(tables)
    return [(stem, header, [[*row[:-1], row[-1] + raise_by] for row in rows]) for stem, header, rows in tables]


def output_range(tables):
    outputs = [row[-1] for _, _, rows in tables for row in rows]
    return max(outputs) - min(outputs)


DISTORTIONS = {rule.__name__: rule for rule in (copied, scaled, renamed, unrelated, raised)}


def column_names(columns):
    """Names of the prepared file's columns, time first and output last."""
    roles = [part.split("=") for part in columns.split(",")]
    return [name for wanted in ("time", "input", "output") for role, name in roles if role.rstrip("0123456789") == wanted]


def recordings(source, recipe, wanted, skip):
    """The recordings of one source file, as (suffix of the name, rows of numbers with time in s first)."""
    header, table = read(source)
    column = {name: index for index, name in enumerate(header)}
    if "episodes" not in recipe:
        time, unit_s = column[recipe["time"]["column"]], recipe["time"]["unit_s"]
        start = max(skip, rise(table, column, recipe.get("begin_at_rise")))
        yield "", [[round(row[time] * unit_s, 9)] + [row[column[name]] for name in wanted] for row in table[start:]]
        return
    episodes = {}
    for row in table:
        episodes.setdefault(int(row[column[recipe["episodes"]]]), []).append(row)
    for number, rows in episodes.items():
        signals = [signal(rows, column, name, recipe) for name in wanted]
        times = [round(index * recipe["period_s"], 9) for index in range(len(rows))]
        yield f"-{number:06}", [list(values) for values in zip(times, *signals)][skip:]


def signal(rows, column, name, recipe):
    """A column of an episode; `sum:NAME` sums its changes within limits."""
    if not name.startswith("sum:"):
        return [row[column[name]] for row in rows]
    rule = recipe["sum"]
    value, values = rule["from"], []
    for row in rows:
        value = min(max(value + rule["gain"] * row[column[name.removeprefix("sum:")]], rule["low"]), rule["high"])
        values.append(round(value, 9))
    return values


def rise(table, column, rule):
    """The first row in which the column is about to rise after a rest."""
    if rule is None:
        return 0
    values, rest = [row[column[rule["column"]]] for row in table], rule["rest_rows"]
    for index in range(rest, len(values) - 1):
        if values[index + 1] > values[index] and all(value == values[index] for value in values[index - rest : index]):
            return index
    sys.exit(f"{rule['column']}: never rises after a rest of {rest} rows")


def read(source):
    """Header and rows of numbers of a CSV file, or of a space-separated one with comment lines before its header."""
    with source.open(newline="") as file:
        lines = [line for line in file if line.strip() and not line.startswith("#")]
    cells = csv.reader(lines) if source.suffix == ".csv" else (line.split() for line in lines)
    header = next(cells)
    return [name.strip() for name in header], [[float(cell) for cell in row] for row in cells]


def write(path, names, rows):
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        writer.writerows([[f"{value:.9g}" for value in row] for row in rows])


if __name__ == "__main__":
    main()
