"""A stepped rig against the same machine written as equations, and what is said of one that is
wrong."""

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from pamid_cli import frame
from pendulums import SteppedTwin, WrittenPendulum

import pamid
from pamid.base.arrays import Array
from pamid.base.errors import PamidError
from pamid.engine.program import Stepping
from pamid.engine.sampled_inputs import SampledInputs
from pamid.exports.exporting import export_model
from pamid.intake.checks.conformance import (
    NULL_TOLERANCE,
    SAME_SLOPE,
    null_error,
    sensitivity_error,
)
from pamid.intake.checks.sampling_slips import compare_holds
from pamid.intake.checks.sheet_comparison import compared_with_sheet
from pamid.intake.checks.slips import slips_of_recording
from pamid.model.assembly import Assembly
from pamid.model.attachment import Attachment, attachments
from pamid.model.between_samples import stated
from pamid.model.isolability import isolability
from pamid.model.registry import effects, rig_named
from pamid.model.rig import Rig
from pamid.networks.correction.identified_model import load_identified
from pamid.recording.recording import recording_of
from pamid.simulation.excitation.aprbs import aprbs
from pamid.simulation.free_runs import choose_stepping, port_sizes

EXAMPLE = Path(__file__).resolve().parents[2] / "data/rigs/stepped_pendulum.py"
PERIOD = WrittenPendulum.period_s
RANDOM = np.random.default_rng(7)
U = aprbs(4.0, PERIOD, 6.0, (0.1, 1.0), seed=1)[:, None]


def _effect(rig: Rig, label: str) -> Attachment:
    name, _, port = label.partition("@")
    return next(a for a in attachments(rig, [effects()[name]]) if a.ports[0] == port)


def _with(rig: Rig, *labels: str) -> Assembly:
    bare = Assembly(rig)
    sizes = port_sizes(Assembly(WrittenPendulum()), [(U, bare.values(), PERIOD)])
    return Assembly(rig, tuple(_effect(rig, label) for label in labels), sizes=sizes)


def _run(a: Assembly, substeps: int = 1) -> tuple[Array, Array]:
    """Outputs, and their derivatives by all parameters and by the start."""
    p, step = a.values(), Stepping(substeps)
    k, n = len(p), len(a.rig.states)
    memory = a.program.memory(a.start(p), k + n, stepping=step, period_s=PERIOD)
    memory.S[:n, k : k + n] = np.eye(n)
    y, by, bad = a.program.run(
        memory, SampledInputs(U, PERIOD), p, stepping=step, columns=np.arange(k, dtype=np.int64)
    )
    assert bad < 0
    return y, by[:, :, : k + n]


# ---- the same machine ---------------------------------------------------------------------------


def test_without_effects_it_is_the_same_machine():
    (y, by), (same, also) = _run(_with(WrittenPendulum())), _run(_with(SteppedTwin()))
    assert np.abs(y - same).max() <= 1e-13 * np.abs(y).max()
    assert np.abs(by - also).max() <= 1e-5 * np.abs(by).max()


@pytest.mark.parametrize("label", ["dead-time@ruler", "first-order-lag@encoder", "play@ruler"])
def test_effects_on_readings_are_the_same(label):
    y, same = _run(_with(WrittenPendulum(), label))[0], _run(_with(SteppedTwin(), label))[0]
    assert np.abs(y - same).max() <= 1e-12 * np.abs(y).max()


@pytest.mark.parametrize(
    "label", ["viscous-friction@rail", "linear-stiffness@hinge", "coulomb-friction@rail"]
)
def test_effects_on_forces_come_nearer_in_proportion_to_the_exchange(label):
    truth = _run(_with(WrittenPendulum(), label), 16)[0]
    stepped = _with(SteppedTwin(), label)
    away = [np.abs(_run(stepped, n)[0] - truth).max() for n in (1, 2, 4)]
    assert 0.35 < away[1] / away[0] < 0.65
    assert 0.35 < away[2] / away[1] < 0.65


@pytest.mark.parametrize(
    "label", ["coulomb-friction@rail", "lugre-friction@hinge", "dead-time@ruler", "end-stop@rail"]
)
def test_effects_vanish_at_their_null_and_have_exact_slopes(label):
    rig = SteppedTwin()
    assert null_error(rig, _effect(rig, label), draws=1) <= NULL_TOLERANCE
    assert sensitivity_error(rig, _effect(rig, label)) <= SAME_SLOPE


def test_a_start_far_from_rest_carries_on_from_window_to_window():
    a = _with(SteppedTwin(), "coulomb-friction@rail", "dead-time@ruler")
    p = a.values()
    whole = a.program.memory(a.start(p), period_s=PERIOD)
    y = a.program.run(whole, SampledInputs(U, PERIOD), p)[0]
    parts = a.program.memory(a.start(p), period_s=PERIOD)
    cuts = [
        a.program.run(parts, SampledInputs(U[i : i + 100], PERIOD, i * PERIOD), p)[0]
        for i in range(0, len(U), 100)
    ]
    assert np.array_equal(y, np.concatenate(cuts))
    assert np.array_equal(whole.x, parts.x)


def test_what_enters_what_is_found_by_trying_it():
    for outputs in (("position_m", "angle_rad"), ("position_m",), ("angle_rad",)):
        assert isolability(SteppedTwin(), outputs) == isolability(WrittenPendulum(), outputs)


def test_stiff_effects_are_exchanged_more_often():
    a = _with(SteppedTwin(), "viscous-friction@rail")
    p = a.values()
    assert choose_stepping(a, U, p, PERIOD, a.start(p)).substeps == 1
    place = next(i for i, b in enumerate(a.parameters) if b.owner == "viscous-friction@rail")
    p[place] = 1000.0  # N s/m on a kilogram: held over 10 ms it would drive the cart back and forth
    step = choose_stepping(a, U, p, PERIOD, a.start(p))
    assert step.substeps >= 8
    memory = a.program.memory(a.start(p), stepping=step, period_s=PERIOD)
    y, _, bad = a.program.run(memory, SampledInputs(U, PERIOD), p, stepping=step)
    assert bad < 0 and np.abs(y[:, 0]).max() < 0.1


def test_an_exchange_is_no_longer_than_the_rig_says():
    class Quick(SteppedTwin):
        exchange_s = 0.004

    a = _with(Quick())
    assert choose_stepping(a, U, a.values(), PERIOD, a.start(a.values())).substeps == 3


def test_readings_are_seen_beside_the_states():
    class WithBob(SteppedTwin):
        """What hangs on the rod, seen from above."""

        readings = {"bob": "m"}
        outputs = {"bob_m": "m"}
        noise = {"bob_m": 1e-3}

        def read(self, x, p):
            return {"bob": x.position + p.rod_m * float(np.sin(x.angle))}

        def measure(self, x, u, p, port):
            port("encoder", x.angle)
            return {"bob_m": port("ruler", x.bob)}

    rig = WithBob()
    y, by = _run(_with(rig))
    plain, slopes = _run(_with(SteppedTwin()))
    rod = rig.parameters[2].value
    assert np.allclose(y[:, 0], plain[:, 0] + rod * np.sin(plain[:, 1]), rtol=0, atol=1e-12)
    expected = slopes[:, 0] + rod * np.cos(plain[:, 1])[:, None] * slopes[:, 1]
    expected[:, 2] += np.sin(plain[:, 1])
    assert np.abs(by[:, 0] - expected).max() <= 1e-5 * np.abs(expected).max()


def test_it_is_sent_to_another_process_without_what_was_made_here():
    a = _with(SteppedTwin(), "coulomb-friction@rail")
    y = _run(a)[0]
    again = pickle.loads(pickle.dumps(a))
    assert "_known_links" not in vars(again.rig)
    assert np.array_equal(_run(again)[0], y)


def test_no_more_time_is_simulated_than_was_recorded_when_the_clock_is_doubted():
    """A sample of an hour would be a million steps of a simulation."""
    named = {k: v for k, v in vars(SteppedTwin).items() if k not in ("period_s", "__dict__")}
    rig = type("Unstated", (pamid.StepRig,), named)()
    count = 6000
    columns = {
        "time_s": PERIOD * np.arange(count),
        "force_n": np.tile(U[:, 0], 20)[:count],
        **{name: np.cumsum(RANDOM.standard_normal(count)) for name in rig.outputs},
    }
    recording = pamid.Recording.from_pandas(pd.DataFrame(columns))
    evidence = compared_with_sheet(recording, rig)
    assert evidence is not None
    asked: list[tuple[int, float]] = []

    def simulate(u, values=evidence.p, clock=1.0):
        asked.append((len(u), clock))
        return evidence.model[: len(u)]

    doubted = replace(evidence, simulate=simulate)
    clocks = [s for s in slips_of_recording(doubted, recording) if s.kind == "clock"]
    assert [s.compared(doubted, recording) is not None for s in clocks].count(True) >= 2
    assert {c for _, c in asked} >= {1e-3, 60.0}
    assert all(n * c <= count for n, c in asked)


# ---- fit and diagnosis ---------------------------------------------------------------------------


MASSES = {"cart_kg": 1.12, "bob_kg": 0.18, "rail_n_s_per_m": 1.7}


def _recorded(seconds: float, *effects: str) -> pamid.Recording:
    """What the written machine would have recorded, its parameters off the sheet."""
    u = aprbs(seconds, PERIOD, 6.0, (0.2, 1.0), seed=4)
    sent = pd.DataFrame({"time_s": PERIOD * np.arange(len(u)), "force_n": u})
    return pamid.simulate(
        pamid.Recording.from_pandas(sent), WrittenPendulum, effects=effects, parameters=MASSES
    )


@pytest.fixture(scope="module")
def fitted(tmp_path_factory) -> tuple[pamid.Recording, pamid.FitResult, Path]:
    recording, folder = _recorded(8.0), tmp_path_factory.mktemp("fitted") / "run"
    return recording, pamid.fit(recording, SteppedTwin, output=folder), folder


def test_a_fit_finds_what_that_of_the_equations_finds(fitted):
    recording, found, _ = fitted
    written, stepped = pamid.fit(recording, WrittenPendulum).parameters, found.parameters
    for one, other in zip(written.values(), stepped.values(), strict=True):
        assert one.low is not None and one.high is not None
        assert other.low is not None and other.high is not None
        assert one.low <= other.value <= one.high and other.low <= one.value <= other.high
        assert abs(one.value - other.value) < 0.05 * (one.high - one.low)
    for name, value in MASSES.items():
        low, high = stepped[name].low, stepped[name].high
        assert low is not None and high is not None and low <= value <= high


@pytest.mark.slow
def test_a_diagnosis_names_the_cause_that_that_of_the_equations_names():
    recording = _recorded(20.0, "coulomb-friction@rail:force_n=0.5")
    tried = ("coulomb-friction", "viscous-friction", "cubic-stiffness", "dead-time", "gain-error")
    left_out = [name for name in effects() if name not in tried]
    found = [
        pamid.diagnose(recording, rig, without=left_out, jobs=1)
        for rig in (WrittenPendulum, SteppedTwin)
    ]
    for one in found:
        assert one.verdict in ("explained", "partly-explained")
        assert [c.effect for c in one.causes] == ["coulomb-friction@rail"]
    level = [d.causes[0].parameters["force_n"].value for d in found]
    assert abs(level[0] - 0.5) < 0.01 and abs(level[1] - 0.5) < 0.01


# ---- what is wrong with it -----------------------------------------------------------------------


def _wrong(**methods: Any) -> str:
    rig = type("Wrong", (SteppedTwin,), methods)()
    with pytest.raises(PamidError) as found:
        _run(_with(rig))
    return str(found.value)


def _raises(self: Any, x: Any, f: Any, p: Any, h: float) -> list[float]:
    return [1.0 / (x.position - x.position)]


def _misspelt(self: Any, x: Any, f: Any, p: Any, h: float) -> list[float]:
    return [x.positon]


@pytest.mark.parametrize(
    ("step", "words"),
    [
        (lambda self, x, f, p, h: [0.0], "returned 1 values, not 4. return them by name, or in"),
        (lambda self, x, f, p, h: 0.0, "'float' object is not iterable"),
        (lambda self, x, f, p, h: None, "'NoneType' object is not iterable"),
        (lambda self, x, f, p, h: ["a"] * 4, "could not convert string to float"),
        (
            lambda self, x, f, p, h: {"position": 0, "velocity": 0, "angle": 0, "turn": 0},
            "returned nothing for 'turning'. names: position, velocity, angle, turning",
        ),
        (
            lambda self, x, f, p, h: [x.position, float("nan"), 0.0, 0.0],
            "returned nan for 'velocity' in the first step of 0.01 s from the start",
        ),
        (_raises, "ZeroDivisionError: float division by zero (at position = 0, velocity = 0"),
        (_misspelt, "no attribute 'positon' (at position = 0, velocity = 0, angle = 0, turning"),
        (_misspelt, "Did you mean 'position'?"),
    ],
)
def test_a_step_that_is_wrong_is_named(step, words):
    said = _wrong(step=step)
    assert "rig 'wrong'" in said and "step()" in said
    assert words in said


def test_the_line_of_a_users_own_error_is_named():
    line = _raises.__code__.co_firstlineno + 1
    assert f"step(), line {line} of {__file__}" in _wrong(step=_raises)


def test_a_step_that_remembers_is_refused():
    def step(self, x, f, p, h):
        self.calls = getattr(self, "calls", 0) + 1
        return [x.position + self.calls, 0.0, 0.0, 0.0]

    assert "has a memory that is not a state" in _wrong(step=step)
    assert "there are no states" in _wrong(states=())


def test_whatever_goes_in_has_a_name():
    assert "drive(): returned None, not a dict" in _wrong(drive=lambda self, x, u, p, port: None)
    without = {k: v for k, v in vars(SteppedTwin).items() if k in ("inputs", "outputs", "states")}
    bare = type("Bare", (pamid.StepRig,), without)()
    with pytest.raises(
        PamidError, match=r"drive\(\): there is none.*a stepped rig has drive\(x, u"
    ):
        _run(Assembly(bare))


def test_a_run_that_blows_up_says_when():
    class Fragile(SteppedTwin):
        def step(self, x, f, p, h):
            found = super().step(x, f, p, h)
            return found if abs(x.position) < 0.2 else [float("nan")] * 4

    a = _with(Fragile())
    p = a.values()
    memory = a.program.memory(a.start(p), period_s=PERIOD)
    y, _, bad = a.program.run(memory, SampledInputs(U, PERIOD), p)
    assert 0 < bad < len(U) - 1
    assert np.isfinite(y[: bad + 1]).all() and np.isnan(y[bad + 1 :]).all()
    with pytest.raises(PamidError, match="became unstable at"):
        sent = pd.DataFrame({"time_s": PERIOD * np.arange(len(U)), "force_n": U[:, 0]})
        pamid.simulate(pamid.Recording.from_pandas(sent), Fragile)


# ---- the example -------------------------------------------------------------------------------


def test_the_example_is_sound(capsys):
    assert frame.run(["check", str(EXAMPLE)]) == 0
    assert "nothing is wrong" in capsys.readouterr().out


def test_what_was_found_is_simulated_again_but_not_exported(fitted, tmp_path):
    recording, found, folder = fitted
    again = pamid.simulate(recording, SteppedTwin, model=found, noise=0.0)
    away = again.columns["position_m"] - recording.columns["position_m"]
    assert np.abs(away).max() < 10 * WrittenPendulum.noise["position_m"]
    with pytest.raises(PamidError, match="it has no equations that could be exported"):
        export_model(load_identified(folder, rig=SteppedTwin()), "c", tmp_path / "m")


def test_a_step_is_told_its_inputs_where_it_begins():
    """Held or linear is the same to it, so that it is not tried."""
    rig = rig_named(str(EXAMPLE))
    u = np.random.default_rng(0).uniform(-6.0, 6.0, (200, 1))
    runs = []
    for way in ("held", "linear"):
        a = Assembly(stated(rig, {"force_n": way}))
        p = a.values()
        memory = a.program.memory(a.start(p), period_s=0.01)
        runs.append(a.program.run(memory, SampledInputs(u, 0.01), p)[0])
    assert np.array_equal(*runs) and np.ptp(runs[0]) > 0.0
    columns = {"force_n": u[:, 0]} | dict(zip(a.program.outputs, runs[0].T, strict=True))
    recording = recording_of(0.01 * np.arange(len(u)), columns, {}, name="levels")
    assert compare_holds(recording, rig) == []
