"""Kinds of damaged input, each with the commands that read it; the same for the tests and for benchmarks/fuzz.py.

An input is re-made from (kind, seed): `KINDS[kind](Site(seeds, place, Random(f"{kind}-{seed}")))` writes it into an
empty folder and gives the command lines to run there.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from random import Random

import numpy as np
from fuzzing import EXTREMES, WORDS, broken_bytes, broken_json, broken_table, broken_toml
from identified_runs import SEEN, fitted_run, put_network, random_network
from synthetic_run import make_run, make_trial
from virtual_joint import record

Words = tuple[str | Path, ...]

LOG = "t [ms];Winkel [°];p1 [bar];u\r\n" + "".join(
    f"{3 * k},{k % 7};{np.sin(k / 20):.3f};{1 + np.cos(k / 30):.4f};{(k // 40) % 3 - 1}\r\n".replace(".", ",")
    for k in range(120))
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
SIDECAR = """[recording]
rig = "one-dof"
loop = "closed"
sampling_period_s = 0.003

[known]
inertia_kg_m2 = 0.0896

[controller]
kp_per_deg = 0.1
kd_s_per_deg = 0.01
derivative_filter_s = 0.01
command_limit = 1.0
"""
#: log -> channels of the clock ("": each its own), of an angle, of a second signal
TEXT_LOGS = {"log.csv": ("t", "Winkel", "p1"), "log.lvm": ("", "angle", "p1"), "octave.mat": ("t", "angle", "angle")}
BINARY_LOGS = {
    "v5.mat": ("t", "angle", "steps"), "v4.mat": ("ans/1", "ans/2", "ans/2"),
    "log.h5": ("rig/time", "rig/angle", "rig/both/2"), "log.tdms": ("", "rig/angle", "rig/force"),
    "log.mf4": ("", "angle", "force"), "log.bag": ("", "/joints/position/elbow", "/force/data"),
    "log.mcap": ("", "/joints/position/elbow", "/force/data"), "log.db3": ("", "/joints/position/elbow", "/force/data"),
    "log.parquet": ("t", "angle", "angle")}  # fmt: skip


@dataclass(frozen=True)
class Site:
    """Where an input is made: whole files to damage, an empty folder, and the source of chance."""

    seeds: Path
    place: Path
    random: Random

    def copy(self, name: str) -> Path:
        """A whole file or folder, put into the place."""
        source, target = self.seeds / name, self.place / Path(name).name
        return Path(shutil.copytree(source, target) if source.is_dir() else shutil.copy(source, target))

    def one_of(self, *names: str) -> str:
        return self.random.choice(names)


def make_seeds(place: Path) -> Path:
    """The whole files that are damaged, made once."""
    place.mkdir(parents=True, exist_ok=True)
    record(place / "long.csv", 6.0)
    lines = (place / "long.csv").read_text().splitlines(keepends=True)
    (place / "rec.csv").write_text("".join(lines[:90]))
    (place / "fit.csv").write_text("".join(lines[:450]))
    for name in ("rec", "fit"):
        (place / f"{name}.toml").write_text(SIDECAR)
    fitted_run(place / "fitted", place / "long.csv")
    put_network(place / "fitted", random_network(_elman(), SEEN, "angle_deg", 1.0))
    for verdict in ("explained", "unknown-effect"):
        run = make_run(place / verdict, verdict)
        for name in ("residual.csv", "trace.csv", "missing.csv"):
            if (run / name).is_file():
                head, *rows = (run / name).read_text().splitlines(keepends=True)
                (run / name).write_text("".join([head, *rows[:: max(len(rows) // 150, 1)]]))
    make_trial(place / "trial")
    _checkpoint(place)
    _force_map(place / "map.csv")
    _excitation(place)
    _results(place)
    _raw_logs(place)
    return place


def _elman():  # type: ignore[no-untyped-def]
    from pamid.networks.elman import Elman

    return Elman(len(SEEN), 2)


def _checkpoint(place: Path) -> None:
    """Where a training of the run stood after its first step."""
    from pamid.leftover import read_leftover
    from pamid.residual_network import Wanted, train_correction

    train_correction(read_leftover(place / "explained"), wanted=Wanted("elman", 2, None), iterations=1, seed=0,
                     threads=1, checkpoint=place / "checkpoint.npz")


def _force_map(path: Path) -> None:
    rows = [f"{c:.3f},{p:.1f},{max(3.0 * p * (1 - 4 * c), 0.0):.4f}" for c in np.linspace(0, 0.25, 6)
            for p in np.linspace(0, 500, 7)]
    path.write_text("\n".join(["contraction,pressure_kpa,force_n", *rows]) + "\n")


def _excitation(place: Path) -> None:
    from pamid.excitation import aprbs
    from pamid.recording import write_recording

    reference = aprbs(0.3, 0.003, 20.0, seed=1, hold_s=(0.05, 0.1))
    write_recording(place / "sent.csv", np.arange(len(reference)) * 0.003, {"reference_deg": reference})
    (place / "sent.toml").write_text(SIDECAR)


def _results(place: Path) -> None:
    from pamid.results import Store

    store = Store(place / "jobs")
    store.put("ab" * 32, "a job", {"x": np.arange(5.0), "y": [1, float("inf"), {"z": "text"}], "n": None})


def _raw_logs(place: Path) -> None:
    """One log of every kind, as small as the writers allow."""
    import warnings

    import test_ingest_formats as written

    (place / "log.csv").write_bytes(LOG.encode("cp1252"))
    lvm = ["LabVIEW Measurement", "Writer_Version\t2", "Reader_Version\t2", "Separator\tTab", "Decimal_Separator\t.",
           "Multi_Headings\tYes", "X_Columns\tOne", "Time_Pref\tRelative", "***End_of_Header***", "", "Channels\t2",
           "Samples\t60\t60", "Y_Unit_Label\tdeg\tbar", "X_Dimension\tTime\tTime", "X0\t0.0\t0.0",
           "Delta_X\t0.003\t0.003", "***End_of_Header***", "X_Value\tangle\tp1\tComment"]
    lvm += [f"{0.003 * k:.6f}\t{np.sin(k / 9):.6f}\t{1 + np.cos(k / 7):.6f}" for k in range(60)]
    (place / "log.lvm").write_text("\n".join(lvm) + "\n")
    octave = ["# Created by Octave 8.4.0", "# name: t", "# type: matrix", "# rows: 60", "# columns: 1",
              *(f" {0.003 * k}" for k in range(60)), "", "", "# name: angle", "# type: matrix", "# rows: 1",
              "# columns: 60", " " + " ".join(f"{np.sin(k / 9):.6f}" for k in range(60)), "", ""]
    (place / "octave.mat").write_text("\n".join(octave) + "\n")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        written.write_mat(place / "v5.mat")
        from scipy.io import savemat

        savemat(place / "v4.mat", {"ans": np.vstack([written.TIME, written.ANGLE])}, format="4")
        written.write_hdf5(place / "log.h5")
        written.write_tdms(place / "log.tdms")
        written.write_mdf(place / "log.mf4")
        written.write_ros(place / "log.bag", "bag")
        written.mcap(place / "log.mcap")
        folder = written.write_ros(place / "bag2", "sqlite3")
        shutil.copy(next(folder.glob("*.db3")), place / "log.db3")
        import pyarrow
        import pyarrow.parquet

        table = pyarrow.table({"t": written.TIME, "angle": written.ANGLE})
        pyarrow.parquet.write_table(table, place / "log.parquet")


# ---- kinds -------------------------------------------------------------------------------------------------------


def recording(site: Site) -> list[Words]:
    """A recording of 89 samples; every one in fifty that is taken is simulated with as well."""
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
    return [("check", path)] if site.random.random() < 0.8 else [
        ("simulate", "--excitation", site.copy("sent.csv"), "--rig", "one-dof", "--output", "out.csv")]


def settings(site: Site) -> list[Words]:
    (site.place / "pamid.toml").write_bytes(broken_toml(site.random, SETTINGS))
    command: Words = ("fit", "rec.csv", "--output", "run")
    return [site.random.choice([("config",), command, ("generate-aprbs", "--output", "out.csv")])]


def raw_log(site: Site) -> list[Words]:
    """A log of any kind, guessed or ingested."""
    name = site.one_of("log.csv", "log.csv", "log.csv", "log.lvm", "octave.mat")
    path = site.copy(name)
    data = path.read_bytes()
    if name == "log.csv" and site.random.random() < 0.7:
        path.write_bytes(broken_table(site.random, data.decode("cp1252"), ";"))
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
    lines = ['rig = "one-dof"', "[time]", *([f'source = "{clock}"', 'unit = "s"'] if clock else []),
             f'repair = "{site.one_of("none", "late-stamps", "jittered-sampling")}"',
             "[signals.angle_deg]", f'source = "{angle}"', 'unit = "deg"',
             "[signals.force_1_n]", f'source = "{force}"', 'unit = "N"']
    (site.place / "map.toml").write_text(MAPPING if path.name == "log.csv" else "\n".join(lines) + "\n")
    return [("ingest", path, "--mapping", "map.toml", "--output", "out.csv")]


def mapping(site: Site) -> list[Words]:
    path = site.copy("log.csv")
    (site.place / "map.toml").write_bytes(broken_toml(site.random, MAPPING))
    return [("ingest", path, "--mapping", "map.toml", "--output", "out.csv")]


def run_folder(site: Site) -> list[Words]:
    """Any file of a diagnosed run."""
    folder = site.copy(site.one_of("explained", "unknown-effect"))
    _break_one(site, folder, [p for p in sorted(folder.iterdir()) if p.is_file()])
    return [site.random.choice([
        ("report", folder), ("report", folder), ("report", folder),
        ("train-residual", folder, "--iterations", "1", "--hidden", "2", "--jobs", "1"),
        ("animate", folder, "--size", "160"), ("export", folder, "--to", "c", "--output", "model"),
        ("simulate", "--model", folder, "--excitation", site.copy("sent.csv"), "--output", "out.csv")])]


def training(site: Site) -> list[Words]:
    """A checkpoint, the residual and what else a training goes on from."""
    folder = site.copy("explained")
    shutil.copy(site.seeds / "checkpoint.npz", folder)
    files = [folder / name for name in ("checkpoint.npz", "residual.csv", "fit.json", "run.json")]
    _break_one(site, folder, [*files[:1], *files])
    return [("train-residual", folder, "--iterations", "1", "--hidden", "2", "--jobs", "1", "--resume")]


def model(site: Site) -> list[Words]:
    """A fitted model with a network, simulated or exported."""
    folder = site.copy("fitted")
    files = ("fit.json", "fit.json", "network.json", "run.json", "network.npz")
    _break_one(site, folder, [folder / name for name in files])
    if site.random.random() < 0.5:
        return [("simulate", "--model", folder, "--excitation", site.copy("sent.csv"), "--noise", "none", "--which",
                 site.one_of("best", "refitted"), "--output", "out.csv")]
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
    return [(site.one_of("fit", "diagnose"), site.copy("fit.csv"), "--held-out", "none.csv", "--output", folder, word),
            ("force-law", site.copy("map.csv"), "--sets", "99", "--output", folder, "--overwrite")]


def results(site: Site) -> list[Words]:
    """Results of single jobs and the journal: read by the library, which trusts nothing that does not vouch for itself;
    what is damaged is worked out again."""
    from pamid.results import Store

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
    """What is sent to a rig, and the TOML beside it."""
    path = site.copy("sent.csv")
    if site.random.random() < 0.6:
        path.write_bytes(broken_table(site.random, path.read_text()))
    else:
        path.with_suffix(".toml").write_bytes(broken_toml(site.random, SIDECAR))
    return [("simulate", "--excitation", path, "--rig", "one-dof", "--noise", "none", "--output", "out.csv")]


def words(site: Site) -> list[Words]:
    """Options and arguments that somebody mistyped."""
    import click
    from pamid_cli.frame import every_command

    command = site.random.choice([c for c in every_command() if c.name not in ("demo", "reproduce-paper", "trial")])
    said: list[str | Path] = [str(command.name)]
    for param in command.params:
        if isinstance(param, click.Argument):
            said.append(site.copy("rec.csv") if site.random.random() < 0.7 else _word(site))
        elif param.name not in ("cluster", "json", "debug", "help", "jobs") and (
                param.required or site.random.random() < 2.0 / len(command.params)):
            values = [] if getattr(param, "is_flag", False) else [_word(site) for _ in range(param.nargs)]
            if isinstance(param.type, click.Choice) and site.random.random() < 0.8:
                values = [site.random.choice(list(map(str, param.type.choices)))]
            said += [param.opts[0], *values]
    return [tuple(said)]


def _word(site: Site) -> str:
    """Anything that reaches a program by its command line: no zero byte, nothing outside the folder is named."""
    word = site.random.choice([*EXTREMES, *WORDS, "0.003", "5", "out.csv", "a=1", "angle_deg=1e300", "x.csv/y.csv",
                               "\udcff", "rec.csv", "", "x" * 5000, "-1", "1e300=1", "../rec.csv" * 2000])
    return "here" if word in (".", "/", "~", "../x.py") else word


def _break_one(site: Site, folder: Path, files: list[Path]) -> None:
    """One of the files damaged as what it is, or as bytes; at times it is a folder, empty, or not there."""
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


#: kind -> how it is made; weight: share of the inputs, less where a command takes long
KINDS: dict[str, Callable[[Site], list[Words]]] = {
    made.__name__: made
    for made in (recording, fit, sidecar, settings, raw_log, binary_log, mapping, run_folder, training, model, earlier,
                 resumed, results, trial, force_map, excitation, words)}
WEIGHTS = {"recording": 16, "sidecar": 12, "settings": 10, "raw_log": 10, "binary_log": 4, "mapping": 10,
           "run_folder": 8, "training": 2, "model": 4, "earlier": 4, "resumed": 4, "results": 8, "trial": 2,
           "force_map": 0.5, "excitation": 8, "words": 10, "fit": 0.5}  # fmt: skip
