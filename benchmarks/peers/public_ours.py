"""pamid on a public benchmark: a rig with the causes, fitted to the free run of the one record.

    python public_ours.py SET FOLDER [quick]

Tanks: the shipped rig with what a plumber would add (a pump that begins to deliver above some
volts and less and less towards the top, outlets away from the sensor's zero, outflow between
turbulent and laminar) and overflow of both tanks, of the upper one partly into the lower one.
EMPS: the shipped rig with the Coulomb friction that `pamid diagnose` names. Silverbox: the
oscillator with a hardening spring, driven by what a band-limited signal does between samples.
"""

import tempfile
from pathlib import Path

import numpy as np
from free_run_fit import fit_free_run, free
from public_sets import PublicSet, asked, judge, read_record, read_set, tell

import pamid

BENCHMARKS = Path(__file__).resolve().parents[1]
MODELS = {
    "cascaded_tanks": (
        BENCHMARKS / "rigs" / "tanks_with_pipes.py",
        ("overflow-into-store", "overflow@lower"),
    ),
    "emps": (BENCHMARKS.parent / "data" / "rigs" / "emps.py", ("coulomb-friction",)),
    "silverbox": (
        BENCHMARKS / "rigs" / "band_limited_oscillator.py",
        ("cubic-stiffness", "linear-stiffness", "constant-offset", "gain-error@sensor"),
    ),
}
SHOWN = {"emps": ("mass", "viscous", "offset", "coulomb-friction:level")}


def second_difference(u):
    """u(k + 1) - 2 u(k) + u(k - 1), 0 at the ends."""
    found = np.zeros_like(u)
    found[1:-1] = u[2:] - 2.0 * u[1:-1] + u[:-2]
    return found


def columns_of(name: str, column: str, u) -> dict:
    """The rig's inputs of a record's one."""
    if name != "silverbox":
        return {column: u}
    bend = second_difference(u)
    return {column: u, "bend_v": bend, "curl_v": second_difference(bend)}


def record_for_pamid(one: PublicSet, folder: Path, home: Path) -> Path:
    """The record to fit, with the columns that the rig asks for."""
    if one.name != "silverbox":
        return folder / one.fit
    fit = read_record(folder / one.fit, one.columns)
    made = columns_of(one.name, one.columns[0], fit.u) | {one.columns[1]: fit.y}
    write_record(home / one.fit, fit.period_s, made)
    return home / one.fit


def write_record(path: Path, period_s: float, columns: dict) -> None:
    """A recording of these columns."""
    samples = len(next(iter(columns.values())))
    table = np.column_stack([np.arange(samples) * period_s, *columns.values()])
    header = ",".join(["time_s", *columns])
    np.savetxt(path, table, "%.12g", ",", header=header, comments="")


def main() -> None:
    one, folder, _ = asked()
    rig, effects = MODELS[one.name]
    with tempfile.TemporaryDirectory() as home:
        record = record_for_pamid(one, folder, Path(home))
        found = fit_free_run(str(rig), effects, record, one.start)
    _, tests = read_set(folder, one)
    model = free(found)

    def run(u, y0):
        return model.run(columns_of(one.name, one.columns[0], u), y0, tests[0].period_s)

    keys = [b.key for b in found.problem.assembly.parameters]
    shown = ", ".join(f"{k} {found.p[keys.index(k)]:.4g}" for k in SHOWN.get(one.name, ()))
    rms = one.scale * float(np.sqrt(np.mean(np.concatenate(found.residuals) ** 2)))
    remark = f"{', '.join(effects)}; fitted record {rms:.3g} {one.unit}"
    tell(f"pamid {pamid.__version__}", judge(one, tests, run), f"{remark}; {shown}".rstrip("; "))


if __name__ == "__main__":
    main()
