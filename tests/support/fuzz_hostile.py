"""Kinds of inputs that are well formed and hostile: values, declared sizes, model files, counts."""

import copy
import hashlib
import json
from collections.abc import Iterator
from random import Random
from typing import Any

import fuzz_archives
import fuzz_models
from fuzz_child import Site, Words
from fuzz_values import hostile_recording, wide_recording
from small_cart import RIG, others

#: numbers of samples and bytes in the binary logs of `fuzz_seeds`
SAMPLES = (60, 133, 400)
COUNTS = tuple(factor * n for n in SAMPLES for factor in (1, 8, 16))
FRACTIONS = (0.5, 1e-9, -0.5, 1e300, float("nan"))


def values(site: Site) -> list[Words]:
    """A recording whose numbers are hostile, mostly checked."""
    path = site.copy(site.one_of("rec.csv", "cart.csv", "cart.csv"))
    rig = RIG if path.name == "cart.csv" else "one-dof"
    choice = site.random.random()
    if choice < 0.05:
        path.write_text(wide_recording(site.random))
    else:
        path.write_text(hostile_recording(site.random, path.read_text()))
    if choice > 0.97:
        return [("fit", path, "--rig", rig, "--output", "run")]
    if choice > 0.9:
        return [("simulate", "--excitation", path, "--rig", rig, "--output", "out.csv")]
    if choice > 0.87:
        return [("new-rig", path, "--output", "out.py")]
    return [("check", path, *(("--rig", rig) if site.random.random() < 0.7 else ()))]


def diagnosed(site: Site) -> list[Words]:
    """A recording whose numbers are hostile, diagnosed with a few effects, rarely with all."""
    path = site.copy("cart.csv")
    path.write_text(hostile_recording(site.random, path.read_text()))
    words = ("diagnose", path, "--rig", RIG, "--no-check", "--jobs", "1", "--output", "run")
    return [words if site.random.random() < 0.02 else (*words, *others())]


def declared(site: Site) -> list[Words]:
    """An archive that declares more than it holds, guessed or ingested."""
    kind = site.one_of("hdf5", "hdf5", "mat", "parquet", "octave", "counts", "counts", "npz")
    if kind == "npz":
        return _declared_arrays(site)
    if kind == "hdf5":
        fuzz_archives.hdf5(site.random, site.place / "log.h5")
        path, clock, signal = site.place / "log.h5", "time", "angle"
    elif kind == "mat":
        is_new = site.random.random() < 0.6
        write = fuzz_archives.mat_v5 if is_new else fuzz_archives.mat_v4
        path, clock, signal = site.place / "log.mat", "t", "angle"
        path.write_bytes(write(site.random))
    elif kind == "parquet":
        path, clock, signal = site.place / "log.parquet", "c0", "c1"
        fuzz_archives.parquet(site.random, path)
    elif kind == "octave":
        path, clock, signal = site.copy("octave.mat"), "t", "angle"
        path.write_text(fuzz_archives.octave_text(site.random, path.read_text()))
    else:
        name = site.one_of(
            "v5.mat", "v4.mat", "log.tdms", "log.mf4", "log.bag", "log.mcap", "log.db3"
        )
        path, clock, signal = site.copy(name), "t", "angle"
        path.write_bytes(fuzz_archives.larger_counts(site.random, path.read_bytes(), COUNTS))
    if site.random.random() < 0.6:
        return [("ingest", "--guess", path)]
    (site.place / "map.toml").write_text(
        f'rig = "one-dof"\n[time]\nsource = "{clock}"\nunit = "s"\n'
        f'[signals.angle_deg]\nsource = "{signal}"\nunit = "deg"\n'
    )
    return [("ingest", path, "--mapping", "map.toml", "--output", "out.csv")]


def _declared_arrays(site: Site) -> list[Words]:
    """Weights of a network, or a checkpoint, whose arrays declare another size."""
    import numpy as np

    if site.random.random() < 0.6:
        folder, name = site.copy("fitted"), "network.npz"
        words: Words = (
            *("simulate", "--model", folder, "--excitation", site.copy("sent.csv")),
            *("--noise", "none", "--output", "out.csv"),
        )
    else:
        folder, name = site.copy("explained"), "checkpoint.npz"
        (folder / name).write_bytes((site.seeds / name).read_bytes())
        words = ("train-residual", folder, "--iterations", "1", "--hidden", "2", "--jobs", "1")
        words = (*words, "--resume")
    with np.load(folder / name) as arrays:
        names = tuple(arrays.files)
    content = fuzz_archives.npz(site.random, names)
    (folder / name).write_bytes(content)
    if name == "network.npz":  # weights with another digest are not read
        about = json.loads((folder / "network.json").read_text())
        about["weights"]["sha256"] = hashlib.sha256(content).hexdigest()
        (folder / "network.json").write_text(json.dumps(about))
    return [words]


def model_file(site: Site) -> list[Words]:
    """An MJCF, URDF or FMU file with hostile parts, checked, read back, simulated or exported."""
    write = site.random.choice(
        (fuzz_models.mjcf, fuzz_models.mjcf, fuzz_models.urdf, fuzz_models.fmu)
    )
    path = write(site.random, site.place)
    choice = site.random.random()
    if choice < 0.65:
        return [("check", path)]
    if choice < 0.85:
        return [("rigs", path)]
    return [
        ("simulate", "--excitation", site.copy("cart.csv"), "--rig", path, "--output", "out.csv")
    ]


def counts(site: Site) -> list[Words]:
    """A run or a trial with fractions where its JSON has whole numbers."""
    name = site.one_of("trial", "trial", "explained", "unknown-effect", "fitted", "resumed")
    folder = site.copy("trial" if name == "resumed" else name)
    files = [
        folder / file
        for file in ("trial.json", "run.json", "fit.json", "diagnosis.json", "network.json")
        if (folder / file).is_file()
    ]
    path = site.random.choice(files)
    path.write_text(fractional_counts(site.random, json.loads(path.read_text())))
    if name == "resumed":
        return [("trial", "--output", folder, "--cases", "1", "--index", "2/2", "--resume")]
    if name == "trial":
        return [("report", folder)]
    if name == "fitted":
        model = ("--model", folder, "--excitation", site.copy("sent.csv"))
        return [
            site.random.choice(
                (
                    ("simulate", *model, "--noise", "none", "--output", "out.csv"),
                    ("export", folder, "--to", "c", "--output", "model"),
                    ("runs", site.place),
                )
            )
        ]
    return [("report", folder)]


def fractional_counts(random: Random, content: Any) -> str:
    """JSON text with one to four of the whole numbers replaced by fractions or by other kinds of
    values."""
    content = copy.deepcopy(content)
    leaves = list(_whole_numbers(content))
    for holder, key in random.sample(leaves, min(len(leaves), random.randint(1, 4))):
        count = holder[key]
        holder[key] = random.choice(
            (
                count + random.choice(FRACTIONS),
                count + 0.5,
                float(count),
                -float(count) - 0.5,
                str(count),
                random.random() < 0.5,
                [count],
                2.0**63,
                10**400,
            )
        )
    return json.dumps(content).replace("NaN", "1e999")


def _whole_numbers(node: Any) -> Iterator[tuple[Any, Any]]:
    """Every place of an object tree that holds a whole number."""
    if not isinstance(node, dict | list):
        return
    for key, value in node.items() if isinstance(node, dict) else enumerate(node):
        if isinstance(value, int) and not isinstance(value, bool):
            yield node, key
        yield from _whole_numbers(value)


HOSTILE_KINDS = (values, diagnosed, declared, model_file, counts)
