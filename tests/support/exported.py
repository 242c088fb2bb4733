"""Models made by hand for the tests of exports, what they are driven with, what pamid itself says
they do, and the programs that judge every form."""

import json
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.base.units import from_si, split_column, to_si
from pamid.engine.program import Stepping
from pamid.exports.c_source import c_files
from pamid.exports.fmu import Fmu, make_fmu
from pamid.exports.m_source import m_file
from pamid.exports.step import step_of
from pamid.model.assembly import Assembly
from pamid.model.attachment import attach
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.registry import effects, rig_named
from pamid.model.rig import Port, Rig
from pamid.networks.correction.identified_model import Identified, ModelNetwork, simulate_identified
from pamid.networks.elman import Elman
from pamid.networks.scaling import Scaling
from pamid.networks.trained_network import TrainedNetwork

PERIOD_S = 0.003
SEVERAL = (
    "dead-time",
    "maxwell-slip-hysteresis",
    "tube-lag",
    "coulomb-friction",
    "angle-sensor-lag",
)
FURTHER = ("bouc-wen-hysteresis", "pwm-quantisation", "muscle-creep", "gravity", "clock-skew")
CART = str(Path(__file__).parents[2] / "data" / "rigs" / "cart.py")


class Kettle(Rig):
    """An output in degrees Celsius, one that hangs on the input directly, an input with another
    value than 0, a parameter of the start alone, names that C and MATLAB do not like."""

    inputs = {"power_w": "W", "ambient_degc": "K"}
    optional = {"ambient_degc": 293.15}
    outputs = {"water_degc": "K", "int_w": "W"}
    ports = {"heat": Port("rate", "K/s"), "sensor": Port("reading", "K")}
    states = (State("double", "K"), State("i"))
    parameters = (
        Parameter("e", 0.002, 0.0, 1.0, source="a \\ guess /* ?? */"),
        Parameter("E", 4000.0, 1.0, 1e5),
        Parameter("cold", 280.0, 1.0, 1e3, "K"),
        Parameter("k1", 1.0, 0.0, 5.0),
    )

    def start(self, p):
        return {"double": p.cold, "i": 0.5 * p.k1}

    def rates(self, x, u, p, port):
        heat = port("heat", u.power_w / p.E - p.e * (x.double - u.ambient_degc))
        return {"double": heat, "i": -x.i}

    def measure(self, x, u, p, port):
        return {"water_degc": port("sensor", x.double) + x.i, "int_w": u.power_w * p.k1}


@dataclass(frozen=True)
class Case:
    """A model with inputs (samples x inputs) and its outputs (samples x outputs), both in the units
    of their names."""

    model: Identified
    inputs: Array
    outputs: Array

    def error(self, outputs: Array) -> float:
        """Largest difference to the model's outputs, as a share of each one's span."""
        return float(
            (np.abs(outputs - self.outputs).max(axis=0) / np.ptp(self.outputs, axis=0)).max()
        )


def made(
    rig: str, *names: str, stepping: Stepping | None = None, background: bool = True
) -> Identified:
    """A rig with effects at their typical size, its background a little off."""
    loaded = Kettle() if rig == "kettle" else rig_named(rig)
    assembly = Assembly(
        loaded, tuple(attach(loaded, n, effects()) for n in names), background=background
    )
    p = assembly.values()
    for k, (i, b) in enumerate((i, b) for i, b in enumerate(assembly.parameters) if b.nuisance):
        p[i] = 0.3 * (-1) ** k * b.spread
    return Identified(loaded.name, assembly, p, PERIOD_S, stepping or Stepping())


def with_network() -> Identified:
    """The joint with an Elman network of random weights behind its angle."""
    model, draw = made("one-dof", "coulomb-friction"), np.random.default_rng(3)
    network = Elman(2, 4)
    trained = TrainedNetwork(
        network,
        draw.normal(0.0, 0.3, network.n_weights),
        ("command", "angle_deg"),
        "angle_deg",
        Scaling((-1.0, -50.0), (1.0, 50.0)),
        Scaling((-5.0,), (5.0,)),
        PERIOD_S,
    )
    behind = ModelNetwork(trained, "angle_deg", sources=trained.input_names)
    return Identified(model.name, model.assembly, model.values, PERIOD_S, model.stepping, behind)


CASES = {
    "several effects, two steps": lambda: made("one-dof", *SEVERAL, stepping=Stepping(2)),
    "five effects": lambda: made("one-dof", *FURTHER, background=False),
    "implicit": lambda: made(
        "one-dof", "lugre-friction", "two-mass", stepping=Stepping(2, implicit=True)
    ),
    "arm": lambda: made("two-link", "coulomb-friction@joint_2"),
    "cart": lambda: made(CART, "dahl-friction@force", "dead-time@sensor"),
    "kettle": lambda: made("kettle"),
    "network": with_network,
    "no states": lambda: made("cylinder-bench", "gain-error@load_cell"),
    "no states, memory": lambda: made(
        "damper-bench", "coulomb-friction", "dead-time", stepping=Stepping(2)
    ),
}


def driven(model: Identified, samples: int) -> Array:
    """Held random levels on every input, in their units."""
    draw, columns = np.random.default_rng(0), []
    for name in model.inputs:
        size = {"power_w": 2000.0, "ambient_degc": 30.0, "force_n": 5.0}.get(name, 0.4)
        hold = int(draw.integers(60, 140))
        columns.append(np.repeat(draw.uniform(-size, size, samples // hold + 1), hold)[:samples])
    return np.stack(columns, axis=1)


def simulated(model: Identified, inputs: Array) -> Array:
    """The outputs that pamid gives, in their units."""
    u = np.stack(
        [to_si(inputs[:, i], split_column(n)[1]) for i, n in enumerate(model.inputs)], axis=1
    )
    found = simulate_identified(model, u)
    return np.stack(
        [from_si(found[:, i], split_column(n)[1]) for i, n in enumerate(model.outputs)], axis=1
    )


@cache
def case(name: str, samples: int) -> Case:
    """A case, simulated once."""
    model = CASES[name]()
    inputs = driven(model, samples)
    return Case(model, inputs, simulated(model, inputs))


# ---- judges --------------------

STRICT = ("-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror", "-O2")


def compiled(folder: Path) -> Path:
    """The program of the C files in a folder."""
    sources = sorted(p.name for p in folder.glob("*.c"))
    subprocess.run(["gcc", *STRICT, *sources, "-lm", "-o", "model"], cwd=folder, check=True)
    return folder / "model"


def built(name: str, folder: Path) -> Path:
    """The case as a C program in a folder."""
    for file, text in c_files(step_of(case(name, 1).model)).items():
        (folder / file).write_text(text)
    return compiled(folder)


def ran(program: Path, names: tuple[str, ...], inputs: Array) -> Array:
    """Outputs of a C program, which reads and writes CSV."""
    rows = [",".join(map(repr, row)) for row in inputs.tolist()]
    done = subprocess.run(
        [program],
        input="\n".join([",".join(names), *rows, ""]),
        capture_output=True,
        text=True,
        check=True,
    )
    return np.array([line.split(",") for line in done.stdout.splitlines()[1:]], float)


def run_c(name: str, inputs: Array, folder: Path) -> Array:
    return ran(built(name, folder), case(name, 1).model.inputs, inputs)


OCTAVE = """U = load('u.txt'); Y = zeros(rows(U), columns(model(U(1, :))));
[Y(1, :), s] = model(U(1, :));
for k = 2:rows(U)
  [Y(k, :), s] = model(U(k, :), s);
end
f = fopen('y.txt', 'w'); fprintf(f, [repmat('%.17g ', 1, columns(Y)) "\\n"], Y'); fclose(f);
"""


def run_octave(name: str, inputs: Array, folder: Path) -> Array:
    """Outputs of the MATLAB function in Octave."""
    (folder / "model.m").write_text(m_file(step_of(case(name, 1).model), "model"))
    np.savetxt(folder / "u.txt", inputs, fmt="%.17g")
    (folder / "script.m").write_text(OCTAVE)
    words = ["octave-cli", "--no-history", "--norc", "--no-gui", "script.m"]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0 and not done.stderr, done.stderr
    return np.loadtxt(folder / "y.txt", ndmin=2)


@cache
def fmu_of(name: str, version: int, compiler: str | None = None) -> Fmu:
    return make_fmu(step_of(case(name, 1).model), version, compiler=compiler)


class Slave:
    """One running FMU behind the same few verbs for both versions."""

    def __init__(
        self,
        name: str,
        version: int,
        folder: Path,
        *,
        start: float = 0.0,
        changed: dict[str, float] | None = None,
    ) -> None:
        import fmpy
        from fmpy.fmi2 import FMU2Slave
        from fmpy.fmi3 import FMU3Slave

        self.version = version
        folder.mkdir(exist_ok=True)
        path = folder / "model.fmu"
        path.write_bytes(fmu_of(name, version).data)
        self.description = fmpy.read_model_description(str(path))
        self.places = {v.name: v.valueReference for v in self.description.modelVariables}
        self.fmu = (FMU2Slave if version == 2 else FMU3Slave)(
            guid=self.description.guid,
            unzipDirectory=fmpy.extract(str(path), str(folder / "unzipped")),
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName="one",
        )
        self.fmu.instantiate()
        self.put: Callable[[Any, Any], None] = (
            self.fmu.setReal if version == 2 else self.fmu.setFloat64
        )
        self.get: Callable[[Any], Any] = self.fmu.getReal if version == 2 else self.fmu.getFloat64
        for key, value in (changed or {}).items():
            self.put([self.places[key]], [value])
        self.begin(start)
        self.inputs, self.outputs = (
            [v.valueReference for v in self.description.modelVariables if v.causality == causality]
            for causality in ("input", "output")
        )

    def begin(self, start: float) -> None:
        """Initialise, at first or after a reset."""
        if self.version == 2:
            self.fmu.setupExperiment(startTime=start)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=start)
        self.fmu.exitInitializationMode()

    def run(
        self, inputs: Array, step: float = PERIOD_S, start: float = 0.0, ahead: bool = False
    ) -> Array:
        """Outputs of every communication step, read before it or (ahead) after it."""
        found = np.empty((len(inputs), len(self.outputs)))
        for k, row in enumerate(inputs.tolist()):
            self.put(self.inputs, row)
            if not ahead:
                found[k] = self.get(self.outputs)
            self.fmu.doStep(start + k * step, step)
            if ahead:
                found[k] = self.get(self.outputs)
        return found


def run_onnx(name: str, inputs: Array, folder: Path) -> Array:
    """Outputs of the run file under onnxruntime; the cell file begins with the same."""
    from pamid.exports.onnx_model import onnx_bytes

    run, cell = onnx_bytes(case(name, 1).model)
    first = case(name, len(inputs)).outputs[:5]
    np.testing.assert_allclose(run_cell(cell, inputs[:5]), first, rtol=1e-12, atol=1e-12)
    return run_whole(run, inputs)[0]


def run_cell(content: bytes, u: Array) -> Array:
    """Outputs of a cell file, sample by sample, under the reference evaluator."""
    import onnx
    from onnx.reference import ReferenceEvaluator

    model, found = onnx.load_from_string(content), []
    told = {p.key: p.value for p in model.metadata_props}
    cell, state = ReferenceEvaluator(model), np.array(json.loads(told["start"]))
    for row in u:
        outputs, state = cell.run(None, {"inputs": row, "state": state})
        found.append(outputs)
    return np.array(found)


def run_whole(content: bytes, u: Array, state: Array | None = None) -> tuple[Array, Array]:
    """Outputs and last state of an ONNX file; inputs in the columns' units."""
    import onnx
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    if state is None:
        told = {p.key: p.value for p in onnx.load_from_string(content).metadata_props}
        state = np.array(json.loads(told["start"]))
    outputs, state = session.run(None, {"inputs": u, "state": state})
    return outputs, state


#: form -> the program it needs, how it is run, samples of each case, largest error as a share of
#: the span
JUDGES: dict[str, tuple[str, Callable[[str, Array, Path], Array], int, float]] = {
    "c": ("gcc", run_c, 5000, 1e-12),
    "matlab": ("octave-cli", run_octave, 250, 1e-12),
    "fmu": ("gcc", lambda name, u, folder: Slave(name, 2, folder).run(u), 1000, 1e-12),
    "fmu3": ("gcc", lambda name, u, folder: Slave(name, 3, folder).run(u), 1000, 1e-12),
    "onnx": ("", run_onnx, 300, 1e-9),
}


def missing(form: str) -> str:
    """Why a form cannot be judged here, or nothing."""
    program = JUDGES[form][0]
    return f"there is no {program}" if program and shutil.which(program) is None else ""
