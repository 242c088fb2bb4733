"""Kinds of damaged input, each with the commands that read it, for the tests and for
benchmarks/fuzz.py.

`KINDS[kind](Site(seeds, place, Random(f"{kind}-{number}")))` writes an input into an empty folder
and returns the command lines to run there. Kind and number determine the input.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

from fuzz_hostile import HOSTILE_KINDS
from fuzz_seeds import SIDECAR
from fuzz_site import Site, Words
from fuzzing import EXTREMES, WORDS, broken_bytes, broken_json, broken_table, broken_toml

MAPPING = """rig = "one-dof"
loop = "open"
[time]
source = "t"
unit = "ms"
period_s = 0.003
max_gap_s = 0.05
repair = "late-stamps"
[signals.angle_deg]
source = "Winkel"
unit = "deg"
sign = -1
[signals.pressure_1_kpa]
source = "p1"
unit = "bar"
pressure = "absolute"
[signals.command]
source = "u"
unit = "1"
[atmosphere]
pressure_kpa = 100.0
[known]
inertia_kg_m2 = 0.0896
"""
SETTINGS = """[defaults]
seed = 1
jobs = 2
[diagnose]
without = ["clock-skew"]
rig = "one-dof"
[fit]
seed = 3
bootstrap = 0
effect = ["coulomb-friction"]
[generate-aprbs]
duration = 2.0
hold = [0.1, 0.5]
"""
#: log -> channels of the clock ("": each its own), of an angle, of a second signal
TEXT_LOGS = {
    "log.csv": ("t", "Winkel", "p1"),
    "log.lvm": ("", "angle", "p1"),
    "octave.mat": ("t", "angle", "angle"),
    "log.json": ("data/t", "data/angle", "data/f/1"),
}
BINARY_LOGS = {
    "v5.mat": ("t", "angle", "steps"),
    "v4.mat": ("ans/1", "ans/2", "ans/2"),
    "log.h5": ("rig/time", "rig/angle", "rig/both/2"),
    "log.tdms": ("", "rig/angle", "rig/force"),
    "log.mf4": ("", "angle", "force"),
    "log.bag": ("", "/joints/position/elbow", "/force/data"),
    "log.mcap": ("", "/joints/position/elbow", "/force/data"),
    "log.db3": ("", "/joints/position/elbow", "/force/data"),
    "log.parquet": ("t", "angle", "angle"),
}


# ---- kinds --------------------


def recording(site: Site) -> list[Words]:
    """A recording of 89 samples, checked or simulated with."""
    path = site.copy("rec.csv")
    if site.random.random() < 0.5:
        site.copy("rec.toml")
    path.write_bytes(broken_table(site.random, path.read_text()))
    if site.random.random() < 0.2:
        return [("simulate", "--excitation", path, "--rig", "one-dof", "--output", "out.csv")]
    return [("check", path, *(("--rig", "one-dof") if site.random.random() < 0.6 else ()))]


def fit(site: Site) -> list[Words]:
    """A recording that may still be fitted."""
    path = site.copy("fit.csv")
    site.copy("fit.toml")
    path.write_bytes(broken_table(site.random, path.read_text()))
    return [("fit", path, "--output", "run")]


def sidecar(site: Site) -> list[Words]:
    path = site.copy("rec.csv")
    path.with_suffix(".toml").write_bytes(broken_toml(site.random, SIDECAR))
    return (
        [("check", path)]
        if site.random.random() < 0.8
        else [
            (
                "simulate",
                "--excitation",
                site.copy("sent.csv"),
                "--rig",
                "one-dof",
                "--output",
                "out.csv",
            )
        ]
    )


def settings(site: Site) -> list[Words]:
    (site.place / "pamid.toml").write_bytes(broken_toml(site.random, SETTINGS))
    command: Words = ("fit", "rec.csv", "--output", "run")
    return [site.random.choice([("config",), command, ("generate-aprbs", "--output", "out.csv")])]


def raw_log(site: Site) -> list[Words]:
    """A text log, guessed or ingested."""
    name = site.one_of("log.csv", "log.csv", "log.csv", "log.lvm", "octave.mat", "log.json")
    path = site.copy(name)
    data = path.read_bytes()
    if name == "log.csv" and site.random.random() < 0.7:
        path.write_bytes(broken_table(site.random, data.decode("cp1252"), ";"))
    elif name == "log.json" and site.random.random() < 0.7:
        path.write_text(broken_json(site.random, json.loads(data)))
    else:
        path.write_bytes(broken_bytes(site.random, data))
    return _read_log(site, path)


def binary_log(site: Site) -> list[Words]:
    path = site.copy(site.one_of(*BINARY_LOGS))
    path.write_bytes(broken_bytes(site.random, path.read_bytes()))
    return _read_log(site, path)


def _read_log(site: Site, path: Path) -> list[Words]:
    if site.random.random() < 0.4:
        return [("ingest", "--guess", path)]
    clock, angle, force = {**TEXT_LOGS, **BINARY_LOGS}[path.name]
    lines = [
        'rig = "one-dof"',
        "[time]",
        *([f'source = "{clock}"', 'unit = "s"'] if clock else []),
        f'repair = "{site.one_of("none", "late-stamps", "jittered-sampling")}"',
        "[signals.angle_deg]",
        f'source = "{angle}"',
        'unit = "deg"',
        "[signals.force_1_n]",
        f'source = "{force}"',
        'unit = "N"',
    ]
    (site.place / "map.toml").write_text(
        MAPPING if path.name == "log.csv" else "\n".join(lines) + "\n"
    )
    return [("ingest", path, "--mapping", "map.toml", "--output", "out.csv")]


def mapping(site: Site) -> list[Words]:
    path = site.copy("log.csv")
    (site.place / "map.toml").write_bytes(broken_toml(site.random, MAPPING))
    return [("ingest", path, "--mapping", "map.toml", "--output", "out.csv")]


def run_folder(site: Site) -> list[Words]:
    """Any file of a diagnosed run."""
    folder = site.copy(site.one_of("explained", "partly-explained", "unknown-effect"))
    _break_one(site, folder, [p for p in sorted(folder.iterdir()) if p.is_file()])
    return [
        site.random.choice(
            [
                ("report", folder),
                ("report", folder),
                ("report", folder),
                ("train-residual", folder, "--iterations", "1", "--hidden", "2", "--jobs", "1"),
                ("animate", folder, "--size", "160"),
                ("export", folder, "--to", "c", "--output", "model"),
                (
                    "simulate",
                    "--model",
                    folder,
                    "--excitation",
                    site.copy("sent.csv"),
                    "--output",
                    "out.csv",
                ),
            ]
        )
    ]


def training(site: Site) -> list[Words]:
    """A checkpoint, the residual and what else a training goes on from."""
    folder = site.copy("explained")
    shutil.copy(site.seeds / "checkpoint.npz", folder)
    files = [folder / name for name in ("checkpoint.npz", "residual.csv", "fit.json", "run.json")]
    _break_one(site, folder, [*files[:1], *files])
    return [
        ("train-residual", folder, "--iterations", "1", "--hidden", "2", "--jobs", "1", "--resume")
    ]


def model(site: Site) -> list[Words]:
    """A fitted model with a network, simulated or exported."""
    folder = site.copy("fitted")
    files = ("fit.json", "fit.json", "network.json", "run.json", "network.npz")
    _break_one(site, folder, [folder / name for name in files])
    if site.random.random() < 0.5:
        return [
            (
                "simulate",
                "--model",
                folder,
                "--excitation",
                site.copy("sent.csv"),
                "--noise",
                "none",
                "--which",
                site.one_of("best", "refitted"),
                "--output",
                "out.csv",
            )
        ]
    return [("export", folder, "--to", site.one_of("c", "matlab", "onnx"), "--output", "model")]


def earlier(site: Site) -> list[Words]:
    """An earlier stage that a fit is to begin from."""
    folder = site.copy("fitted")
    _break_one(site, folder, [folder / "fit.json", folder / "run.json"])
    return [("fit", site.copy("rec.csv"), "--from", folder, "--output", "run")]


def resumed(site: Site) -> list[Words]:
    """A folder that a fit, a diagnosis or a trial is to go on with."""
    name = site.one_of("explained", "fitted", "trial")
    folder = site.copy(name)
    _break_one(site, folder, [folder / "run.json"])
    word = site.one_of("--resume", "--overwrite")
    if name == "trial":
        return [("trial", "--output", folder, "--cases", "1", "--index", "2/2", "--resume")]
    return [
        (
            site.one_of("fit", "diagnose"),
            site.copy("fit.csv"),
            "--held-out",
            "none.csv",
            "--output",
            folder,
            word,
        ),
        ("force-law", site.copy("map.csv"), "--sets", "99", "--output", folder, "--overwrite"),
    ]


def results(site: Site) -> list[Words]:
    """Results of single jobs and the journal, read by the library."""
    from pamid.parallel.result_store import Store

    folder = site.copy("jobs")
    path = site.random.choice(sorted(folder.iterdir()))
    path.write_bytes(broken_bytes(site.random, path.read_bytes()))
    store = Store(folder)
    store.get("ab" * 32)
    store.journal()
    return []


def trial(site: Site) -> list[Words]:
    folder = site.copy("trial")
    _break_one(site, folder, [folder / "trial.json", folder / "trial.json", folder / "run.json"])
    return [("report", folder)]


def force_map(site: Site) -> list[Words]:
    path = site.copy("map.csv")
    path.write_bytes(broken_table(site.random, path.read_text()))
    return [("force-law", path, "--sets", "2", "--held-out", "2", "--output", "law")]


def excitation(site: Site) -> list[Words]:
    """An excitation and its TOML."""
    path = site.copy("sent.csv")
    if site.random.random() < 0.6:
        path.write_bytes(broken_table(site.random, path.read_text()))
    else:
        path.with_suffix(".toml").write_bytes(broken_toml(site.random, SIDECAR))
    return [
        (
            "simulate",
            "--excitation",
            path,
            "--rig",
            "one-dof",
            "--noise",
            "none",
            "--output",
            "out.csv",
        )
    ]


def words(site: Site) -> list[Words]:
    """Mistyped options and arguments."""
    import click
    from pamid_cli.table import every_command

    command = site.random.choice(
        [c for c in every_command() if c.name not in ("demo", "reproduce-paper", "trial")]
    )
    line: list[str | Path] = [str(command.name)]
    for param in command.params:
        if isinstance(param, click.Argument):
            line.append(site.copy("rec.csv") if site.random.random() < 0.7 else _word(site))
        elif param.name not in ("cluster", "json", "debug", "help", "jobs") and (
            param.required or site.random.random() < 2.0 / len(command.params)
        ):
            values = (
                []
                if getattr(param, "is_flag", False)
                else [_word(site) for _ in range(param.nargs)]
            )
            if isinstance(param.type, click.Choice) and site.random.random() < 0.8:
                values = [site.random.choice(list(map(str, param.type.choices)))]
            line += [param.opts[0], *values]
    return [tuple(line)]


def _word(site: Site) -> str:
    """A word of a command line: it has no zero byte and names nothing outside the folder."""
    word = site.random.choice(
        [
            *EXTREMES,
            *WORDS,
            "0.003",
            "5",
            "out.csv",
            "a=1",
            "angle_deg=1e300",
            "x.csv/y.csv",
            "\udcff",
            "rec.csv",
            "",
            "x" * 5000,
            "-1",
            "1e300=1",
            "../rec.csv" * 2000,
        ]
    )
    return "here" if word in (".", "/", "~", "../x.py") else word


def _break_one(site: Site, folder: Path, files: list[Path]) -> None:
    """Damage one of the files according to its format, or as bytes; at times empty it or put a
    folder in its place."""
    path = site.random.choice(files)
    chance = site.random.random()
    if chance < 0.02:
        path.unlink()
        path.mkdir()
    elif chance < 0.04:
        path.write_bytes(b"")
    elif path.suffix == ".json" and chance < 0.85:
        path.write_text(broken_json(site.random, json.loads(path.read_text())))
    elif path.suffix == ".csv" and chance < 0.85:
        path.write_bytes(broken_table(site.random, path.read_text()))
    else:
        path.write_bytes(broken_bytes(site.random, path.read_bytes()))


#: kind -> its generator
KINDS: dict[str, Callable[[Site], list[Words]]] = {
    kind.__name__: kind
    for kind in (
        recording,
        fit,
        sidecar,
        settings,
        raw_log,
        binary_log,
        mapping,
        run_folder,
        training,
        model,
        earlier,
        resumed,
        results,
        trial,
        force_map,
        excitation,
        words,
        *HOSTILE_KINDS,
    )
}
#: shares of the inputs: small where a command takes long
WEIGHTS = {
    "recording": 16,
    "sidecar": 12,
    "settings": 10,
    "raw_log": 10,
    "binary_log": 4,
    "mapping": 10,
    "run_folder": 8,
    "training": 2,
    "model": 4,
    "earlier": 4,
    "resumed": 4,
    "results": 8,
    "trial": 2,
    "force_map": 0.5,
    "excitation": 8,
    "words": 10,
    "fit": 0.5,
    "values": 16,
    "diagnosed": 0.8,
    "declared": 6,
    "model_file": 5,
    "counts": 8,
}
