"""Requirements for every rig and effect: checks that return numbers, and the findings of `pamid
check`.

    null_error          an effect at its null leaves every output unchanged
    finite_everywhere   outputs are finite at random points of the bounds
    sensitivity_error   exact sensitivities equal finite differences
    visible_change      an effect of typical size changes an output

All of them run on an excited, open-loop stretch of the rig (`ExcitedRig`). Effects are tried on
every rig that has their ports, and on `EveryPortRig`, a small machine with a port of each kind.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import PamidError
from pamid.base.progress import tell
from pamid.engine.program import Stepping
from pamid.engine.sampled_inputs import SampledInputs
from pamid.engine.simulator_warnings import counted_warnings
from pamid.engine.symbolic.vocabulary import Number, absolute, sqrt
from pamid.intake.checks.findings import CheckOutcome, fault, named, note, outcome, passed
from pamid.model.assembly import Assembly
from pamid.model.attachment import Attachment, attachments
from pamid.model.bound_parameter import Bound, Sizes
from pamid.model.effect import Effect, State, problems
from pamid.model.parameter import Parameter
from pamid.model.port_guide import driving_words
from pamid.model.rig import Port, Rig
from pamid.model.step_rig import StepRig
from pamid.simulation.excitation.aprbs import aprbs
from pamid.simulation.excitation.experiments import usual_range
from pamid.simulation.excitation.waveforms import ramps
from pamid.simulation.free_runs import choose_stepping, free_run, port_sizes

SAMPLES = 800
FULL_STRETCH_STATES, LEAST_SAMPLES = 24, 80  # of a stepped rig
# of the largest output: an effect at its null (a lag of 0 s leaves 1e-9 of a step)
NULL_TOLERANCE = 1e-8
SAME_SLOPE = 1e-3  # of the largest sensitivity of a channel
# of an output's size: differences beyond it, of parameters moved by a millionth, are not slopes
SMALL_MOVE = 1e-4
LEAST_EFFECT = 1e-9  # of the largest output: an effect that changes less does nothing
# of the samples compared: differences across a corner of the equations are not slopes
QUANTILE = 0.97


class EveryPortRig(Rig):
    """A pump that fills a vessel, which pushes a sprung mass.

    It has a port of every kind, with the usual signals.
    """

    inputs = {"command": ""}
    outputs = {"position_m": "m", "angle_rad": "rad", "pressure_pa": "Pa", "force_n": "N"}
    ports = {
        "command": Port("command", ""),
        "flow": Port("flow", "m3/s", {"pressure": "Pa"}),
        "vessel": Port("rate", "Pa/s", {"stored": "Pa", "outflow": "Pa/s", "downstream": "Pa"}),
        "basin": Port("rate", "Pa/s", {"upstream": "Pa"}),
        "pull": Port("actuator-force", "N", {"position": "m", "velocity": "m/s", "pressure": "Pa"}),
        "guide": Port("motion", "N", {"position": "m", "velocity": "m/s", "load": "N"}),
        "spring": Port("transmission", "N", {"stretch": "m"}),
        "rod": Port("transmission", "N", {"position": "m", "velocity": "m/s", "inertia": "kg"}),
        "ruler": Port("reading", "m", {"rate": "m/s"}),
        "dial": Port("reading", "rad"),
        "gauge": Port("reading", "Pa", {"rate": "Pa/s"}),
        "cell": Port("reading", "N"),
    }
    states = (
        State("position", "m"),
        State("velocity", "m/s"),
        State("pressure", "Pa", 2e4),
        State("caught", "Pa", 1e4),
    )
    parameters = (
        Parameter("mass", 2.0, 1.0, 4.0, "kg", source="bench"),
        Parameter("spring", 300.0, 100.0, 900.0, "N/m", source="bench"),
        Parameter("area", 1e-3, 5e-4, 2e-3, "m2", source="bench"),
    )
    period_s = 0.004

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        flow = port("flow", 1e-3 * port("command", u.command), pressure=x.pressure)
        vent = 2.0 * x.pressure
        change = port(
            "vessel", 1e8 * flow - vent, stored=x.pressure, outflow=vent, downstream=x.caught
        )
        caught = port("basin", vent - x.caught, upstream=x.pressure)
        pull = port(
            "pull",
            p.area * x.pressure,
            position=x.position,
            velocity=x.velocity,
            pressure=x.pressure,
        )
        spring = port("spring", p.spring * x.position, stretch=x.position)
        force = pull - spring - 8.0 * x.velocity
        force = port(
            "guide",
            force,
            position=x.position,
            velocity=x.velocity,
            load=sqrt(absolute(pull) + 25.0) * 4.0,
        )
        force = port("rod", force, position=x.position, velocity=x.velocity, inertia=p.mass)
        return {
            "position": x.velocity,
            "velocity": force / p.mass,
            "pressure": change,
            "caught": caught,
        }

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        return {
            "position_m": port("ruler", x.position, rate=x.velocity),
            "angle_rad": port("dial", 3.0 * x.position),
            "pressure_pa": port("gauge", x.pressure, rate=-2.0 * x.pressure),
            "force_n": port("cell", p.spring * x.position),
        }


@dataclass(frozen=True, eq=False)
class ExcitedRig:
    """Excited stretch of a rig, with or without an effect; it can be run repeatedly."""

    rig: Rig
    attachment: Attachment | None = None
    samples: int = SAMPLES

    @cached_property
    def plain(self) -> Assembly:
        return Assembly(self.rig, sizes=self.sizes)

    @cached_property
    def sizes(self) -> Sizes:
        bare = Assembly(self.rig)
        return port_sizes(bare, [(self.u, bare.values(), self.rig.period_s)])

    @cached_property
    def assembly(self) -> Assembly:
        if self.attachment is None:
            return self.plain
        return Assembly(self.rig, (self.attachment,), sizes=self.sizes)

    @cached_property
    def u(self) -> Array:
        """Inputs (samples x inputs, SI).

        Random steps over the usual range of the rig, or within +-0.7 SI if it states none. Optional
        inputs without a usual range stay at their default.
        """
        rig, period = self.rig, self.rig.period_s
        columns = []
        for i, name in enumerate(Assembly(rig).traced.inputs):
            usual = usual_range(rig, name)
            if usual is None and name in rig.optional:
                columns.append(np.full(self.samples, rig.optional[name]))
                continue
            centre, half = usual or (0.0, 0.7)
            hold_s = (8 * period, min(60, self.samples // 6) * period)
            level = aprbs(self.samples * period, period, half, hold_s, seed=i)
            columns.append(centre + (ramps(level) if name in rig.ramped else level))
        if not columns:
            return np.zeros((self.samples, 0))
        return np.ascontiguousarray(np.stack(columns, axis=1))

    @cached_property
    def tested_parameters(self) -> list[tuple[int, Bound]]:
        """Indices of the parameters under test: those of the effect, or of the rig without an
        effect."""
        owner = self.attachment.label if self.attachment else ""
        return [(i, b) for i, b in enumerate(self.assembly.parameters) if b.owner == owner]

    def stepping(self, p: Array) -> Stepping:
        return choose_stepping(self.assembly, self.u, p, self.rig.period_s, self.assembly.start(p))

    def run(self, p: Array, stepping: Stepping | None = None) -> Array:
        """Outputs (samples x outputs, SI); NaN from the sample at which the state diverged."""
        done = free_run(
            self.assembly, self.u, p, self.rig.period_s, stepping=stepping or self.stepping(p)
        )
        if done.blown_up >= 0:
            done.outputs[done.blown_up :] = np.nan
        return done.outputs

    def random_point(self, random: np.random.Generator) -> Array:
        """Draw the fitted parameters under test evenly from their bounds, or from their logarithms.

        The others keep their values, because no fit moves a fixed parameter.
        """
        p = self.assembly.values()
        for i, b in self.tested_parameters:
            if not b.fitted:
                continue
            low = b.low if np.isfinite(b.low) else b.value - 3.0 * b.spread
            high = b.high if np.isfinite(b.high) else b.value + 3.0 * b.spread
            if b.log and low > 0.0:
                p[i] = np.exp(random.uniform(np.log(low), np.log(high)))
            else:
                p[i] = random.uniform(low, high)
        return p

    def changes(self, p: Array) -> Array:
        """Change of the outputs by the effect, relative to their size (samples x outputs)."""
        step, plain = self.stepping(p), self.plain
        run = free_run(plain, self.u, plain.values(), self.rig.period_s, stepping=step)
        return np.asarray(np.abs(self.run(p, step) - run.outputs) / _scale(run.outputs))


def null_error(rig: Rig, attachment: Attachment, draws: int = 3) -> float:
    """Largest change of any output, relative to its size, with the effect at its null."""
    trial = ExcitedRig(rig, attachment)
    random = np.random.default_rng(0)
    worst = 0.0
    for _ in range(draws):
        p = trial.random_point(random)
        for i, b in trial.tested_parameters:
            p[i] = p[i] if b.null is None else b.null
        worst = max(worst, float(np.nan_to_num(trial.changes(p), nan=np.inf).max()))
    return worst


def visible_change(rig: Rig, attachment: Attachment) -> float:
    """Largest change of any output, relative to its size, by the effect at its typical size.

    That is the size of its prior, if the prior is centred on the null.
    """
    trial = ExcitedRig(rig, attachment)
    p = trial.assembly.values()
    if all(b.null is None or b.value == b.null for _, b in trial.tested_parameters):
        for i, b in trial.tested_parameters:
            p[i] = b.value if b.null is None else min(b.value + b.spread, b.high)
    return float(np.nanmax(trial.changes(p)))


def _short_length(rig: Rig) -> int:
    """Number of samples of the longer checks.

    Derivatives of a stepped rig cost the square of its states, so a rig of many states gets fewer.
    """
    if not isinstance(rig, StepRig):
        return SAMPLES // 2
    share = min(1.0, FULL_STRETCH_STATES / max(len(rig.states), 1)) ** 2
    return max(LEAST_SAMPLES, round(share * (SAMPLES // 2)))


def finite_everywhere(rig: Rig, attachment: Attachment | None = None, draws: int = 10) -> list[str]:
    """Points of the bounds, as text, at which the outputs are not finite; empty without any."""
    trial = ExcitedRig(rig, attachment, samples=_short_length(rig))
    random = np.random.default_rng(0)
    problems = []
    for draw in range(draws):
        p = trial.random_point(random) if draw else trial.assembly.values()
        finite = np.isfinite(trial.run(p)).all(axis=1)
        if finite.all() or np.isfinite(trial.run(p, Stepping(4, implicit=True))).all():
            continue
        fitted = [(i, b) for i, b in trial.tested_parameters if b.fitted]
        point = ", ".join(f"{b.name} = {p[i] / b.factor:.4g}" for i, b in fitted)
        after_s = int(np.argmax(~finite)) * rig.period_s
        problems.append(f"not finite after {after_s:.3g} s at {point}")
    return problems


def sensitivity_error(rig: Rig, attachment: Attachment | None = None) -> float:
    """Largest difference between exact sensitivities and central differences.

    It is relative to each channel's largest value, and only counts while the differences are small.
    If errors of the state grow exponentially, as in an undamped arm, large differences are not
    slopes.
    """
    trial = ExcitedRig(rig, attachment, samples=_short_length(rig))
    p = trial.assembly.values()
    for i, b in trial.tested_parameters:
        # a little off the typical value: round numbers sit on corners (a delay of whole samples, a
        # gain of 1)
        nudge = 0.0137 * (abs(b.value) or (0.1 if b.log else b.spread))
        p[i] = b.value + nudge if b.value + nudge <= b.high else b.value - nudge
    step = trial.stepping(p)
    columns = np.full(len(p), -1, np.int64)
    for column, (i, _) in enumerate(trial.tested_parameters):
        columns[i] = column
    program, period = trial.assembly.program, rig.period_s
    memory = program.memory(
        trial.assembly.start(p), len(trial.tested_parameters), stepping=step, period_s=period
    )
    at_start = _start_slopes(trial, p)
    memory.S[: at_start.shape[0], : at_start.shape[1]] = at_start
    Y, exact, _ = program.run(
        memory, SampledInputs(trial.u, period), p, stepping=step, columns=columns
    )
    worst = 0.0
    for column, (i, b) in enumerate(trial.tested_parameters):
        # the errors of the differences, of order h^2 and 1e-16 / h, stay far below SAME_SLOPE
        h = 1e-6 * max(abs(p[i]), 1e-2 * min(b.high - b.low, abs(p[i]) + b.spread))
        error = np.full(Y.shape[1], np.inf)
        # errors that grow enlarge rounding, which is less over a wider step, and corners, of which
        # a shorter step crosses fewer; a wrong derivative agrees with none
        for share in (1.0, 8.0, 0.125):
            if error.max(initial=0.0) > SAME_SLOPE:
                moved = p.copy(), p.copy()
                moved[0][i], moved[1][i] = p[i] + share * h, p[i] - share * h
                runs = [trial.run(point, step) for point in moved]
                half = 0.5 * (runs[0] - runs[1])
                errors = _slope_errors(half, share * h, exact[:, :, column], _scale(Y))
                first = share == 1.0
                error = np.nan_to_num(errors, posinf=np.inf) if first else np.fmin(error, errors)
        worst = max(worst, float(error.max(initial=0.0)))
    return worst


def _slope_errors(moved: Array, h: float, exact: Array, scale: Array) -> Array:
    """Difference between exact sensitivities by a parameter and differences over +-h.

    It is relative to each channel's largest value, and counts while no output moves by more than
    `SMALL_MOVE`. A channel that the parameter does not reach has NaN. moved: half the
    difference of the outputs (samples x channels), of which scale is the size.
    """
    far = (np.abs(moved) > SMALL_MOVE * scale).any(axis=1)
    near = slice(int(np.argmax(far)) if far.any() else len(moved))
    slope, exact = moved[near] / h, exact[near]
    if not len(exact):
        return np.full(len(scale), np.inf)
    size = np.maximum(np.abs(slope), np.abs(exact)).max(axis=0)
    error = np.quantile(np.abs(exact - slope), QUANTILE, axis=0) / np.maximum(size, 1e-300)
    return np.where(size * h > 1e-11 * scale, np.nan_to_num(error, nan=np.inf), np.nan)


def _start_slopes(trial: ExcitedRig, p: Array) -> Array:
    """Derivatives of the start state by the parameters under test (states x parameters)."""
    slopes = []
    for i, b in trial.tested_parameters:
        h = 1e-6 * max(abs(b.value), b.spread if not b.log else 0.0, 1e-12)
        up, down = p.copy(), p.copy()
        up[i], down[i] = p[i] + h, p[i] - h
        slopes.append((trial.assembly.start(up) - trial.assembly.start(down)) / (2.0 * h))
    return np.stack(slopes, axis=1) if slopes else np.zeros((len(trial.assembly.start(p)), 0))


def _scale(outputs: Array) -> Array:
    return np.asarray(np.maximum(np.nanmax(np.abs(outputs), axis=0), 1e-30))


# ---- findings ----------------------------------------------------------------------------------


def background_findings(rig: Rig) -> list[CheckOutcome]:
    """Fault of a background that does not build, as a map of a signal that its port lacks."""
    if isinstance(rig, StepRig) or not rig.background:
        return []
    try:
        _ = Assembly(rig, background=True).traced
    except PamidError as error:
        return [fault("background", str(error))]
    return []


def rig_findings(
    rig: Rig, effects: Iterable[type[Effect]] = (), *, slopes: bool = True
) -> list[CheckOutcome]:
    """All findings on a rig without a recording.

    effects: effects that may act on it. slopes: compare its sensitivities with differences. pamid
    generates those of a model file, and nothing in the file can spoil them.
    """
    try:
        tell("equations")
        trial = ExcitedRig(rig)
        tell("bounds")
        bad = finite_everywhere(rig)
    except PamidError as error:
        return [fault("equations", str(error))]
    built = (
        f"{len(rig.states)} states, {len(trial.plain.parameters)} parameters, "
        f"{len(rig.outputs)} outputs; every port is used"
    )
    findings = [*background_findings(rig), passed("equations", built), *_finite_findings(bad)]
    if isinstance(rig, StepRig):
        with counted_warnings() as warned:
            trial.run(trial.assembly.values())
        texts = warned.sentences("in an excited run from the start")
        findings += [note("simulator", text) for text in texts]
    if bad and type(rig).period_s == Rig.period_s:
        text = (
            f"the rig states no period_s and was simulated with a period of {Rig.period_s:g} s. "
            "If the machine is faster, state the period of your recordings (period_s = 1e-5)"
        )
        findings.append(note("finite", text))
    if slopes and not bad:
        tell("sensitivities")
        findings.append(_slope_finding(rig, None))
    findings += [
        note("source", f"parameter {p.name!r} names no source")
        for p in rig.parameters
        if not p.source
    ]
    findings += [
        note("unit", f"signal {signal!r} at port {name!r} has no unit")
        for name, port in rig.ports.items()
        if not isinstance(port.signals, dict)
        for signal in port.signals
        if not port.unit_of(signal)
    ]
    findings += [note("sign", words) for words in driving_words(rig)]
    tell("effects")
    fit = sorted(a.label for a in attachments(rig, effects))
    text = f"{len(fit)} fit: {', '.join(fit)}" if fit else "no effect fits"
    return [*findings, outcome("effects", bool(fit), text, advice=True)]


def _finite_findings(bad: list[str]) -> list[CheckOutcome]:
    faults = [fault("finite", text) for text in bad]
    return faults or [passed("finite", "over random points of the bounds")]


def effect_findings(effect: type[Effect], rigs: Iterable[Rig]) -> list[CheckOutcome]:
    """All findings on an effect: its data sheet, and its behaviour on every rig with its ports."""
    findings = [fault("data sheet", w) for w in problems(effect)]
    if effect.act is Effect.act:
        return findings
    findings = findings or [
        passed("data sheet", f"family {effect.family}, {len(effect.parameters)} parameters")
    ]
    places = [(rig, a) for rig in (*rigs, EveryPortRig()) for a in attachments(rig, [effect])]
    if not places:
        signals = dict.fromkeys((*effect.signals, *(s for r in effect.roles for s in r)))
        needs = ", ".join([" or ".join((*effect.kinds, *effect.general_kinds)), *signals])
        findings.append(note("place", f"no rig has a port for it; it needs {needs}"))
    for k, (rig, attachment) in enumerate(places):
        tell(f"places {k}/{len(places)}: {attachment.label} on {rig.name}")
        try:
            off = null_error(rig, attachment)
            text = (
                f"at its null it changes the outputs by {off:.2g} of their size (allowed "
                f"{NULL_TOLERANCE:g})"
            )
            bad = finite_everywhere(rig, attachment)
            behaviour = [outcome("null", off <= NULL_TOLERANCE, text), *_finite_findings(bad)]
            if not bad:
                behaviour.append(_slope_finding(rig, attachment))
                change = visible_change(rig, attachment)
                text = (
                    f"at its typical size it changes the outputs by up to {change:.2g} of their "
                    "size"
                )
                behaviour.append(outcome("change", change > LEAST_EFFECT, text, advice=True))
        except PamidError as error:
            behaviour = [fault("equations", str(error))]
        findings += named(f"{rig.name}, {attachment.label}", behaviour)
    return findings


def follows_mean(rig: Rig, attachment: Attachment) -> bool:
    """True if its derivatives are those of a mean course, which differences do not show."""
    return rig.ports[attachment.ports[0]].kind in attachment.effect.mean_slope_at


def _slope_finding(rig: Rig, attachment: Attachment | None) -> CheckOutcome:
    if attachment is not None and follows_mean(rig, attachment):
        return passed("sensitivities", "those of its mean course (mean_slope_at)")
    worst = sensitivity_error(rig, attachment)
    stepped = isinstance(rig, StepRig) and worst > SAME_SLOPE
    text = f"differ from central differences by {worst:.2g} of the largest (allowed {SAME_SLOPE:g})"
    text += ": contacts and other steps that are not smooth have no slopes" if stepped else ""
    return outcome("sensitivities", worst <= SAME_SLOPE, text, advice=stepped)
