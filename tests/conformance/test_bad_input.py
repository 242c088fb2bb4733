"""Bad input through the command line: one table of recordings, of words and of damaged runs, each
with its exit status, its code and key words. The same holds without --json, and nothing is left
behind."""

import json
import math
import re
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from identified_runs import fitted_run, joint_recording
from pamid_cli.frame import run
from synthetic_run import make_run, make_trial

from pamid.base.files import write_atomically
from pamid.base.json_file import read_json
from pamid.estimation.fit_files import residual_csv

ROWS = [
    f"{0.003 * k:.6g},{np.sin(k / 9):.6f},{40 * np.sin(k / 11):.6f},{k % 3}" for k in range(420)
]
HEAD = "time_s,command,angle_deg,force_1_n"
Files = dict[str, bytes | str]


def table(*lines: str) -> Files:
    return {"rec.csv": "\n".join(lines) + "\n"}


def cell(text: str, column: int = 2) -> Files:
    """The recording with this text in line 62."""
    cells = ROWS[60].split(",")
    cells[column] = text
    return table(HEAD, *ROWS[:60], ",".join(cells), *ROWS[61:])


def toml(text: str) -> Files:
    return {**table(HEAD, *ROWS), "rec.toml": text}


def clock(stamp: Callable[[int], float]) -> Files:
    return table(HEAD, *(f"{stamp(k):.17g},{row.partition(',')[2]}" for k, row in enumerate(ROWS)))


#: broken recordings, each with the exit status, the code and key words of `pamid fit`
RECORDINGS: dict[str, tuple[Files, int, str, str]] = {
    "nothing there": ({}, 3, "missing", "rec.csv"),
    "a namesake": ({"reg.csv": "x"}, 3, "missing", "reg.csv"),
    "empty": ({"rec.csv": b""}, 3, "empty", ""),
    "blank lines": ({"rec.csv": b"\n\n"}, 3, "empty", ""),
    "only a header": (table(HEAD), 3, "empty", ""),
    "no UTF-8": ({"rec.csv": b"time_s,\xff\n1,2\n"}, 3, "encoding", ""),
    "bad bytes below": ({"rec.csv": f"{HEAD}\n".encode() + b"\xff,1,2,3\n"}, 3, "encoding", ""),
    "a zero byte": ({"rec.csv": f"{HEAD}\n0,\x001,2,3\n"}, 3, "cell", "line 2|command"),
    "no time": (table(HEAD[7:], *ROWS), 3, "header", "line 1|time_s"),
    "no header": (table(*ROWS), 3, "header", "line 1"),
    "only time": (table("time_s", *("0" for _ in ROWS)), 3, "header", "line 1"),
    "semicolons": (table(HEAD.replace(",", ";"), "0;1;2;3"), 3, "header", "line 1"),
    "no name": (table("time_s,command,,force_1_n", *ROWS), 3, "header", "column 3"),
    "a comma too many": (table(f"{HEAD},", *ROWS), 3, "header", "column 5"),
    "the same name twice": (
        table("time_s,command,command,angle_deg", *ROWS), 3, "header", "command"),
    "a word": (cell("off"), 3, "cell", "line 62|angle_deg|off"),
    "no cell": (cell(""), 3, "cell", "line 62|angle_deg|empty"),
    "nan": (cell("nan"), 3, "cell", "line 62|angle_deg|nan"),
    "minus infinity": (cell("-inf"), 3, "cell", "line 62|-inf"),
    "NA": (cell("NA"), 3, "cell", "line 62|NA"),
    "truth value": (cell("True"), 3, "cell", "line 62|True"),
    "thousands": (cell("1_000"), 3, "cell", "line 62|1_000"),
    "1e999": (cell("1e999"), 3, "cell", "line 62|1e999"),
    "x 1e300": (cell("1e300"), 3, "range", "line 62"),
    "400 digits": (cell("9" * 400), 3, "cell", "line 62"),
    "5000 digits": (cell("9" * 5000), 3, "cell", "line 62"),
    "a row too short": (table(HEAD, *ROWS[:9], "0.027,1"), 3, "row", "line 11|2 cells|4 col"),
    "a row too long": (table(HEAD, ROWS[0] + ",7", *ROWS[1:]), 3, "row", "line 2|5 cells"),
    "decimal commas": (cell("1,5"), 3, "row", "line 62|5 cells"),
    "below a blank line": (
        table(HEAD, *ROWS[:9], "", *ROWS[9:59], "x,1,2,3", *ROWS[60:]), 3, "cell", "line 62"),
    "nothing but tiny": (
        table(HEAD, *(f"{r.rpartition(',')[0]},1e-200" for r in ROWS)), 3, "range", "force_1_n"),
    "stamps twice": (table(HEAD, ROWS[0], *ROWS), 3, "stamps-repeated", "line 3|time_s"),
    "stamps back": (table(HEAD, *ROWS[::-1]), 3, "stamps-unsorted", "line 3|time_s"),
    "a gap": (table(HEAD, *ROWS[:200], *ROWS[300:]), 3, "gap", "line 202|0.303 s"),
    "uneven": (clock(lambda k: 0.003 * k + 0.0005 * (k % 2)), 3, "stamps-uneven", "line 4"),
    "stamps x 1e300": (clock(lambda k: 1e300 * k), 3, "range", "time_s"),
    "no clock": (clock(lambda k: 1e-28 * k), 3, "stamps-period", "time_s"),
    "no digits": (clock(lambda k: 1e17 + 16.0 * k), 3, "stamps-resolution", "time_s"),
    "too short": (table(HEAD, *ROWS[:40]), 4, "too-short", "40 samples"),
    "too short to fit": (table(HEAD, *ROWS[:199]), 4, "data", "199 fitted"),
    "at rest": (
        table(HEAD, *(f"{r.split(',')[0]},0,{r.split(',')[2]},1" for r in ROWS)),
        4, "not-excited", "command|constant"),
    "no motion": (
        table(HEAD, *(f"{r.rsplit(',', 2)[0]},3,1" for r in ROWS)),
        4, "not-excited", "angle_deg|constant"),
    "no outputs": (
        table("time_s,command", *(",".join(r.split(",")[:2]) for r in ROWS)),
        3, "file", "angle_deg"),
    "no input": (
        table("time_s,angle_deg", *(",".join(r.split(",")[::2]) for r in ROWS)),
        3, "missing-column", "command"),
    "foreign unit": (table(HEAD.replace("deg", "degrees"), *ROWS), 3, "unit", "angle_deg"),
    "other quantity": (table(HEAD.replace("deg", "kpa"), *ROWS), 3, "unit", "angle_deg"),
    "unknown unit": (table(HEAD.replace("force_1_n", "force_1_lbs"), *ROWS), 3, "unit", "force_1"),
    "misspelt": (
        table(HEAD.replace("command", "comand"), *ROWS),
        3, "missing-column", "Did you mean 'comand'"),
    "TOML: no TOML": (toml("x"), 3, "toml", "rec.toml"),
    "TOML: no UTF-8": ({**table(HEAD, *ROWS), "rec.toml": b"\xff"}, 3, "encoding", "rec.toml"),
    "TOML: deep": (toml(f"a = {'[' * 4000}{']' * 4000}"), 3, "toml", "rec.toml"),
    "TOML: deeper than a rig": (toml(f"a = {'[' * 90}{']' * 90}"), 3, "toml", "rec.toml"),
    "TOML: 400 digits": (toml(f"[known]\nm_kg = {'9' * 400}"), 3, "toml", "19 digits"),
    "TOML: 5000 digits": (toml(f"[known]\nm_kg = {'9' * 5000}"), 3, "toml", "19 digits"),
    "TOML: inf": (toml("[known]\ninertia_kg_m2 = inf"), 3, "toml", "inertia_kg_m2"),
    "TOML: text": (toml('[known]\ninertia_kg_m2 = "1"'), 3, "toml", "inertia_kg_m2"),
    "TOML: zero": (toml("[known]\ninertia_kg_m2 = 0"), 3, "known", "inertia_kg_m2"),
    "TOML: true": (toml("[controller]\ncommand_limit = true"), 3, "toml", "command_limit"),
    "TOML: no table": (toml("known = 1"), 3, "toml", "[known]"),
    "TOML: a loop": (toml('[recording]\nloop = "clsoed"'), 3, "toml", "clsoed"),
    "TOML: a number": (toml("[recording]\nrig = 1"), 3, "toml", "rig"),
    "TOML: another period": (
        toml("[recording]\nsampling_period_s = 0.004"), 3, "sampling-period", "0.003"),
    "TOML: a negative period": (
        toml("[recording]\nsampling_period_s = -0.003"), 3, "sampling-period", "-0.003"),
    "TOML: no such parameter": (toml("[known]\ninertia_kg = 1.0"), 3, "file", "inertia_kg_m2"),
}  # fmt: skip

CART = (Path(__file__).parents[2] / "data" / "rigs" / "cart.py").read_text(encoding="utf-8")
UNUSED_PORT = CART.replace("ports = {", 'ports = {"spare": Port("reading", "m"), ')
NO_KIND = CART.replace("ports = {", 'ports = {"brake": Port("motin", "N"), ')
NO_NUMBER = CART.replace("p.mass_kg}", "((5.0 - p.mass_kg) ** 0.5)}")
#: words, exit status, code, key words. Beside a good rec.csv lie bad.csv, mass.py with a port that
#: passes nothing, kind.py with a port of no kind, root.py whose rates are no numbers, broken.py,
#: odd.csv with columns of no rig, evil.csv whose TOML names evil.py, a folder taken/, and a file
#: called file
WORDS: tuple[tuple[str, int, str, str], ...] = (
    ("", 2, "usage", ""),
    ("diagnos", 2, "usage", "diagnose"),
    ("--nonsense", 2, "usage", "--nonsense"),
    ("simulate", 2, "usage", "--excitation"),
    ("effects colomb-friction", 3, "unknown-effect", "coulomb-friction"),
    ("rigs one-dfo", 3, "", "one-dof"),
    ("rigs mass.py", 3, "", "spare|drop the port"),
    ("check rek.csv", 3, "", "rec.csv"),
    ("check mass.py", 3, "", "equations|'spare'"),
    ("check kind.py", 3, "", "'motion'"),
    ("check root.py", 3, "", "finite|at mass_kg = "),
    ("check broken.py", 3, "", "line 2"),
    ("effects --symptom wobbles", 2, "usage", "stops-short"),
    ("check null", 3, "", "pipe"),
    ("check taken", 3, "", "folder"),
    ("check rec.csv --figure file/x.png", 3, "", "file"),
    (f"check {'x' * 300}.csv", 3, "", "x"),
    ("fit rec.csv --efect leak", 2, "usage", "--efect"),
    ("fit rec.csv --seed -1", 2, "usage", "--seed"),
    ("fit rec.csv --rig one-dov", 3, "", "one-dof"),
    ("fit rec.csv --rig one-dof:exponentiel", 3, "", "exponential"),
    ("fit rec.csv --no-check --rig nowhere/cart.py", 3, "", "nowhere/cart.py"),
    ("fit rec.csv --rig mass.py", 3, "", ""),
    ("fit rec.csv --no-check --effect coulomb-fricton", 3, "", "coulomb-friction"),
    ("fit rec.csv --no-check --effect coulomb-friction@wrist", 3, "", "wrist|joint"),
    ("fit rec.csv --no-check --effect overflow", 3, "", "overflow|fits no port"),
    ("fit rec.csv --no-check --held-out bad.csv", 3, "cell", "line 62"),
    ("fit evil.csv", 3, "", "evil.py|--rig"),
    ("diagnose evil.csv", 3, "", "evil.py|--rig"),
    ("check evil.csv", 3, "", "evil.py|--rig"),
    (f"fit rec.csv --no-check --output {'x' * 300}", 3, "", ""),
    ("fit rec.csv --no-check --output taken", 3, "run-folder", "not a run"),
    ("fit rec.csv --no-check --output taken --overwrite", 3, "run-folder", "not a run"),
    ("fit rec.csv --no-check --output file", 2, "usage", "is a file"),
    ("diagnose odd.csv", 2, "usage", "No rig is named|--rig|pamid new-rig"),
    ("diagnose rec.csv --seed -1", 2, "usage", "--seed"),
    ("diagnose rec.csv --setting refit=5", 2, "usage", "refits"),
    ("diagnose rec.csv --setting refits", 2, "usage", "NAME=VALUE"),
    ("diagnose rec.csv --horizon long", 2, "usage", "seconds above 0"),
    ("simulate --excitation rec.csv --seed -1", 2, "usage", "--seed"),
    ("simulate --excitation rec.csv --effect dead-time:delay=0.03", 3, "", "delay_s"),
    ("simulate --excitation rec.csv --known inertia_kg=0.1", 3, "", "inertia_kg_m2"),
    ("simulate --excitation rec.csv --rig one-dof --output file/x.csv", 3, "", ""),
    ("simulate --excitation rec.csv --which cause", 2, "usage", "--model"),
    ("new-rig rec.csv --like two-mases", 2, "usage", "two-masses"),
    ("new-rig rec.csv --like one-dof", 2, "usage", "--rig one-dof"),
    ("new-rig rec.csv --like thermal-block", 3, "", "--column temperature_degc=NAME"),
    ("new-rig rec.csv --column force_n", 2, "usage", "force_n=drive_v"),
    ("ingest rec.csv", 2, "usage", ""),
    ("ingest --guess rec.csv bad.csv", 2, "usage", ""),
    ("ingest --guess rec.csv --mapping map.toml", 2, "usage", ""),
    ("ingest rec.csv --mapping map.toml", 3, "", "map.toml"),
    (f"export {'x' * 300} --to c", 3, "", ""),
    ("report file", 3, "", "file"),
    ("score taken rec.csv", 3, "", "taken"),
    ("generate-aprbs --seed -1", 2, "usage", "--seed"),
    ("generate-aprbs --seeed 1", 2, "usage", "--seed"),
    ("generate-aprbs --levels two", 2, "usage", "two"),
    ("generate-aprbs --loop half", 2, "usage", "half"),
    ("generate-aprbs --rig one-dog", 3, "", "one-dof"),
    ("generate-aprbs --loop open --amplitude 2", 2, "usage", "+-1"),
    ("generate-aprbs --hold 2 1", 2, "usage", "shorter"),
    ("generate-aprbs --hold 0.0001 1", 2, "usage", "shorter than a sample"),
    ("generate-aprbs --duration 0", 2, "usage", "duration is 0"),
    ("generate-aprbs --duration 1", 2, "usage", "no room"),
    ("generate-aprbs --duration inf", 2, "usage", "duration is inf"),
    ("generate-aprbs --levels 1", 2, "usage", "excite nothing"),
    ("generate-aprbs --rate-limit 0", 2, "usage", "rate limit is 0"),
    ("generate-aprbs --amplitude 0", 2, "usage", "positive"),
    ("generate-aprbs --amplitude nan", 2, "usage", "positive"),
    ("generate-aprbs --column force_n", 2, "usage", "--amplitude"),
    ("generate-aprbs --duration 20 --output file/x.csv", 3, "", ""),
    ("generate-aprbs --duration 20 --output rec.csv", 3, "", "--overwrite"),
    ("generate-aprbs --pressure 200", 2, "usage", "--pressure"),
    ("generate-aprbs --figure x.svg", 2, "usage", "PNG"),
    ("generate-aprbs --signal prbs --levels 3", 2, "usage", "--levels"),
    ("generate-aprbs --signal chirp --hold 1 2", 2, "usage", "--hold"),
    ("generate-aprbs --signal chirp --seed 3", 2, "usage", "--seed"),
    ("generate-aprbs --signal chirp --rate-limit 50", 2, "usage", "rate limit"),
    ("generate-aprbs --signal chirp --rig two-link --amplitude 190", 2, "usage", "+-180"),
    ("generate-aprbs --signal multisine --sweep log", 2, "usage", "--sweep"),
    ("generate-aprbs --signal staircase --duration 9", 2, "usage", "--duration"),
    ("generate-aprbs --signal torque-loops --loop open", 2, "usage", "--loop"),
    ("generate-aprbs --signal torque-loops --pressure 700", 2, "usage", "0 .. 600"),
    ("generate-aprbs --signal prbs --experiment valve-pulses", 2, "usage", "--signal"),
    ("generate-aprbs --signal prbs --loop open --amplitude 1.5", 2, "usage", "+-1"),
    ("generate-aprbs --rig two-link --loop open --amplitude command_2=1.1", 2, "usage", "+-1"),
    ("generate-aprbs --rig two-link --amplitude referenc_2_deg=3", 2, "usage", "reference_2_deg"),
    ("generate-aprbs --rig two-link --amplitude wide", 2, "usage", "wide"),
    ("generate-aprbs --rig two-link --muscle 11", 2, "usage", "--muscle"),
    ("generate-aprbs --rig two-link --experiment gravity-test --loop open", 2, "usage", "--loop"),
    (
        "generate-aprbs --rig two-link --experiment gravity-test --clamped 3",
        2,
        "usage",
        "clamped_2",
    ),
    ("generate-aprbs --rig two-link --experiment gravity-test --release 0 190", 2, "usage", "190"),
    ("generate-aprbs --rig two-link --experiment gravity-test --payload -1", 2, "usage", "payload"),
    ("generate-aprbs --rig two-link --experiment gravity-test --duration -1", 2, "usage", ""),
    ("generate-aprbs --rig two-link --experiment valve-pulses --muscle 13", 2, "usage", "11, 12"),
    ("generate-aprbs --rig two-link --experiment valve-pulses --level 1.5", 2, "usage", "(0, 1]"),
    ("generate-aprbs --rig two-link --experiment valve-pulses --period 0.05", 2, "usage", "pulse"),
    ("generate-aprbs --rig one-dof --experiment gravity-test", 2, "usage", "horizontal"),
    # of the fitted run
    ("simulate --model run --excitation rec.csv --which cause", 3, "", "no cause"),
    ("simulate --model run --excitation rec.csv --effect leak", 2, "usage", "effect files"),
    ("simulate --model run --excitation rec.csv --rig two-link", 3, "", "two-link"),
    ("simulate --model run --excitation rec.csv --set mas=1", 3, "", "no parameter"),
    ("simulate --model run --excitation slow.csv", 4, "", "0.003 s"),
    ("score run joint.csv", 4, "overlap", ""),
    ("score run slow.csv --fail-if 'angle_deg > nan'", 2, "usage", "--fail-if"),
    ("score run slow.csv --fail-if 'angle_deg > soon'", 2, "usage", "--fail-if"),
    ("score run slow.csv --fail-if 'angle_deg > '", 2, "usage", "--fail-if"),
    ("score run slow.csv", 4, "", "0.01 s"),
    ("train-residual run --network anfis --hidden 5", 2, "usage", "--hidden"),
    ("train-residual run --network narx --sets 3", 2, "usage", "--sets"),
    ("train-residual run --network anfis --device cpu", 2, "usage", "elman and narx"),
    ("train-residual run --device gpu", 2, "usage", "gpu"),
    ("train-residual run --network elmann", 2, "unknown-network", "elman"),
    ("train-residual run --channel angel_deg", 2, "usage", "angle_deg"),
    ("train-residual run --inputs reference_deg,angle_deg", 2, "usage", "angle_refitted_deg"),
    ("train-residual run --inputs comand_loop", 2, "usage", "command_loop"),
    ("train-residual run --inputs command,command", 2, "usage", "twice"),
    ("train-residual run --hidden 0", 2, "usage", "hidden"),
    ("train-residual run --hidden 80", 4, "", "cannot decide"),
    ("train-residual run --rig one-dof", 2, "usage", "--port PORT"),
    ("train-residual run --at jont", 2, "usage", "joint"),
    ("train-residual run --at valve", 2, "usage", "valve_1|valve_2"),
)

TRAIN, AT_PORT = "train-residual run --iterations 2", "train-residual run --at joint --iterations 2"
REPLAY = "simulate --model run --excitation rec.csv"
GONE = object()  # the key is removed


def _gap(text: str) -> str:
    return re.sub(r"(\n0\.297,0,0,0,)[^,]*", r"\1nan", text)


#: command, file, what is done to it (path of keys and value; old and new
#: text; a text: all of it; a number: where it is cut; None: removed), exit
#: status, key words
DAMAGED: tuple[tuple[str, str, Any, int, str], ...] = (
    (TRAIN, "residual.csv", None, 3, "does not exist"),
    (TRAIN, "residual.csv", "time_s,recording,part,window\n", 3, "no rows"),
    (TRAIN, "residual.csv", 1000, 3, "residual.csv"),
    (TRAIN, "residual.csv", _gap, 4, "nan"),
    (TRAIN, "fit.json", "{}", 3, "pamid.fit/1"),
    (TRAIN, "run.json", None, 3, "not a run folder"),
    (AT_PORT, "fit.json", ("recordings", 0, "path", "gone.csv"), 3, "gone.csv"),
    (AT_PORT, "fit.json", ("recordings", 0, "sha256", "0" * 64), 3, "changed since"),
    (AT_PORT, "run.json", ("inputs", 1, "sha256", "0" * 64), 3, "toml|changed since"),
    (AT_PORT, "fit.json", ("recordings", GONE), 3, "period_s"),
    (AT_PORT, "run.json", ("options", "rig", "my/rig.py"), 3, "add --rig my/rig.py"),
    (AT_PORT, "fit.json", ("model", "values", "viscous", 0.5), 4, "differ in angle_deg"),
    (AT_PORT, "fit.json", ("model", "effects", ["no-such-effect"]), 3, "no-such-effect"),
    (AT_PORT, "fit.json", ("model", GONE), 3, "does not list"),
    (REPLAY, "fit.json", ("model", GONE), 3, "does not hold its model"),
    (REPLAY, "fit.json", ("schema", "pamid.fit/2"), 3, "schema|pamid.fit/1"),
    (REPLAY, "fit.json", ("model", "values", "radius", GONE), 3, "radius"),
    (REPLAY, "fit.json", ("model", "values", "raduis", 1.0), 3, "raduis"),
    (REPLAY, "fit.json", ("model", "values", "radius", "x"), 3, "model.values.radius|number"),
    (REPLAY, "fit.json", ("model", "values", None), 3, "model.values|object"),
    (REPLAY, "fit.json", ("model", "effects", ["no-such-effect"]), 3, "unknown effect"),
    (REPLAY, "fit.json", ("model", "effects", ["leak"]), 3, "differ in"),
    (REPLAY, "fit.json", ("recordings", []), 3, "sampling period"),
    (REPLAY, "fit.json", ("model", "stepping", "substeps", 10**9), 3, "range"),
    (REPLAY, "fit.json", ("model", "stepping", "substeps", 0), 3, "range"),
    (REPLAY, "fit.json", ("rig", GONE), 3, "rig|text|missing"),
    (REPLAY, "fit.json", ("rig", "two-link"), 3, "one-dof"),
    (REPLAY, "fit.json", ("model", "values", "radius", math.inf), 3, "Infinity"),
    (REPLAY, "fit.json", ("model", [1]), 3, "model|object"),
    ("report page", "fit.json", -30, 3, "fit.json|line"),
    ("report page", "fit.json", ("schema", "pamid.fit/9"), 3, "schema|pamid.fit/1"),
    ("report page", "fit.json", ("mae", "angle_deg", 3), 3, "mae.angle_deg"),
    ("report page", "diagnosis.json", "[]", 3, "object"),
    ("report page", "diagnosis.json", ("schema", "pamid.diagnosis/1"), 3,
     "now pamid.diagnosis/3|separate probability|pamid diagnose"),
    ("report page", "diagnosis.json", ("schema", "pamid.diagnosis/4"), 3, "'pamid.diagnosis/3'"),
    ("report page", "diagnosis.json", ("verdict", "explaned"), 3, "verdict|explaned"),
    ("report page", "diagnosis.json", ("causes", []), 3, "a list of effects"),
    ("report page", "diagnosis.json", ("where", "windows_s", [[1.0]]), 3, "pairs"),
    ("report page", "diagnosis.json", ("ranking", 1, "effect", GONE), 3, "ranking[1].effect"),
    ("report page", "diagnosis.json", ("transfer", 0, "angle_deg", 3), 3, "transfer[0].angle_deg"),
    ("report page", "diagnosis.json", ("0.93", "1e999"), 3, "finite"),
    ("report page", "diagnosis.json", ("0.93", "NaN"), 3, "NaN"),
    ("report page", "network.json", ("171", "true"), 3, "n_weights|number"),
    ("report page", "residual.csv", ("time_s", "zeit_s"), 3, "time_s"),
    ("report page", "residual.csv", ("\n", "\n1,2\n"), 3, "residual.csv"),
    ("report page", "residual.csv", ("\n0,", "\n__import__('os').getcwd(),"), 3, "residual.csv"),
    ("report page", "trace.csv", "iteration,mse\n", 3, "trace.csv"),
    ("report page", "missing.csv", "time_s,recording,speed\n0,0,1\n", 3, "missing.csv"),
    ("report page", "run.json", None, 3, "not a run folder"),
    ("report trial", "trial.json", ("schema", "pamid.trial/9"), 3, "schema|pamid.trial/1"),
    ("report trial", "trial.json", ("rates", "unseen", GONE), 3, "rates.unseen"),
    ("report trial", "trial.json", ("rates", "port", "of", 3.5), 3, "rates.port.of|whole"),
    ("report trial", "trial.json", ("rates", "family_first", "share", "most"), 3, "share|number"),
    ("report trial", "trial.json", ("reliability", 0, "right", GONE), 3, "reliability[0].right"),
    ("report trial", "trial.json", ("confusion", []), 3, "confusion|object"),
)  # fmt: skip


def put(folder: Path, files: Files) -> None:
    for name, content in files.items():
        (folder / name).write_bytes(content.encode() if isinstance(content, str) else content)


@pytest.fixture(scope="module")
def joint(tmp_path_factory) -> Path:
    """A joint's recording and the run of a fit to it; the page's and the trial's run folder."""
    folder = tmp_path_factory.mktemp("joint")
    recording = joint_recording(folder)
    model = fitted_run(folder / "run", recording.path)
    write_atomically(folder / "run" / "residual.csv", residual_csv(model))
    make_run(folder / "page")
    make_trial(folder / "trial")
    return folder


@pytest.fixture
def here(joint, tmp_path, monkeypatch) -> Path:
    """The working folder: what is said at WORDS."""
    for name in ("run", "page", "trial"):
        shutil.copytree(joint / name, tmp_path / name)
    for name in ("csv", "toml"):
        shutil.copy(joint / f"rec.{name}", tmp_path / f"joint.{name}")
    put(tmp_path, {**table(HEAD, *ROWS), "bad.csv": cell("inf")["rec.csv"], "mass.py": UNUSED_PORT})
    put(tmp_path, {"odd.csv": table("time_s,drive_n_m,turn_rad,x_v", *ROWS)["rec.csv"]})
    put(tmp_path, {"kind.py": NO_KIND, "root.py": NO_NUMBER, "broken.py": "x = 1\nclass Rig(:\n"})
    put(
        tmp_path,
        {
            "slow.csv": "\n".join(
                [HEAD, *(f"{0.01 * k:.6g},{row.partition(',')[2]}" for k, row in enumerate(ROWS))]
            )
            + "\n"
        },
    )
    put(tmp_path, {"evil.csv": table(HEAD, *ROWS)["rec.csv"], "file": "mine"})
    put(tmp_path, {"evil.toml": '[recording]\nrig = "evil.py"\n', "evil.py": "open('ran', 'w')\n"})
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "thesis.txt").write_text("years of work")
    (tmp_path / "null").symlink_to("/dev/null")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def files(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name != "run.json"
    }


def refused(
    words: list[str], status: int, code: str, needles: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The command refuses, as JSON and in words, and leaves every file as it was."""
    before = files(Path.cwd())
    assert run([*words, "--json"]) == status
    told = json.loads(capsys.readouterr().out)
    if words[:1] == ["check"]:
        text = json.dumps(told, ensure_ascii=False)
    else:
        assert told["schema"] == "pamid.error/1" and told["code"] != "unexpected"
        assert not code or told["code"] == code, told
        text = f"{told['message']} {told['hint']}"
        assert len(told["message"]) < 1000, "a message is read, not a file"
    assert [n for n in needles.split("|") if n not in text] == [], text
    assert text.count("Did you mean 'rec.csv'") == ("rek.csv" in words)
    assert run(words) == status
    shown = capsys.readouterr()
    assert "Traceback" not in shown.err and (words[:1] == ["check"] or not shown.out)
    assert files(Path.cwd()) == before


@pytest.mark.parametrize("kind", RECORDINGS)
def test_recordings(kind, tmp_path, monkeypatch, capsys, cli):
    content, status, code, needles = RECORDINGS[kind]
    monkeypatch.chdir(tmp_path)
    put(tmp_path, content)
    refused(["fit", "rec.csv", "--rig", "one-dof"], status, code, needles, capsys)
    told = cli("check", "rec.csv", "--rig", "one-dof", code=3)
    for finding in told.get("findings", []):
        assert finding["detail"].count("Did you mean") <= 1, finding


@pytest.mark.parametrize(("words", "status", "code", "needles"), WORDS, ids=[w[0] for w in WORDS])
def test_words(words, status, code, needles, here, capsys):
    refused(shlex.split(words), status, code, needles, capsys)
    assert not (here / "ran").exists()


def damage(path: Path, change: Any) -> None:
    if change is None:
        path.unlink()
    elif isinstance(change, str):
        path.write_text(change)
    elif callable(change):
        path.write_text(change(path.read_text()))
    elif isinstance(change, int):
        path.write_bytes(path.read_bytes()[:change])
    elif path.suffix == ".json" and (len(change) > 2 or change[0] in read_json(path)):
        whole = inner = read_json(path)
        *way, key, value = change
        for name in way:
            inner = inner[name]
        if value is GONE:
            del inner[key]
        else:
            inner[key] = value
        path.write_text(json.dumps(whole))
    else:
        text = path.read_text()
        assert change[0] in text
        path.write_text(text.replace(*change, 1))


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("row", DAMAGED, ids=lambda row: f"{row[0]}, {row[1]}, {row[4]}")
def test_damaged_runs(row, here, capsys):
    words, file, change, status, needles = row
    folder = next(word for word in words.split() if word in ("run", "page", "trial"))
    damage(here / folder / file, change)
    refused(words.split(), status, "", needles, capsys)
