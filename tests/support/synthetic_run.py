"""A run folder and a trial's written by hand, with every file and every verdict, for the tests of
the report."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from pamid.base.metrics import wilson_interval
from pamid.base.schemas.diagnosis_file import DiagnosisFile
from pamid.base.schemas.model import read
from pamid.diagnosis.verdict.verdict_words import sentence
from pamid.trial.figure_table import JOINT_ROWS

#: verdicts whose model with the causes is replayed, and those that describe what is missing
WITH_CAUSE, DESCRIBED = ("explained", "partly-explained"), ("partly-explained", "unknown-effect")
PERIOD_S = 0.01
WINDOW_ROWS = 200
CHANNELS = {
    "angle_deg": (0.05, 1.29, 0.52, 0.11),
    "pressure_1_kpa": (0.4, 9.0, 2.1, 1.9),
    "pressure_2_kpa": (0.4, 8.0, 2.3, 2.0),
}


def run_json() -> dict[str, Any]:
    return {
        "schema": "pamid.run/1",
        "command": ["pamid", "diagnose", "rec.csv", "--rig", "one-dof", "--output", "RUN"],
        "seed": 3,
        "options": {},
        "inputs": [{"path": "rec.csv", "sha256": "ab" * 32}],
        "versions": {"python": "3.11.2", "pamid": "0.1.0", "numpy": "2.4.0"},
        "platform": "Linux",
        "begun": "2024-05-01T10:00:00+00:00",
        "ended": "2024-05-01T10:02:00+00:00",
        "outcome": "done",
        "steps": [],
    }


def fit_json() -> dict[str, Any]:
    def parameter(
        value: float, prior: float, unit: str, word: str, strain: float, bound: str | None = None
    ) -> Any:
        return {
            "value": value,
            "low": 0.95 * value,
            "high": 1.05 * value,
            "prior": prior,
            "unit": unit,
            "word": word,
            "at_bound": bound,
            "strain": strain,
            "source": "Table 2 of the first paper",
        }

    return {
        "schema": "pamid.fit/1",
        "rig": "one-dof",
        "effects": [],
        "seed": 0,
        "recordings": [
            {
                "name": "rec",
                "path": "rec.csv",
                "sha256": "ab" * 32,
                "role": "both",
                "samples": 4000,
                "period_s": PERIOD_S,
                "loop": "closed",
            }
        ],
        "channels": list(CHANNELS),
        "inputs": ["command"],
        "converged": True,
        "why": "",
        "iterations": 15,
        "stepping": {"substeps": 1, "implicit": False, "recheck": 0.003},
        "noise": {name: values[0] for name, values in CHANNELS.items()},
        "parameters": {
            "damping_m2_s": parameter(0.00213, 0.0015, "m2 s", "settled", 1.2),
            "sonic_conductance_m3_per_s_pa": parameter(1.23e-8, 1.3e-8, "m3/(s Pa)", "weak", 3.4),
            "dead_volume_m3": parameter(4.1e-5, 4e-5, "m3", "silent", 0.1, "low"),
        },
        "background": {
            "force_map_1": {"pull": 0.8},
            "force_map_2": {"pull": -1.3},
            "exhaust_ratio": {"pull": 2.4},
        },
        "mae": {
            name: {"data_sheet": v[1], "refitted": v[2], "noise_floor": v[0]}
            for name, v in CHANNELS.items()
        },
        "closed_loop": {
            "angle_deg": {"data_sheet": 1.9, "refitted": 0.71, "band": 0.2},
            "command": {"data_sheet": 0.2, "refitted": 0.05, "band": 0.01},
        },
    }


def candidate(
    effect: str, family: str, probability: float, shrinkage: float, **more: Any
) -> dict[str, Any]:
    return {
        "effect": effect,
        "family": family,
        "port": more.pop("port", "joint"),
        "probability": probability,
        "held_out": {"angle_deg": {"mae_before": 0.52, "mae_after": 0.52 * (1 - shrinkage)}},
        "shrinkage": shrinkage,
        "low": shrinkage - 0.05,
        "high": shrinkage + 0.05,
        "removes": gap_share(shrinkage + 0.07),
        "behind": 0.0 if effect == "coulomb-friction" else 4.2,
        "converged": True,
        "why": "",
        "parameters": {},
        "at_bound": [],
        "figures": {},
        "set_aside": [],
        **more,
    }


def gap_share(share: float, errors: float = 14.0) -> dict[str, float]:
    """A share of the gap so many standard errors off zero."""
    reach = 2.0 * abs(share) / errors
    return {
        "share": share,
        "low": share - reach,
        "high": share + reach,
        "standard_errors": errors,
    }


def comparison(verdict: str) -> list[dict[str, Any]]:
    """The confidence set of the first step, on 18 held-out windows."""
    before = 10.0 + np.sin(np.arange(18.0))

    def member(effect: str, family: str, port: str, left: float) -> dict[str, Any]:
        share = 1.0 - left / 1.1
        losses = [float(loss) for loss in left * before]
        removes = gap_share(share)
        return {
            "effect": effect,
            "family": family,
            "port": port,
            "removes": removes,
            "losses": losses,
        }

    friction = member("coulomb-friction", "friction", "joint", 0.15)
    leak = member("leak", "leak", "pressure", 0.16)
    tied = {
        "explained": [friction],
        "partly-explained": [friction],
        "ambiguous": [friction, leak],
    }
    return [
        {
            "reference": "baseline",
            "reference_losses": [float(loss) for loss in before],
            "tied": tied.get(verdict, []),
        }
    ]


def cause(
    effect: str, family: str, port: str, share: float, probability: float, removes: float
) -> dict[str, Any]:
    return {
        "effect": effect,
        "family": family,
        "port": port,
        "probability": probability,
        "or_at": [],
        "instead": [],
        "removes": gap_share(removes),
        "figures": {},
        "share": share,
        "parameters": {"torque_n_m": {"value": 0.41, "low": 0.38, "high": 0.44}},
    }


def free_form_json() -> dict[str, Any]:
    """Friction that is small at creep and grows with the speed."""
    velocity = np.linspace(-90.0, 90.0, 31)
    force = 12.0 * np.sinh(velocity / 45.0)
    return {
        "effect": "free-friction@muscle",
        "family": "friction",
        "port": "muscle",
        "known_by": "a function of the velocity",
        "removes": gap_share(0.77),
        "shrinkage": 0.71,
        "low": 0.62,
        "high": 0.78,
        "curve": {
            "signal": "velocity",
            "signal_unit": "deg/s",
            "shown": "friction beyond the rig's own",
            "unit": "N",
            "x": velocity.tolist(),
            "y": force.tolist(),
            "low": (force - 1.5 - 0.05 * np.abs(velocity)).tolist(),
            "high": (force + 1.5 + 0.05 * np.abs(velocity)).tolist(),
        },
    }


FORMULA = "-0.42 sign(velocity) + 0.11 contraction^2"


def remainder(verdict: str) -> dict[str, Any] | None:
    """What is left: 14 %, which is not material, 36 %, which is, or the gap."""
    left: dict[str, Any] = {
        "share": 0.14,
        "low": 0.1,
        "high": 0.2,
        "floors": 1.4,
        "real": False,
        "port": "",
        "formula": "",
        "family": "",
    }
    real = {"real": True}
    whole = {"share": 1.0, "low": 1.0, "high": 1.0, "floors": 10.4}
    changed: dict[str, dict[str, Any]] = {
        "partly-explained": {
            **real,
            "share": 0.36,
            "low": 0.32,
            "high": 0.42,
            "floors": 3.7,
            "port": "muscle",
            "formula": FORMULA,
        },
        "unknown-effect": {**whole, **real, "port": "joint", "formula": FORMULA},
        "cannot-tell": {**whole, **real, "port": "joint"},
        "no-structural-gap": whole | {"floors": 1.1},
    }
    return left | changed.get(verdict, {})


def ranking(verdict: str) -> list[dict[str, Any]]:
    """Candidates, the best first. Without a cause none removes a material share of the gap for
    certain: friction removes 24 % of it by 2.4 standard errors, or 9 %."""
    rows = [
        candidate("coulomb-friction", "friction", 0.91, 0.788),
        candidate("lugre-friction", "friction", 0.05, 0.77),
        candidate("bouc-wen-hysteresis", "muscle-hysteresis", 0.03, 0.41, port="muscle"),
        candidate("dead-time", "command-timing", 0.01, 0.02, port="command"),
        candidate(
            "leak",
            "leak",
            0.0,
            -0.9,
            port="pressure",
            converged=False,
            why="parameters ran away",
            removes=gap_share(-0.99),
        ),
    ]
    leading = {"cannot-tell": gap_share(0.24, 2.4), "unknown-effect": gap_share(0.09)}
    leading["no-structural-gap"] = leading["unknown-effect"]
    for row in rows if verdict in leading else ():
        row["removes"] = leading[verdict] if row is rows[0] else gap_share(0.02)
    return rows


def added_variables_json(verdict: str) -> dict[str, Any]:
    """An added-variable plot per candidate that was refitted: friction explains nearly all, dead
    time nothing."""
    random = np.random.default_rng(11)
    explained = {"coulomb-friction": 0.95, "lugre-friction": 0.93, "bouc-wen-hysteresis": 0.5}
    plots = []
    for row in ranking(verdict):
        share = explained.get(row["effect"], 0.0)
        added = random.normal(0.0, 0.5, 300)
        rest = random.normal(0.0, 0.5, 300)
        residual = np.sqrt(share) * added + np.sqrt(1.0 - share) * rest
        slope, error = np.sqrt(share), 0.3 * np.sqrt(1.0 - share)
        plots.append(
            {
                "effect": row["effect"],
                "beside": [],
                "channel": "angle_deg",
                "slope": slope,
                "low": slope - error,
                "high": slope + error,
                "share": share,
                "added": [round(x, 4) for x in added],
                "residual": [round(x, 4) for x in residual],
            }
        )
    return {"schema": "pamid.added-variables/1", "plots": plots}


def rig_map_json() -> dict[str, Any]:
    """Five ports in a row, the last one read; the sensor group has two of them."""
    row = [
        ("valve", "valve", "flow", ["pressure"]),
        ("pressure", "pressure", "rate", ["muscle", "gauge"]),
        ("muscle", "muscle", "actuator-force", ["joint"]),
        ("joint", "joint", "motion", ["encoder"]),
        ("encoder", "sensor", "reading", []),
        ("gauge", "sensor", "reading", []),
    ]
    return {
        "name": "one-dof",
        "inputs": ["command"],
        "outputs": list(CHANNELS),
        "ports": [
            {"port": port, "group": group, "kind": kind, "unit": "", "leads_to": leads}
            for port, group, kind, leads in row
        ],
    }


def diagnosis_json(verdict: str) -> dict[str, Any]:
    """Without a contradiction; the sentence is the one that pamid makes of it."""
    found = _diagnosis_json(verdict) | {"rig": rig_map_json()}
    return found | {"sentence": sentence(read(DiagnosisFile, found))}


def _diagnosis_json(verdict: str) -> dict[str, Any]:
    removes = 0.64 if verdict == "partly-explained" else 0.86
    friction = cause("coulomb-friction", "friction", "joint", 0.93, 0.91, removes)
    causes = {
        "explained": [friction],
        "partly-explained": [friction],
        "ambiguous": [friction, cause("leak", "leak", "pressure", 0.07, 0.38, 0.85)],
    }
    reach = {
        name: {
            "mae_data_sheet": v[1],
            "mae_refitted": v[2],
            "mae_with_cause": v[3],
            "noise_floor": v[0],
            "mae_refitted_short": round(0.6 * v[2], 6),
            "shrinkage": 1 - v[3] / v[2],
            "low": 0.9 - v[3] / v[2],
            "high": 1.05 - v[3] / v[2],
        }
        for name, v in CHANNELS.items()
    }
    unknown = {
        "port": "joint",
        "formula": FORMULA,
        "variables": ["velocity", "contraction"],
        "free_forms": [free_form_json()],
        "inclusion": 0.83,
        "described": 0.62,
        "dissipative": True,
        "parity": "odd",
        "memory": False,
    }
    elsewhere = [
        {
            "recording": "ab" * 6,
            "differs": {"inertia_kg_m2": 0.014, "loop": "open", "controller": {"kp_per_deg": 0.2}},
            "angle_deg": {"mae_refitted": 0.61, "mae_with_cause": 0.2, "shrinkage": 0.672},
        }
    ]
    return {
        "schema": "pamid.diagnosis/3",
        "verdict": verdict,
        "remark": "",
        "causes": causes.get(verdict, []),
        "remainder": remainder(verdict),
        "ranking": ranking(verdict),
        "comparison": comparison(verdict),
        "horizon_s": 40.0,
        "forecast": None if verdict not in causes else {"share": 0.77, "low": 0.6, "high": 0.87},
        "where": {
            "port": "joint",
            "ports": [
                {"port": "joint", "share": 0.81},
                {"port": "muscle", "share": 0.12},
                {"port": "valve", "share": 0.04},
                {"port": "pressure", "share": 0.03},
            ],
            "indistinguishable": [["muscle", "joint"], ["valve", "pressure"]],
            "redundancy": 3,
            "unseen": ["leak"],
            "sensors": [
                {"sensor": "force_1_n and force_2_n", "splits": [["muscle", "joint"]]},
                {"sensor": "the value at port valve", "splits": [["valve", "pressure"]]},
            ],
            "regimes": [
                {
                    "signal": "velocity",
                    "low": -2.0,
                    "high": 2.0,
                    "unit": "deg/s",
                    "share_of_gap": 0.7,
                    "share_of_time": 0.2,
                },
                {
                    "signal": "valve_ratio_1",
                    "low": 0.0,
                    "high": 0.43,
                    "unit": "",
                    "share_of_gap": 0.61,
                    "share_of_time": 0.35,
                },
            ],
            "frequency_hz": [0.2, 2.0],
            "windows_s": [[29.0, 31.5], [35.0, 36.0]],
        },
        "how_far": reach,
        "transfer": elsewhere if verdict in causes else [],
        "next_experiment": {
            "name": "torque-loops-two-pressures",
            "why": "Friction of the joint does not grow with pressure.",
            "separates": ["coulomb-friction", "bouc-wen-hysteresis"],
            "expected_separation": 4.2,
            "minutes": 8.0,
            "excitation": "next-experiment.csv",
            "excitations": ["next-experiment.csv", "next-experiment-2.csv"],
            "settings": [{"initial_pressure_kpa": 200.0}, {"initial_pressure_kpa": 500.0}],
        },
        "parameters": {
            **fit_json()["parameters"],
            "damping_m2_s": {
                "value": 0.0016,
                "low": 0.0015,
                "high": 0.0017,
                "prior": 0.0014,
                "strain": 0.3,
            },
        },
        "background": {
            "force_map_1": {"pull": 0.8, "share_of_gap": 0.04},
            "force_map_2": {"pull": -0.2, "share_of_gap": 0.01},
        },
        "unknown": unknown if verdict == "unknown-effect" else None,
        "notes": [],
        "a_later_key": 1.5,
    }


def network_json() -> dict[str, Any]:
    return {
        "schema": "pamid.network/1",
        "kind": "elman",
        "n_weights": 171,
        "target": "measured angle_deg - the refitted model on recorded commands",
        "output": {"name": "angle_deg", "unit": "deg"},
        "training": {
            "why": "the gradient is below its goal",
            "converged": True,
            "remark": "",
            "iterations": 119,
        },
        "mae": {"angle_deg": {"refitted": 0.52, "with_network": 0.23, "part": "held-out"}},
    }


def write_residual(folder: Path, *, causes: bool, network: bool) -> None:
    """40 s of a stick-slip-like angle; the last 30 % are held out, the first window of all is
    unscored."""
    random = np.random.default_rng(4)
    rows = np.arange(4000)
    time = PERIOD_S * rows
    columns = {
        "time_s": time,
        "recording": 0 * rows,
        "part": (time >= 28.0).astype(int),
        "window": np.where(rows < 100, -1, rows // WINDOW_ROWS),
    }
    shape = np.sin(0.9 * time) + 0.4 * np.sin(2.3 * time)
    for name, (floor, _, _, _) in CHANNELS.items():
        stem, unit = name.rsplit("_", 1)
        scale = 20.0 if unit == "deg" else 60.0
        measured = scale * shape + random.normal(0, floor, rows.size)
        gap = np.tanh(8 * np.cos(0.9 * time)) * (1.5 + np.sin(0.31 * time))
        columns[name] = measured
        columns[f"{stem}_data_sheet_{unit}"] = 0.93 * scale * shape + gap
        columns[f"{stem}_refitted_{unit}"] = scale * shape + 0.5 * gap
        if causes:
            columns[f"{stem}_cause_{unit}"] = scale * shape + 0.1 * gap
        if network and name == "angle_deg":
            columns[f"{stem}_network_{unit}"] = scale * shape + 0.2 * gap
    columns["command"] = np.clip(shape, -1, 1)
    _write_table(folder / "residual.csv", columns)
    free = {"time_s": time, "recording": columns["recording"]}
    drift = 0.02 * time * np.tanh(8 * np.cos(0.9 * time))  # of a run without a new start
    for name in CHANNELS:
        stem, unit = name.rsplit("_", 1)
        for kind, of in (("free_run", "refitted"), ("cause_free_run", "cause")):
            if f"{stem}_{of}_{unit}" in columns:
                off = drift if kind == "free_run" else 0.1 * drift
                free[f"{stem}_{kind}_{unit}"] = columns[f"{stem}_{of}_{unit}"] + off
    _write_table(folder / "free-run.csv", free)


def _write_table(path: Path, columns: dict[str, Any]) -> None:
    rows = (
        ",".join(f"{value:.9g}" for value in row) for row in zip(*columns.values(), strict=True)
    )
    path.write_text("\n".join([",".join(columns), *rows]) + "\n", encoding="utf-8")


def write_missing(folder: Path) -> None:
    """300 slices of a missing force that opposes the velocity."""
    random = np.random.default_rng(5)
    velocity = random.normal(0.0, 20.0, 300)
    force = -0.42 * np.sign(velocity) + random.normal(0.0, 0.15, 300)
    columns = {
        "time_s": 28.0 + 0.04 * np.arange(300),
        "recording": np.zeros(300),
        "velocity_deg_per_s": velocity,
        "contraction": random.uniform(0.03, 0.17, 300),
        "missing_n": force,
    }
    np.savetxt(
        folder / "missing.csv",
        np.stack(list(columns.values()), axis=1),
        delimiter=",",
        fmt="%.9g",
        header=",".join(columns),
        comments="",
    )


def write_trace(folder: Path) -> None:
    lines = ["iteration,mse,gradient,mu,gamma,alpha,beta"]
    for k in range(120):
        mse = 0.002 + 0.3 * np.exp(-k / 9)
        lines.append(
            f"{k},{mse:.9g},{np.exp(-k / 12):.9g},{10.0 ** (-2 - (k % 7)):.9g},"
            f"{171 - 60 * (1 - np.exp(-k / 30)):.9g},0.1,40.0"
        )
    (folder / "trace.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def make_run(
    folder: Path, verdict: str = "explained", *, without: tuple[str, ...] = (), **parts: Any
) -> Path:
    """A whole run folder by hand; `parts` replaces the content of a JSON file, `without` leaves
    files out."""
    folder.mkdir(parents=True, exist_ok=True)
    content = {
        "run": run_json(),
        "fit": fit_json(),
        "diagnosis": diagnosis_json(verdict),
        "network": network_json(),
        "added-variables": added_variables_json(verdict),
    }
    for name, value in {**content, **parts}.items():
        if f"{name}.json" not in without:
            (folder / f"{name}.json").write_text(json.dumps(value), encoding="utf-8")
    if "residual.csv" not in without:
        write_residual(folder, causes=verdict in WITH_CAUSE, network="network.json" not in without)
    if "trace.csv" not in without:
        write_trace(folder)
    if verdict in DESCRIBED and "missing.csv" not in without:
        write_missing(folder)
    return folder


def share_json(hits: int, of: int) -> dict[str, Any]:
    low, high = wilson_interval(hits, of)
    return {"share": hits / of if of else None, "low": low, "high": high, "hits": hits, "of": of}


def trial_json() -> dict[str, Any]:
    """Every row of the table, with some figures short of their target and one without cases."""
    hits = {
        "family_first": 96,
        "family_first_slight": 80,
        "family_first_two": 107,
        "exact_first": 93,
        "port": 108,
        "wrong_abstention": 7,
        "both_seen": 0,
        "false_alarm": 9,
    }
    counts = {"both_seen": 0, "false_alarm": 80}
    parts: dict[str, dict[str, Any]] = {
        "rates": {"failed": share_json(1, 240), "unseen": share_json(12, 160)},
        "figures": {},
        "baselines": {},
    }
    for k, row in enumerate(JOINT_ROWS):
        if row.section == "figures":
            parts["figures"][row.key] = {
                "value": 0.04 + 0.01 * k,
                "low": 0.02,
                "high": 0.09 + 0.01 * k,
                "of": 110,
            }
        else:
            parts[row.section][row.key] = share_json(
                hits.get(row.key, 60 + k), counts.get(row.key, 110)
            )
    families = ["friction", "muscle-hysteresis", "leak", "tube-lag", "command-timing"]
    confusion = {
        family: {family: 18 - 2 * k, families[k - 1]: k + 1, "(unknown effect)": 2}
        for k, family in enumerate(families)
    }
    rates = {
        "family_first": share_json(20, 30),
        "exact_first": share_json(18, 30),
        "detected": share_json(28, 30),
        "false_alarm": share_json(1, 20),
    }
    good = {**rates, "family_first": share_json(41, 42), "false_alarm": share_json(0, 0)}
    bins = [(0.35, 4, 10), (0.55, 9, 15), (0.76, 20, 24), (0.96, 58, 60)]
    return {
        "schema": "pamid.trial/1",
        "part": "test",
        "seed": 7,
        "cases": 240,
        **parts,
        "confusion": confusion,
        "reliability": [
            {
                "low": int(10 * said) / 10,
                "high": int(10 * said) / 10 + 0.1,
                "said": said,
                "right": share_json(right, of),
            }
            for said, right, of in bins
        ],
        "strata": {
            "visibility": {"1.1 to 1.3": rates, ">= 2": good},
            "inertia_kg_m2": {"0.014": rates, "0.0896": good},
        },
        "cases_sha256": "cd" * 32,
        "failures": {"17": "the joint ran into its stop <b>hard</b>"},
    }


def make_trial(folder: Path, **changes: Any) -> Path:
    """A trial's folder by hand; `changes` replace parts of trial.json."""
    folder.mkdir(parents=True, exist_ok=True)
    run = {**run_json(), "command": ["pamid", "trial", "--output", "TRIAL"], "inputs": []}
    for name, value in (("run", run), ("trial", {**trial_json(), **changes})):
        (folder / f"{name}.json").write_text(json.dumps(value), encoding="utf-8")
    return folder
