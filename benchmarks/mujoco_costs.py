"""What a simulation of robots costs, beside MuJoCo's own tools in the same run.

    python benchmarks/mujoco_costs.py [costs] [fits] [--joints 1 2 7] [--seconds 20]

costs  a free run of 66667 samples of 3 ms, one RK4 step each, and one with sensitivities by the
       parameters that are fitted (20 at most): the model compiled into equations; stepped by
       MuJoCo, where that way is installed; MuJoCo's own rollout in C, once and once more for each
       parameter, as differences want it; and mjd_transitionFD, which gives the derivatives by state
       and command along one run, none by parameters, on a twentieth of the samples (implicitfast,
       since it does not do RK4).
fits   the same parameters (masses, dampings, armatures; gains of servos held, since only a known
       torque gives a mass) fitted to the same log by pamid and by mujoco.sysid (pip install
       'mujoco[sysid]'). Nothing is missing in the model, its masses are 10 to 20 % off. The log has
       the steps of an encoder and no other noise; both integrate it by RK4 at its own 4 ms, and
       both fit its first 70 %. mujoco.sysid starts from the known rest and takes parameters between
       a tenth and ten times what the model says; pamid estimates the start of every window, has its
       prior, and spends part of its time on judging the rest.

CPU seconds of the process, medians of several runs after a first one that compiles.
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import argparse
import contextlib
import io
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from mujoco_truth import PERIOD_S, arm, misjudged, model_text, record
from numpy.typing import NDArray

import pamid
from pamid.model.assembly import Assembly
from pamid.model.rig import Rig
from pamid.simulators.compiled_rig import CompiledMechanism
from pamid.simulators.mechanism import Mechanism
from pamid.simulators.mujoco_mechanism import read_mechanism

Array = NDArray[np.float64]
SAMPLES, STEP_S, MOST = 66667, 0.003, 20
ROUNDS = 5
TWENTIETH = 20


def seconds(work: Callable[[], object], rounds: int = ROUNDS, *, warm: bool = True) -> float:
    """Median CPU seconds of a piece of work, the first time left out."""
    if warm:
        work()
    taken = []
    for _ in range(rounds):
        begun = time.process_time()
        work()
        taken.append(time.process_time() - begun)
    return statistics.median(taken)


def main() -> None:
    """Print all figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", nargs="*", metavar="costs|fits")
    parser.add_argument("--joints", type=int, nargs="*", default=[1, 2, 7])
    parser.add_argument("--seconds", type=float, default=20.0)
    options = parser.parse_args()
    what = options.what or ["costs", "fits"]
    for joints in options.joints:
        if "costs" in what:
            costs(joints)
        if "fits" in what:
            fits(joints, options.seconds)


# ---- costs ---------------------------------------------------------------------------------------


def costs(joints: int) -> None:
    """Free runs of an arm, every way there is."""
    machine = arm(joints, np.random.default_rng(joints))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.xml"
        path.write_text(model_text(machine, step_s=STEP_S))
        mechanism = read_mechanism(path)
        random = np.random.default_rng(0)
        high = [0.2 * link.reach if link.kp else 0.2 for link in machine.links]
        u = np.repeat(random.uniform(-1, 1, (SAMPLES // 200 + 1, joints)), 200, axis=0)
        u = np.ascontiguousarray(u[:SAMPLES] * high)
        print(f"{joints} joint{'s' if joints > 1 else ''}, {SAMPLES} samples, CPU seconds:")
        _runs("compiled", CompiledMechanism(mechanism), u, ROUNDS)
        stepped = _stepped(mechanism)
        if stepped is not None:
            _runs("stepped by MuJoCo", stepped, u, 1)
        _rollouts(path, u, _fitted(CompiledMechanism(mechanism)))


def _stepped(mechanism: Mechanism) -> Rig | None:
    try:
        from pamid.simulators.stepped_mechanism import SteppedMechanism
    except ModuleNotFoundError:
        print("  stepped by MuJoCo: not in this version")
        return None
    return SteppedMechanism(mechanism)


def _fitted(rig: Rig) -> int:
    return min(MOST, sum(p.fitted for p in rig.parameters))


def _runs(way: str, rig: Rig, u: Array, rounds: int) -> None:
    a = Assembly(rig).for_fitting()
    p, count = a.values(), _fitted(rig)
    a.program  # noqa: B018  compiled here
    chosen = np.full(len(p), -1, np.int64)
    chosen[np.flatnonzero([b.fitted for b in a.parameters])[:count]] = np.arange(count)

    def run(columns: int) -> None:
        memory = a.program.memory(a.start(p), columns, period_s=STEP_S)
        _, _, bad = a.program.run(
            memory, u, p, period_s=STEP_S, columns=chosen if columns else None
        )
        assert bad < 0, f"the arm became unstable in sample {bad}"

    free = seconds(lambda: run(0), rounds, warm=rounds > 1)
    slopes = seconds(lambda: run(count), rounds, warm=rounds > 1)
    print(
        f"  {way + ':':26s} {free:8.3f}   with {count} exact sensitivities {slopes:8.3f}"
        if way == "compiled"
        else f"  {way + ':':26s} {free:8.3f}   with {count} sensitivities {slopes:8.3f}",
        f"({slopes / free:.1f} times)",
        flush=True,
    )


def _rollouts(path: Path, u: Array, count: int) -> None:
    import mujoco
    from mujoco import rollout

    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    start = np.zeros(mujoco.mj_stateSize(model, int(mujoco.mjtState.mjSTATE_FULLPHYSICS)))
    free = seconds(lambda: rollout.rollout(model, data, start, u), 3)
    print(
        f"  {'mujoco.rollout:':26s} {free:8.3f}   {count + 1} of them, as differences want "
        f"{(count + 1) * free:8.3f}"
    )
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST  # it knows no RK4
    nv, nu = model.nv, model.nu
    A, B = np.zeros((2 * nv, 2 * nv)), np.zeros((2 * nv, nu))

    def transitions(step: Callable[[], object]) -> None:
        mujoco.mj_resetData(model, data)
        for row in u[: SAMPLES // TWENTIETH]:
            data.ctrl[:] = row
            step()
            mujoco.mj_step(model, data)

    both = seconds(
        lambda: transitions(lambda: mujoco.mjd_transitionFD(model, data, 1e-6, 1, A, B, None, None))
    )
    plain = seconds(lambda: transitions(lambda: None))
    print(
        f"  {'mjd_transitionFD:':26s} {TWENTIETH * (both - plain):8.3f}   {2 * nv + nu} columns: "
        "by states and commands"
    )


# ---- fits ----------------------------------------------------------------------------------------


def fits(joints: int, length_s: float) -> None:
    """The same parameters from the same log, by pamid and by mujoco.sysid."""
    random = np.random.default_rng(10 + joints)
    machine = arm(joints, random)
    columns, _ = record(machine, (), length_s, 10 + joints, torque_noise=0.0)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.xml"
        path.write_text(model_text(misjudged(machine, random), step_s=PERIOD_S))
        table = np.column_stack(list(columns.values()))
        log = Path(folder) / "rec.csv"
        np.savetxt(log, table, "%.9g", ",", header=",".join(columns), comments="")
        mechanism = read_mechanism(path)
        free = [
            q
            for q in mechanism.parameters
            if q.parameter.fitted and q.attribute not in ("kp", "kv")
        ]
        truth = _true_values(machine, free, folder)
        ours, spent = _by_pamid(log, mechanism, {q.parameter.name for q in free})
        kept = round(0.7 * len(table))
        theirs, peer, why = _by_sysid(path, table[:kept], mechanism, free)
    print(
        f"\n{joints} joints, {len(free)} parameters, {length_s:g} s: pamid {spent:.2f} s CPU,",
        end=" ",
    )
    if theirs is None:
        print(f"mujoco.sysid: {why}")
        return
    print(f"mujoco.sysid {peer:.2f} s CPU; {why}")
    print(f"  {'parameter':30s} {'true':>10s} {'pamid':>10s} {'+-':>8s} {'sysid':>10s} {'+-':>8s}")
    meet = mutual = near = also = 0
    for q in free:
        name = q.parameter.name
        mine = next(v for k, v in ours.items() if k.startswith(name))
        value, half = theirs[name]
        low, high = mine["low"], mine["high"]
        true = truth[name]
        meet += max(low, value - half) <= min(high, value + half)
        mutual += low <= value <= high and abs(mine["value"] - value) <= half
        near += low <= true <= high
        also += abs(true - value) <= half
        print(
            f"  {name:30s} {true:10.4g} {mine['value']:10.4g} {0.5 * (high - low):8.2g} "
            f"{value:10.4g} {half:8.2g}"
        )
    print(
        f"  of {len(free)}: {mutual} within each other's intervals, {meet} intervals meet; the "
        f"truth is in {near} of pamid's and {also} of mujoco.sysid's",
        flush=True,
    )


def _true_values(machine: Any, free: list[Any], folder: str) -> dict[str, float]:
    """What the parameters are in the machine itself."""
    path = Path(folder) / "truth.xml"
    path.write_text(model_text(machine))
    known = {q.parameter.name: q.parameter.value for q in read_mechanism(path).parameters}
    return {q.parameter.name: known[q.parameter.name] for q in free}


def _by_pamid(log: Path, mechanism: Mechanism, free: set[str]) -> tuple[dict[str, Any], float]:
    rig = CompiledMechanism(mechanism)
    rig.parameters = tuple(
        p if p.name in free else replace(p, fitted=False) for p in rig.parameters
    )

    def work() -> Any:
        return pamid.fit(log, rig, progress=False, warn=lambda *_: None)

    work()
    begun = time.process_time()
    found = work()
    spent = time.process_time() - begun
    words = ("value", "low", "high")
    return {
        name: {w: float(getattr(e, w)) for w in words} for name, e in found.parameters.items()
    }, spent


def _by_sysid(
    path: Path, table: Array, mechanism: Mechanism, free: list[Any]
) -> tuple[dict[str, tuple[float, float]] | None, float, str]:
    import mujoco

    try:
        from mujoco import sysid

        sysid.optimize  # noqa: B018  absent without its extra
    except (ImportError, AttributeError):
        return None, 0.0, "left out (pip install 'mujoco[sysid]')"
    spec = mujoco.MjSpec.from_file(str(path))
    model = spec.compile()
    joints = len(mechanism.joints)
    times = PERIOD_S * np.arange(len(table))
    control = sysid.TimeSeries(times, table[:, 1 : 1 + joints])
    # its prediction beside a row is the reading at the begin of the step that leads there
    # (sensordata after mj_step are those of the state before), so readings are moved by a row
    read = np.vstack([table[:1], table[:-1]])[:, 1 + joints :]
    sensors = sysid.TimeSeries.from_names(times, read, model)
    start = sysid.create_initial_state(model, np.zeros(joints))
    params = sysid.ParameterDict()
    for q in free:
        p = q.parameter
        params.add(sysid.Parameter(p.name, p.value, p.low, p.high, modifier=_modifier(q)))
    sequences = sysid.ModelSequences("arm", spec, "log", start, control, sensors)
    residual = sysid.build_residual_fn(
        models_sequences=[sequences], n_threads=1, resample_true=False
    )

    def work() -> Any:
        return sysid.optimize(
            params.copy(), residual, optimizer="mujoco", verbose=False, x_scale="jac"
        )

    begun = time.process_time()
    with contextlib.redirect_stdout(io.StringIO()):  # it prints every iteration
        best, result = work()
    spent = time.process_time() - begun
    left, _, _ = residual(result.x, best)
    _, half = sysid.calculate_intervals(left, result.jac)
    values = {
        q.parameter.name: (float(v), float(h)) for q, v, h in zip(free, result.x, half, strict=True)
    }
    return (
        values,
        spent,
        f"relative error left {np.sqrt(np.mean(np.square(np.concatenate(left)))):.2g}",
    )


def _modifier(q: Any) -> Callable[[Any, Any], None]:
    """Writes a value into an MjSpec, as pamid's description says what it is."""

    def mass(spec: Any, p: Any) -> None:
        body = spec.body(q.of)
        body.inertia = np.array(body.inertia) * p.value[0] / body.mass
        body.mass = p.value[0]

    def of_joint(spec: Any, p: Any) -> None:
        joint = spec.joint(q.of)
        if q.attribute == "armature":
            joint.armature = p.value[0]
        else:  # damping and stiffness are polynomials
            getattr(joint, q.attribute)[0] = p.value[0]

    def gain(spec: Any, p: Any) -> None:
        actuator = spec.actuator(q.of)
        if q.attribute == "kp":
            actuator.gainprm[0], actuator.biasprm[1] = p.value[0], -p.value[0]
        else:
            actuator.biasprm[2] = -p.value[0]

    return {"body": mass, "joint": of_joint, "actuator": gain}[q.element]


if __name__ == "__main__":
    sys.exit(main())
