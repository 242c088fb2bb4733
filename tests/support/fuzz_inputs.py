"""Kinds of damaged input, each with the commands that read it, for the tests and for
benchmarks/fuzz.py.

`KINDS[kind](Site(seeds, place, Random(f"{kind}-{number}")))` writes an input into an empty folder
and returns the command lines to run there. Kind and number determine the input.
"""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

from fuzz_child import Site, Words
from fuzz_hostile import HOSTILE_KINDS
from fuzz_seeds import SIDECAR
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
ONE_STEP = ("--iterations", "1", "--hidden", "2", "--jobs", "1")
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
        return [_simulated(path, "--rig", "one-dof")]
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
    if site.random.random() < 0.8:
        return [("check", path)]
    return [_simulated(site.copy("sent.csv"), "--rig", "one-dof")]


def _simulated(sent: Path, *more: str | Path) -> Words:
    return ("simulate", "--excitation", sent, *more, "--output", "out.csv")


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
    stamps = f'source = "{clock}"\nunit = "s"\n' if clock else ""
    repair = site.one_of("none", "late-stamps", "jittered-sampling")
    plain = (
        f'rig = "one-dof"\n[time]\n{stamps}repair = "{repair}"\n'
        f'[signals.angle_deg]\nsource = "{angle}"\nunit = "deg"\n'
        f'[signals.force_1_n]\nsource = "{force}"\nunit = "N"\n'
    )
    (site.place / "map.toml").write_text(MAPPING if path.name == "log.csv" else plain)
    return [("ingest", path, "--mapping", "map.toml", "--output", "out.csv")]


def mapping(site: Site) -> list[Words]:
    path = site.copy("log.csv")
    (site.place / "map.toml").write_bytes(broken_toml(site.random, MAPPING))
    return [("ingest", path, "--mapping", "map.toml", "--output", "out.csv")]


def run_folder(site: Site) -> list[Words]:
    """Any file of a diagnosed run."""
    folder = site.copy(site.one_of("explained", "partly-explained", "unknown-effect"))
    _break_one(site, folder, [p for p in sorted(folder.iterdir()) if p.is_file()])
    commands: list[Words] = [
        *[("report", folder)] * 3,
        ("train-residual", folder, *ONE_STEP),
        ("animate", folder, "--size", "160"),
        ("export", folder, "--to", "c", "--output", "model"),
        _simulated(site.copy("sent.csv"), "--model", folder),
    ]
    return [site.random.choice(commands)]


def training(site: Site) -> list[Words]:
    """A checkpoint, the residual and what else a training goes on from."""
    folder = site.copy("explained")
    shutil.copy(site.seeds / "checkpoint.npz", folder)
    files = [folder / name for name in ("checkpoint.npz", "residual.csv", "fit.json", "run.json")]
    _break_one(site, folder, [*files[:1], *files])
    return [("train-residual", folder, *ONE_STEP, "--resume")]


def model(site: Site) -> list[Words]:
    """A fitted model with a network, simulated or exported."""
    folder = site.copy("fitted")
    files = ("fit.json", "fit.json", "network.json", "run.json", "network.npz")
    _break_one(site, folder, [folder / name for name in files])
    if site.random.random() < 0.5:
        which = ("--noise", "none", "--which", site.one_of("best", "refitted"))
        return [_simulated(site.copy("sent.csv"), "--model", folder, *which)]
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
    command, where = site.one_of("fit", "diagnose"), ("--output", folder)
    return [
        (command, site.copy("fit.csv"), "--held-out", "none.csv", *where, word),
        ("force-law", site.copy("map.csv"), "--sets", "99", *where, "--overwrite"),
    ]


def results(site: Site) -> list[Words]:
    """Results of single jobs, read by the library."""
    from pamid.base.parallel.result_store import Store

    folder = site.copy("jobs")
    path = site.random.choice(sorted(folder.iterdir()))
    path.write_bytes(broken_bytes(site.random, path.read_bytes()))
    Store(folder).get("ab" * 32)
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
    return [_simulated(path, "--rig", "one-dof", "--noise", "none")]


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
    more = ("0.003", "5", "out.csv", "a=1", "angle_deg=1e300", "x.csv/y.csv", "\udcff", "rec.csv")
    rest = ("", "x" * 5000, "-1", "1e300=1", "../rec.csv" * 2000)
    word = site.random.choice([*EXTREMES, *WORDS, *more, *rest])
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


#: kind -> its generator, and the share of the inputs: small where a command takes long
_DAMAGED = {
    **{recording: 16, fit: 0.5, sidecar: 12, settings: 10, raw_log: 10, binary_log: 4},
    **{mapping: 10, run_folder: 8, training: 2, model: 4, earlier: 4, resumed: 4, results: 8},
    **{trial: 2, force_map: 0.5, excitation: 8, words: 10},
}
_HOSTILE = dict(zip(HOSTILE_KINDS, (16, 0.8, 6, 5, 8), strict=True))
KINDS: dict[str, Callable[[Site], list[Words]]] = {
    kind.__name__: kind for kind in (*_DAMAGED, *HOSTILE_KINDS)
}
WEIGHTS = {kind.__name__: share for kind, share in {**_DAMAGED, **_HOSTILE}.items()}
