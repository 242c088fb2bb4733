"""A machine of the trial for any rig: the rig itself, made unlike every model that the tool has.

Its parameters are drawn from their priors, its ports have an ordinary roughness, what is planted
acts in another form than the catalogue's, it is integrated in finer steps than a fit
takes, and its readings have noise and the steps of a converter.

The tool has the same equations: a trial on it shows how well effects are
distinguished on that rig, not what becomes of a rig whose equations are wrong in other ways.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import log1p
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import DataError, UsageError, nearest
from pamid.base.files import sha256_of
from pamid.base.metrics import rms
from pamid.base.parallel.result_store import digest
from pamid.base.trust import is_code
from pamid.base.units import split_column, to_si
from pamid.engine.symbolic.vocabulary import Expr
from pamid.model.assembly import Assembly
from pamid.model.attachment import Attachment
from pamid.model.bound_parameter import Bound, Sizes
from pamid.model.registry import code_files, in_catalogue, name_of, rig_named
from pamid.model.rig import Rig, with_declared
from pamid.model.sampling import as_sampled
from pamid.recording.recording import TIME, Recording, recording_of
from pamid.simulation.correlation_time import timescale_of
from pamid.simulation.free_runs import free_run, port_sizes, virtual_recording
from pamid.simulation.rig_data import data_of
from pamid.simulation.virtual_rig import in_its_loop
from pamid.trial.conditions import ALL, StarterConditions, draw_starter_conditions
from pamid.trial.faults import NAMELESS, Fault
from pamid.trial.machine import Record, machine_names
from pamid.trial.own_excitation import made_excitation, runs_closed, runs_open, sampled
from pamid.trial.own_forms import (
    FORM,
    FORM_BEND,
    FORM_SCALE,
    FORM_SETTLING,
    FORM_SKEW,
    SIGNAL_SIZE,
    TIMES_TYPICAL,
    WAY,
    Roughness,
    fault_of,
    in_another_form,
    planted_places,
    wave_values,
)
from pamid.trial.starter_machine import draw_map

ROUGH_KINDS = ("motion", "actuator-force", "flow", "rate")
FINENESS = 7  # steps of the machine in each step of a fit
NOISE_SHARE = 0.002  # of a reading's usual deviation, where the rig states no noise
CONVERTER_STEPS = (0.2, 2.0)  # of the converters, in standard deviations of the noise
OPEN_SHARE = 0.25  # of the cases, on a rig that runs in both ways
SHOWN_FLOORS = 2.0  # times noise and roughness, by which what is planted is to change a reading,
MOST_SCALED = 4.0  # if it takes no more than this times its drawn size
GENTLER = 6  # of what makes the machine fly apart
PROBE_SEED = 0  # of the excitation over which sizes are looked at


@dataclass(frozen=True, eq=False)
class OwnMachine:
    """A machine; see `pamid.trial.machine.Machine`.

    name        of the rig, or of its file without the folders
    sent        the user's excitation, if any
    sha256      digest of the rig, its file included, and of the user's excitation
    """

    rig: Rig
    name: str
    sent: Recording | None = None
    sha256: str = ""

    @property
    def period_s(self) -> float:
        return self.sent.sampling_period_s if self.sent else sampled(self.rig)[0]

    @cached_property
    def attached(self) -> dict[str, Attachment]:
        """Attachments that can be planted, by the name of the fault."""
        return planted_places(self.rig)

    @cached_property
    def faults(self) -> Mapping[str, Fault]:
        return {name: fault_of(self.rig, name, a) for name, a in self.attached.items()}

    @property
    def controller(self) -> Mapping[str, float]:
        return {**self.rig.controller, **(self.sent.controller if self.sent else {})}

    @property
    def withheld_columns(self) -> Mapping[str, tuple[str, ...]]:
        return {ALL: ()}

    def draw_conditions(
        self, random: np.random.Generator, faults: Sequence[Fault], clean: bool
    ) -> StarterConditions:
        seconds = (
            len(self.sent) * self.sent.sampling_period_s if self.sent else sampled(self.rig)[1]
        )
        drawn = draw_starter_conditions(random, [ALL], seconds, clean)
        opened = bool(random.random() < OPEN_SHARE)
        if self.sent is not None:
            closed = in_its_loop(self.rig, self.sent)
        else:
            closed = runs_closed(self.rig) and not (opened and runs_open(self.rig))
        return replace(drawn, loop="closed" if closed else "open")

    def plant(self, fault: str, random: np.random.Generator) -> tuple[str, dict[str, float]]:
        return fault, self.faults[fault].draw(random)

    def truth(self, site: str) -> dict[str, Any]:
        return self.faults[site].truth

    def known(self, c: StarterConditions) -> dict[str, float]:
        return dict(self.sent.known) if self.sent else {}

    def excitation(
        self, c: StarterConditions, record: Record | None, seed: int, noise: int
    ) -> dict[str, Array]:
        """Columns to send, in their units: the user's, or drawn ones."""
        if self.sent is not None:
            return {k: v for k, v in self.sent.columns.items() if k not in self.rig.outputs}
        return made_excitation(self.rig, c.loop, c.amplitude, seed)

    def meta(self, c: StarterConditions) -> dict[str, Any]:
        """TOML of a recording. It names no rig file, whose name may reveal more than the rig."""
        named = {"rig": self.name} if in_catalogue(self.name) else {}
        tables: dict[str, Any] = {
            "recording": {**named, "loop": c.loop, "sampling_period_s": self.period_s},
            "known": self.known(c),
        }
        if c.loop == "closed":
            tables["controller"] = dict(self.controller)
        if self.sent is not None and self.sent.between:
            tables["between"] = dict(self.sent.between)
        return tables

    def as_recording(self, c: StarterConditions, columns: Mapping[str, Array]) -> Recording:
        """Excitation as a recording that a virtual rig accepts."""
        time = np.arange(len(next(iter(columns.values())))) * self.period_s
        return recording_of(time, columns, self.meta(c), name="sent")

    def build(self, random: np.random.Generator, c: StarterConditions) -> Record:
        return draw_specimen(self, random, c).record


def machine_given(rig: str | Rig, excitation: Recording | None = None) -> str | OwnMachine:
    """Name of the machine for the rig of a user, or a machine built from the rig if there is none
    or the user gives an excitation. A path is code and is run; FileError unless it is a rig."""
    if isinstance(rig, str) and rig in machine_names() and excitation is None:
        return rig
    return machine_of(rig, excitation)


def machine_of(rig: str | Rig, excitation: Recording | None = None) -> OwnMachine:
    """A machine made of a rig; errors as of `machine_given`."""
    rig_object, about = rig_named(rig), name_of(rig)
    sent = [] if excitation is None else [dict(excitation.columns), dict(excitation.known)]
    # the file as it stands: of a class a process digests the file once
    files = [sha256_of(file) for file in code_files(rig, ())]
    name = Path(about).name if is_code(about) else about
    return OwnMachine(rig_object, name, excitation, digest(rig_object, *files, *sent))


@dataclass(frozen=True, eq=False)
class RigSpecimen:
    """A drawn machine.

    rig       with the noise of these sensors
    sizes     of the signals at its ports, over the data sheet's run
    values    parameters by key, SI
    waves     port -> its roughness
    steps     of the converter of each reading, in its unit
    probe     what it is tried with while sizes are settled
    """

    machine: OwnMachine
    conditions: StarterConditions
    rig: Rig
    sizes: Sizes
    values: Mapping[str, float]
    waves: Mapping[str, Array]
    steps: Mapping[str, float]
    probe: Recording

    def record(
        self, faults: Mapping[str, Mapping[str, float]], signal: Mapping[str, Array], seed: int
    ) -> dict[str, Array]:
        """Columns of a recording; UsageError for a fault that cannot be planted."""
        for name in faults:
            if name not in self.machine.attached:
                raise UsageError(
                    f"{name!r} cannot be planted in {self.machine.name}",
                    nearest(name, list(self.machine.attached)) or "see its faults",
                )
        settled = {k: {**v, TIMES_TYPICAL: self.settled(k, v)} for k, v in faults.items()}
        sent = self.machine.as_recording(self.conditions, signal)
        columns = self._run(sent, settled, noise=self.conditions.noise, seed=seed)
        for name, step in self.steps.items():
            columns[name] = np.floor(columns[name] / step + 0.5) * step
        return {TIME: sent.time, **columns}

    def settled(self, name: str, sizes: Mapping[str, float]) -> float:
        """`times` of a planted effect: raised once where it would be lost in noise and roughness,
        halved while the machine flies apart with it."""
        times, raised = sizes[TIMES_TYPICAL], False
        rough = self._run(self.probe, {})
        smooth = self._run(self.probe, {}, rough=False)
        for _ in range(GENTLER):
            try:
                outputs = self._run(self.probe, {name: {**sizes, TIMES_TYPICAL: times}})
            except DataError:
                times, raised = 0.5 * times, True
                continue
            if raised:
                return times
            shown = max(
                rms(outputs[c] - rough[c])
                / np.hypot(self.conditions.noise * self.rig.noise[c], rms(rough[c] - smooth[c]))
                for c in self.rig.outputs
            )
            if shown >= SHOWN_FLOORS:
                return times
            times, raised = times * min(SHOWN_FLOORS / max(shown, 1e-12), MOST_SCALED), True
        raise UsageError(f"The machine becomes unstable with {name}.", "Leave out its port.")

    def _run(
        self,
        sent: Recording,
        faults: Mapping[str, Mapping[str, float]],
        *,
        rough: bool = True,
        noise: float = 0.0,
        seed: int = 0,
    ) -> dict[str, Array]:
        """Readings before the converters. DataError if the machine flies apart."""
        assembly, p = self._model(faults, rough)
        return virtual_recording(assembly, sent, p, noise=noise, seed=seed, fineness=FINENESS)

    def _model(
        self, faults: Mapping[str, Mapping[str, float]], rough: bool = True
    ) -> tuple[Assembly, Array]:
        """Equations of the machine with the planted effects, and its parameters (SI)."""
        waves, ports = self.waves if rough else {}, self.rig.ports
        texture = [
            Attachment(Roughness(next(iter(ports[port].signals), "")), (port,), f"rough@{port}")
            for port in waves
        ]
        there = {name: self._planted(name) for name in faults}
        closed = self.conditions.loop == "closed"
        assembly = Assembly(
            self.rig,
            (*texture, *there.values()),
            controller=tuple(sorted(self.machine.controller.items())) if closed else (),
            sizes=self.sizes,
        )
        p = assembly.values(self.probe.known)
        known = {assembly.index_of(name) for name in self.probe.known}
        for key, value in self.values.items():
            if assembly.keys[key] not in known:
                p[assembly.keys[key]] = value
        for port, rows in waves.items():
            for key, value in wave_values(rows).items():
                p[assembly.keys[f"rough@{port}:{key}"]] = value
        for name, sizes in faults.items():
            self._set_sizes(assembly, p, there[name], sizes)
        return assembly, p

    def shown_values(self, name: str, sizes: Mapping[str, float]) -> dict[str, float]:
        """Parameters of the planted effects, by name with unit."""
        assembly, p = self._model({name: {**sizes, TIMES_TYPICAL: self.settled(name, sizes)}})
        label = _label(name)
        return {
            b.name: float(p[assembly.keys[b.key]]) / b.factor
            for b in assembly.parameters
            if b.owner == label and not b.name.startswith(FORM)
        }

    @property
    def true_parameters(self) -> dict[str, tuple[float, float]]:
        """Parameters of the rig that are off: true and data-sheet value, by name with unit."""
        assembly, p = self._model({})
        return {
            b.full_name: (float(p[assembly.keys[b.key]]) / b.factor, b.value / b.factor)
            for b in assembly.parameters
            if b.key in self.values and p[assembly.keys[b.key]] != b.value
        }

    def _planted(self, name: str) -> Attachment:
        """Attachment of a planted fault in its other form, under a unique label."""
        a = self.machine.attached[name]
        label = _label(name)
        if name.startswith(NAMELESS):
            return replace(a, label=label)
        bent = {
            s
            for port in a.ports
            for s in self.rig.ports[port].signals
            if (port, s) in self.sizes or s in self.rig.ports[port].size
        }
        return Attachment(in_another_form(type(a.effect), sorted(bent))(), a.ports, label)

    def _set_sizes(
        self, assembly: Assembly, p: Array, a: Attachment, sizes: Mapping[str, float]
    ) -> None:
        """Set the parameters (SI) of the planted effects in place."""
        place = {
            b.key.removeprefix(f"{a.label}:"): (assembly.keys[b.key], b)
            for b in assembly.parameters
            if b.owner == a.label
        }
        for name, (i, b) in place.items():
            if b.null is not None:
                p[i] = _amount(b, sizes[TIMES_TYPICAL], sizes.get(WAY, 1.0))
            elif name in (FORM_BEND, FORM_SKEW):
                p[i] = sizes[name]
            elif name == FORM_SETTLING:
                p[i] = sizes[name] * self.machine.period_s
            elif name.startswith(SIGNAL_SIZE):
                signal = name.removeprefix(SIGNAL_SIZE)
                stated = (self.rig.ports[port].size.get(signal, 0.0) for port in a.ports)
                p[i] = max(*(self.sizes.get((port, signal), 0.0) for port in a.ports), *stated)
            elif name != FORM_SCALE:
                p[i] = min(max(b.value * sizes.get(name, 1.0), b.low), b.high)
        if FORM_SCALE in place:
            p[place[FORM_SCALE][0]] = self._change(assembly, p, a)

    def _change(self, assembly: Assembly, p: Array, a: Attachment) -> float:
        """Typical change of the value at the port by the planted effect (SI), before its form is
        changed."""
        plain = replace(assembly, attachments=(a,))
        at = plain.values(self.probe.known)
        for b in plain.parameters:
            straight = b.key in {
                f"{a.label}:{name}" for name in (FORM_BEND, FORM_SKEW, FORM_SETTLING)
            }
            at[plain.keys[b.key]] = b.value if straight else p[assembly.keys[b.key]]
        changes = {
            f"change.{passage.where}": passage.result - passage.value
            for passage in plain.traced.passages
            if passage.port in a.ports
        }
        outputs = _read(plain, self.probe, at, changes)[:, -len(changes) :]
        usual = float(np.percentile(np.abs(outputs), 95.0)) if len(outputs) else 0.0
        return usual if usual > 0.0 else 1.0


def _label(name: str) -> str:
    """Label of a planted effect, without a colon, which separates the parameters."""
    return name.replace(":", "-")


def _amount(b: Bound, times: float, way: float) -> float:
    """So many times the typical size away from the null, on its other side where `way` is negative
    and the bounds allow it."""
    assert b.null is not None
    typical = b.value - b.null or b.spread
    if b.low <= b.null - typical <= b.high:
        typical *= way
    return min(max(b.null + times * typical, b.low), b.high)


def _read(
    assembly: Assembly, probe: Recording, p: Array, extra: Mapping[str, Expr] = MappingProxyType({})
) -> Array:
    """Outputs and further ones of a free run (samples x outputs, SI), up to its end."""
    u, period = data_of(assembly.rig, probe).inputs(assembly), probe.sampling_period_s
    run = free_run(assembly, u, p, period, further=extra)
    return run.outputs[: run.blown_up] if run.blown_up >= 0 else run.outputs


# ---- how it is drawn ---------------------------------------------------------------------------


def draw_specimen(
    machine: OwnMachine, random: np.random.Generator, c: StarterConditions
) -> RigSpecimen:
    """A machine of these conditions; drawn values are shares and multiples of the data sheet, so
    that units do not matter."""
    rig = as_sampled(machine.rig, [machine.period_s])
    probe = machine.as_recording(c, machine.excitation(c, None, PROBE_SEED, 0))
    settings = machine.controller if c.loop == "closed" else {}
    plain = Assembly(rig, controller=tuple(sorted(settings.items())))
    p = plain.values(probe.known)
    read = _read(plain, probe, p)
    run = (data_of(rig, probe).inputs(plain), p, machine.period_s)
    quiet = np.zeros(read.shape[1])
    sizes = port_sizes(plain, [run])
    sizes["", "timescale"] = timescale_of([(read, quiet, machine.period_s)])
    noise = {}
    for name, spread in zip(plain.program.outputs, read.std(axis=0), strict=True):
        stated = rig.noise.get(name, 0.0)
        symbol = split_column(name)[1]
        per_unit = float(to_si(1.0, symbol) - to_si(0.0, symbol))
        noise[name] = stated or NOISE_SHARE * float(spread) / per_unit
    rig = with_declared(rig, noise=noise)
    values = {b.key: _drawn(b, random) for b in plain.parameters if b.fitted}
    # waves by port, over the usual range of its first signal or of its value
    waves = {}
    for name, port in rig.ports.items():
        if port.kind in ROUGH_KINDS:
            signal = next(iter(port.signals), "value")
            span = sizes.get((name, signal)) or port.size.get(signal) or 1.0
            waves[name] = draw_map(random, c.background, span)
    return RigSpecimen(
        machine=machine,
        conditions=c,
        rig=rig,
        sizes=sizes,
        values=values,
        waves=waves if c.background > 0.0 else {},
        steps={
            name: c.noise * level * float(random.uniform(*CONVERTER_STEPS))
            for name, level in noise.items()
            if level
        },
        probe=probe,
    )


def _drawn(b: Bound, random: np.random.Generator) -> float:
    """Values within a standard deviation of the prior; those of the same sign change by the same
    factor either way, so that they do not reach a bound."""
    u = float(random.uniform(-1.0, 1.0))
    if b.log:
        value = b.value * np.exp(u * b.spread)
    elif b.low >= 0.0 < b.value:
        value = b.value * np.exp(u * log1p(b.spread / b.value))
    else:
        value = b.value + u * b.spread
    return float(min(max(value, b.low), b.high))
