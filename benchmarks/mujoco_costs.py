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
       'mujoco[sysid]', in the Python of --peer), from rest at zero and at a home pose. Nothing is
       missing in the model, its masses are 10 to 20 % off. The log has the steps of an encoder and
       no other noise; both integrate it by RK4 at its own 4 ms, and both fit its first 70 %.
       pamid estimates the start of every window and judges the rest of the log too; mujoco.sysid
       fits one run from the known rest, or windows of a second from the readings. Each is a new
       process whose whole CPU time counts; pamid's cache of compiled models is empty.

CPU seconds; of costs medians of several runs after a first one that compiles.
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import argparse
import contextlib
import io
import json
import resource
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from timing import cpu

if TYPE_CHECKING:
    from pamid.model.rig import Rig
    from pamid.rigs.simulators.mechanism import Mechanism

PERIOD_S = 0.004  # of the log, as in `mujoco_truth`
PEER_WAYS = ("sysid-run", "sysid-windows")
if not set(PEER_WAYS) & set(sys.argv):  # the interpreter of mujoco.sysid need not have pamid
    from mujoco_truth import arm, misjudged, model_text, record

    from pamid.engine.sampled_inputs import SampledInputs
    from pamid.model.assembly import Assembly
    from pamid.rigs.simulators.compiled_rig import CompiledMechanism
    from pamid.rigs.simulators.mujoco_mechanism import read_mechanism

Array = NDArray[np.float64]
SAMPLES, STEP_S, MOST = 66667, 0.003, 20
ROUNDS = 5
TWENTIETH = 20
HOME = np.array([-1.2, 0.5, -1.5, -0.8, 0.6, -0.4, 0.3])  # rad


def main() -> None:
    """Print all figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", nargs="*", metavar="costs|fits")
    parser.add_argument("--joints", type=int, nargs="*", default=[1, 2, 7])
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--peer", default=sys.executable, help="Python that has mujoco[sysid]")
    parser.add_argument("--way", help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.way:
        own = options.way == "pamid"
        found = by_pamid(options.folder) if own else by_sysid(options.folder, options.way)
        print(json.dumps(found))
        return
    what = options.what or ["costs", "fits"]
    for joints in options.joints:
        if "costs" in what:
            costs(joints)
        if "fits" in what:
            fits(joints, options.seconds, options.peer)


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
        from pamid.rigs.simulators.stepped_mechanism import SteppedMechanism
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
            memory, SampledInputs(u, STEP_S), p, columns=chosen if columns else None
        )
        assert bad < 0, f"the arm became unstable in sample {bad}"

    free = cpu(lambda: run(0), rounds, warm=rounds > 1)
    slopes = cpu(lambda: run(count), rounds, warm=rounds > 1)
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
    free = cpu(lambda: rollout.rollout(model, data, start, u), 3)
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

    both = cpu(
        lambda: transitions(lambda: mujoco.mjd_transitionFD(model, data, 1e-6, 1, A, B, None, None))
    )
    plain = cpu(lambda: transitions(lambda: None), ROUNDS)
    print(
        f"  {'mjd_transitionFD:':26s} {TWENTIETH * (both - plain):8.3f}   {2 * nv + nu} columns: "
        "by states and commands"
    )


# ---- fits ----------------------------------------------------------------------------------------


def fits(joints: int, length_s: float, peer: str) -> None:
    """The same parameters from the same log, by both tools, each in a process of its own."""
    for pose in ("zero", "home"):
        random = np.random.default_rng(10 + joints)
        machine = arm(joints, random)
        at = HOME[:joints] if pose == "home" else np.zeros(joints)
        columns, _ = record(machine, (), length_s, 10 + joints, torque_noise=0.0, pose=at)
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place)
            (folder / "model.xml").write_text(
                model_text(misjudged(machine, random), step_s=PERIOD_S)
            )
            table = np.column_stack(list(columns.values()))
            header = ",".join(columns)
            np.savetxt(folder / "rec.csv", table, "%.9g", ",", header=header, comments="")
            free = _free(read_mechanism(folder / "model.xml"))
            _write_free(folder, machine, free)
            print(f"\n{joints} joints from {pose}, {len(free)} parameters, {length_s:g} s:")
            for way, python in (("pamid", sys.executable), *((w, peer) for w in PEER_WAYS)):
                _first_fit(way, python, folder)


def _first_fit(way: str, python: str, folder: Path) -> None:
    """Run a way as a process, and print its cost and its parameters' errors."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [python, __file__, "--way", way, "--folder", str(folder)],
        env={**os.environ, "PAMID_CACHE": str(folder / "cache")},
        capture_output=True,
        text=True,
        check=False,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    if done.returncode:
        print(f"  {way:14s} {spent:6.2f} s CPU; failed: {done.stderr[-300:].strip()}", flush=True)
        return
    values = json.loads(done.stdout.splitlines()[-1])
    off, inside, masses = [], 0, []
    for q in json.loads((folder / "free.json").read_text()):
        value, low, high = values[q["name"]]
        off.append(abs(value / q["true"] - 1.0))
        inside += low <= q["true"] <= high
        if q["element"] == "body":
            masses.append(off[-1])
    print(
        f"  {way:14s} {spent:6.2f} s CPU; off by {100 * max(masses):.2f} % (worst mass), "
        f"{100 * statistics.median(off):.2f} % (median), {inside} of {len(off)} intervals hold "
        "the true value",
        flush=True,
    )


def _free(mechanism: Mechanism) -> list[Any]:
    """Parameters that both fit: of servos no gains, since only a known torque gives a mass."""
    return [
        q for q in mechanism.parameters if q.parameter.fitted and q.attribute not in ("kp", "kv")
    ]


def _write_free(folder: Path, machine: Any, free: list[Any]) -> None:
    """free.json: parameters, their bounds, and what they are in the machine."""
    true, rows = _true_values(machine, free, str(folder)), []
    for q in free:
        p = q.parameter
        row = {"name": p.name, "value": p.value, "low": p.low, "high": p.high}
        row |= {"element": q.element, "of": q.of, "attribute": q.attribute, "true": true[p.name]}
        rows.append(row)
    (folder / "free.json").write_text(json.dumps(rows))


def _true_values(machine: Any, free: list[Any], folder: str) -> dict[str, float]:
    """What the parameters are in the machine itself."""
    path = Path(folder) / "truth.xml"
    path.write_text(model_text(machine))
    known = {q.parameter.name: q.parameter.value for q in read_mechanism(path).parameters}
    return {q.parameter.name: known[q.parameter.name] for q in free}


def by_pamid(folder: Path) -> dict[str, tuple[float, float, float]]:
    """Values of the parameters, each with its interval."""
    import pamid

    names = {q["name"] for q in json.loads((folder / "free.json").read_text())}
    rig = CompiledMechanism(read_mechanism(folder / "model.xml"))
    rig.parameters = tuple(
        p if p.name in names else replace(p, fitted=False) for p in rig.parameters
    )
    found = pamid.fit(folder / "rec.csv", rig, progress=False, warn=lambda *_: None).parameters
    return {
        name: next((e.value, e.low, e.high) for k, e in found.items() if k.startswith(name))
        for name in names
    }


def by_sysid(folder: Path, way: str) -> dict[str, tuple[float, float, float]]:
    """The same by mujoco.sysid: one run over all of what pamid fits, or windows of a second. Each
    starts from the readings and their slope there."""
    import mujoco
    from mujoco import sysid

    table = np.loadtxt(folder / "rec.csv", delimiter=",", skiprows=1)
    table = table[: round(0.7 * len(table))]
    spec = mujoco.MjSpec.from_file(str(folder / "model.xml"))
    model = spec.compile()
    joints, length = model.nq, len(table) if way == "sysid-run" else round(1.0 / PERIOD_S)
    free = json.loads((folder / "free.json").read_text())
    params = sysid.ParameterDict()
    for q in free:
        own = [q[w] for w in ("name", "value", "low", "high")]
        params.add(sysid.Parameter(*own, modifier=_modifier(SimpleNamespace(**q))))
    sequences = []
    for at in range(0, len(table) - length + 1, length):
        part = table[at : at + length]
        times = PERIOD_S * np.arange(length)
        control = sysid.TimeSeries(times, part[:, 1 : 1 + joints])
        # sensordata after mj_step are those of the state before: readings are moved by a row
        read = np.vstack([part[:1], part[:-1]])[:, 1 + joints :]
        sensors = sysid.TimeSeries.from_names(times, read, model)
        q = table[:, 1 + joints : 1 + 2 * joints]
        slope = np.gradient(q[max(0, at - 2) : at + 3], PERIOD_S, axis=0)[min(at, 2)]
        start = sysid.create_initial_state(model, q[at], None if at == 0 else slope)
        sequences.append(sysid.ModelSequences("arm", spec, f"log{at}", start, control, sensors))
    residual = sysid.build_residual_fn(models_sequences=sequences, n_threads=1, resample_true=False)
    with contextlib.redirect_stdout(io.StringIO()):  # it prints every iteration
        best, result = sysid.optimize(
            params, residual, optimizer="mujoco", verbose=False, x_scale="jac"
        )
    left, _, _ = residual(result.x, best)
    _, half = sysid.calculate_intervals(left, result.jac)
    return {
        q["name"]: (float(v), float(v - h), float(v + h))
        for q, v, h in zip(free, result.x, half, strict=True)
    }


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
