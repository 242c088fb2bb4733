"""pamid on EMPS in closed loop: reference and pulses in, position out, behind the controller that
the recordings were made with; the parameters of the carriage fitted so.

    python public_loop.py emps FOLDER [quick]

The remark says what the same parameters make of the open loop, and how far the reference by itself
is from the position: a good controller hides a bad model.
"""

import tempfile
from pathlib import Path

import numpy as np
from free_run_fit import Free, evidence, fit_free_run, free
from public_ours import BENCHMARKS, MODELS, SHOWN, write_record
from public_sets import PublicSet, Test, asked, read_record, rmse, tell

import pamid
from pamid.estimation.grey_box import model_with
from pamid.estimation.observed_sizes import observed_sizes
from pamid.simulation.free_runs import choose_stepping
from pamid.simulation.virtual_rig import attach_specs

RIG = BENCHMARKS / "rigs" / "emps_in_its_loop.py"
REFERENCE, PULSES, PULSES_IN_VOLTS = "reference_m", "pulse_n", "pulse_v"


def loop_columns(path: Path, rows: int | None, output: str) -> dict:
    """Reference and pulses of a record: without a column of pulses there were none."""
    with path.open(encoding="utf-8") as lines:
        has_pulses = PULSES in lines.readline()
    reference = read_record(path, (REFERENCE, output), rows).u
    pulses = read_record(path, (PULSES, output), rows).u if has_pulses else np.zeros(len(reference))
    return {REFERENCE: reference, PULSES_IN_VOLTS: pulses}


def opened(one: PublicSet, folder: Path, values: dict[str, float]) -> Free:
    """The open-loop model with these values."""
    rig, effects = MODELS[one.name]
    split = evidence(str(rig), folder / one.fit)
    attached = tuple(a for a, _ in attach_specs(split.rig, effects))
    assembly = model_with(split, attached, observed_sizes(split))
    (track,) = split.tracks(assembly)
    p = assembly.data_sheet()
    for key, i in assembly.keys.items():
        p[i] = values.get(key, p[i])
    stepping = choose_stepping(assembly, track.u, p, track.period_s, assembly.start(p))
    return Free(assembly, p, stepping, track, split.noise, np.asarray(assembly.start(p)))


def main() -> None:
    one, folder, _ = asked()
    output = one.columns[1]
    fit = read_record(folder / one.fit, one.columns)
    with tempfile.TemporaryDirectory() as home:
        record = Path(home) / one.fit
        columns = loop_columns(folder / one.fit, None, output)
        write_record(record, fit.period_s, {**columns, output: fit.y})
        found = fit_free_run(str(RIG), MODELS[one.name][1], record, one.start)
    model = free(found)
    values = dict(zip((b.key for b in found.problem.assembly.parameters), found.p, strict=True))
    open_loop = opened(one, folder, values)

    def errors(test: Test) -> tuple[float, float, float]:
        """Closed loop, open loop, and the reference in place of a model."""
        measured = read_record(folder / test.file, one.columns, test.rows)
        sent = loop_columns(folder / test.file, test.rows, output)
        seen = measured.y[: one.start]
        runs = (
            model.run(sent, seen, measured.period_s),
            open_loop.run({one.columns[0]: measured.u}, seen, measured.period_s),
            sent[REFERENCE],
        )
        closed, opened, reference = (rmse(measured.y, y, one.start, one.scale) for y in runs)
        return closed, opened, reference

    each = [errors(test) for test in one.tests]
    shown = ", ".join(f"{k} {values[k]:.4g}" for k in SHOWN[one.name])
    others = "; ".join(f"open loop {o:.3g}, the reference itself {r:.3g}" for _, o, r in each)
    tell(
        f"pamid {pamid.__version__}, closed loop",
        [closed for closed, _, _ in each],
        f"{shown}; {others} {one.unit}",
    )


if __name__ == "__main__":
    main()
