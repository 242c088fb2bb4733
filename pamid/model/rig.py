"""A rig: states, parameters, ports and equations of a grey-box model, written once as plain Python.

    class Cart(Rig):
        inputs = {"force_n": "N"}
        outputs = {"position_m": "m"}
        ports = {
            "force": Port("motion", "N", signals=("velocity", "position")),
            "sensor": Port("reading", "m"),
        }
        states = (State("position", "m"), State("velocity", "m/s"))
        parameters = (Parameter("mass", 1.0, 0.1, 10.0, "kg", source="kitchen scale"),)

        def rates(self, x, u, p, port):
            force = port("force", u.force_n, velocity=x.velocity, position=x.position)
            return {"position": x.velocity, "velocity": force / p.mass}

        def measure(self, x, u, p, port):
            return {"position_m": port("sensor", x.position)}

Inputs and outputs are columns of a recording, with the SI unit in which the equations see them: a
name ends in the unit of its column, "pressure_bar": "Pa". Parameters likewise: `mass_kg` is stated
in kg, `area_cm2` in cm2, and p.area_cm2 is in m2.

`between = {"drive_v": "linear"}` states that an input leads between samples in a
straight line (a measured force, a filtered voltage) instead of being held (what a converter sends);
`ranges = {"valve": (0.0, 1.0)}` what an input can be, in the unit of its column.
"""

from __future__ import annotations

import copy
import re
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Protocol

import numpy as np

from pamid.base.arrays import Array
from pamid.base.csv_table import name_fault
from pamid.base.errors import FileError, nearest
from pamid.base.units import (
    NONE,
    compatible,
    divided_name,
    quantity_of,
    si_symbol,
    split_column,
    unit,
    with_unit,
)
from pamid.engine.symbolic.vocabulary import Expr, Number
from pamid.model.effect import KINDS, RIG_SECTIONS, Effect, State, sections
from pamid.model.parameter import Parameter
from pamid.recording.file_checks import BEFORE, BETWEEN
from pamid.recording.recording import Recording


@dataclass(frozen=True)
class Port:
    """A named place where physics may be added.

    Sign: a value counts along the port's `position`. What dissipates is taken off along
    `velocity`, what holds along `position`, what is lost from what fills a store. So pass what
    acts ON the moving part, in the direction in which position counts. A bench that imposes the
    motion and reads the reaction reads the opposite of that: pass everything but the force that is
    read, and give its negative to the sensor (`data/rigs/piston_bench.py`). With the other sign
    every friction would drive the motion, and its fit ends at its null.

    kind, unit (SI)  what passes through
    signals          what the rig offers there: names, or names with their SI units
    places           several like places that share an effect's parameters (muscle 1 and 2); () is
                     a single place
    group            the name reported for it, where several ports count together (default: its
                     name)
    kin              a name that like ports share: an effect may act at any of them or, with common
                     parameters, at all of them
    size             typical magnitude of "value" and of the signals, SI; found from the recording
                     where absent. Effects begin at, and are bounded by, shares of it: state it
                     where the data sheet's run does not show it (the model rests, a value of 0)
    general          False on rigs with a separate catalogue: the general catalogue stays away
    called           what people call a signal where it has another name than here
    """

    kind: str
    unit: str = ""
    signals: tuple[str, ...] | dict[str, str] = ()
    places: tuple[str, ...] = ()
    group: str = ""
    kin: str = ""
    size: dict[str, float] = field(default_factory=dict)
    general: bool = True
    called: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Units as pamid writes them, so that "Nm" is a torque wherever a torque is looked for."""
        object.__setattr__(self, "unit", _si_unit(self.unit))
        if isinstance(self.signals, dict):
            signals = {name: _si_unit(symbol) for name, symbol in self.signals.items()}
            object.__setattr__(self, "signals", signals)

    def unit_of(self, signal: str) -> str:
        """SI unit of the value or of a signal offered here; mechanical signals follow from the
        port's unit."""
        if signal == "value":
            return self.unit
        if isinstance(self.signals, dict) and signal in self.signals:
            return self.signals[signal]
        length = "rad" if quantity_of(self.unit) in ("torque", "angle") else "m"
        return {
            "position": length,
            "velocity": f"{length}/s",
            "stretch": length,
            "load": "N",
            "time": "s",
        }.get(signal, "")


def _si_unit(symbol: str) -> str:
    """The unit of a port as pamid writes it; FileError for what is none, or not SI."""
    if not symbol or symbol == NONE:
        return symbol
    try:
        read = unit(symbol)
    except FileError as error:
        raise FileError(f"unit of a port: {error.message}", error.hint, code="unit") from None
    if read.factor != 1.0 or read.offset:
        raise FileError(
            f"a port is declared in {symbol!r}, but the equations see SI",
            f"Declare it in {si_symbol(symbol)!r}.",
            code="unit",
        )
    return read.symbol


@dataclass(frozen=True)
class Loop:
    """A column that a controller may produce: command = PD(reference - reading)."""

    command: str
    reference: str
    reading: str


@dataclass(frozen=True)
class LogName:
    """How the logs of a robot call a column: by joint or motor, and what of it.

    names       of what the column belongs to: sensor or motor first, then its joint
    quantity    position, velocity or effort, "" where it can be any
    sent        a command
    places      in the vectors of a simulator: its name -> from 0
    per_effort  what is sent (column's unit) per N m or N at the joint, where in the model a
                measured effort is nothing else; None: it does not
    """

    names: tuple[str, ...]
    quantity: str
    sent: bool = False
    places: dict[str, int] = field(default_factory=dict)
    per_effort: float | None = None


class RigForms(Protocol):
    """Forms of a rig, with the same parameters and columns, of which recordings decide."""

    def named(self, form: str) -> Rig:
        """The rig in a form; FileError for a name that is none."""

    def suiting(self, recordings: Sequence[Recording]) -> Rig | None:
        """The rig in the form that recordings need, with `form` and `form_note`; None where they
        decide nothing."""

    def left_out(self, rig: Rig, recording: Recording) -> str:
        """Interactions in a recording that this form of the rig leaves out, in sentences; "" for
        none."""


class Rig:
    """Base of all rigs. See the module's docstring for a whole example."""

    name: ClassVar[str] = ""
    inputs: ClassVar[dict[str, str]] = {}
    # inputs that may be missing in a recording, with their value
    optional: ClassVar[dict[str, float]] = {}
    # course of an input between two samples: "held" (the default) or "linear"; a recording's TOML
    # may say otherwise under [between]; an output may be "before": read before its row's command
    between: ClassVar[dict[str, str]] = {}
    # range of an input, in the unit of its column: (lowest, highest)
    ranges: ClassVar[dict[str, tuple[float, float]]] = {}
    outputs: ClassVar[dict[str, str]] = {}
    ports: ClassVar[dict[str, Port]] = {}
    states: ClassVar[tuple[State, ...]] = ()
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    # name -> parameters that the equations hold only where a recording's [free] releases them under
    # this name; their spreads are those of a deviation of 1
    on_request: ClassVar[dict[str, tuple[Parameter, ...]]] = {}
    # port -> tolerance-sized nuisance terms
    background: ClassVar[dict[str, Effect | tuple[Effect, ...]]] = {}
    loops: ClassVar[tuple[Loop, ...]] = ()
    # default [controller] of a closed-loop recording
    controller: ClassVar[dict[str, float]] = {}
    # standard deviation of each output's noise, column's unit
    noise: ClassVar[dict[str, float]] = {}
    # usual sampling period, s; that of the recordings where a rig states none
    period_s: ClassVar[float] = 0.003
    # how long a recording remembers, s; found from the recordings where absent. Windows of a fit,
    # of a replay and of a smoother are multiples of it
    timescale_s: ClassVar[float | None] = None
    # usual amplitude of references and commands, column's unit
    excited: ClassVar[dict[str, float]] = {}
    # centre of an excitation where that is not 0, column's unit
    centre: ClassVar[dict[str, float]] = {}
    # usual shortest and longest time at a level of an excitation, s
    hold_s: ClassVar[tuple[float, float]] = (0.4, 1.6)
    # inputs that cannot jump, such as an imposed position: sent in ramps from level to level
    ramped: ClassVar[tuple[str, ...]] = ()
    # what is driven by itself -> its command, and the sign that loads it
    actuators: ClassVar[dict[str, tuple[str, float]]] = {}
    # of `pamid.simulation.excitation.experiments`, offered before the general ones
    experiments: ClassVar[tuple[Any, ...]] = ()
    # [known] parameter that can be changed at the rig -> another value for it, its name's unit: an
    # experiment is repeated with the first of them
    changeable: ClassVar[dict[str, float]] = {}
    # input for a force or torque from outside -> its usual highest value, column's unit
    external: ClassVar[dict[str, float]] = {}
    # what a robot's log calls a column, and how long the vectors are that such logs hold
    log_names: ClassVar[dict[str, LogName]] = {}
    vector_sizes: ClassVar[dict[str, int]] = {}
    # the method that a user has written in the place of another
    written_as: ClassVar[dict[str, str]] = {}
    # forms in which it can be run, None if there is a single form; that which recordings have
    # decided, by its name in a run; and why, as a sentence
    forms: ClassVar[RigForms | None] = None
    form: ClassVar[str] = ""
    form_note: ClassVar[str] = ""
    # remarks in addition to its tables: how it was made, what it leaves out
    remarks: ClassVar[tuple[str, ...]] = ()
    # of the catalogue, the default where a recording names no rig
    usual: ClassVar[bool] = False

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if "name" not in cls.__dict__:
            cls.name = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "-", cls.__name__).lower()

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        """Time derivative of every state (SI); a rig without states need not say it."""
        if self.states:
            raise NotImplementedError
        return {}

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        """Every output, in the unit declared for it."""
        raise NotImplementedError

    def auxiliary_signals(self) -> dict[str, Expr]:
        """Further signals of the equations, by name; nothing by default."""
        return {}

    def differential_states(self) -> list[str]:
        """States that `rates` gives a rate of."""
        return [s.name for s in self.states]

    def start(self, p: Any) -> dict[str, float]:
        """State (SI) in which a recording begins, where it differs from the states' start; p
        holds numbers."""
        return {}

    def combinations(self, p: Any) -> dict[str, Number]:
        """Combinations of parameters in which alone the equations hold them, such as mass times
        distance: name with its unit -> value (SI) from the parameters p (SI), numbers or symbols;
        nothing by default."""
        return {}

    def pose(self, y: Mapping[str, Array], p: Any) -> dict[str, Array]:
        """Drawing of the rig: polylines in metres, name -> (samples, points, 2); nothing by
        default.

        y: outputs by name (SI), a value per sample; p: parameters (SI).
        """
        return {}

    @classmethod
    def story(cls) -> dict[str, str]:
        """The docstring of the rig's file, section by section: title, What it is, Equations,
        Typically missing, References."""
        module = sys.modules.get(cls.__module__)
        return sections((module.__doc__ if module else "") or "", RIG_SECTIONS)

    def group_of(self, port: str) -> str:
        """The name a port is reported under."""
        return self.ports[port].group or port


def with_declared(rig: Rig, **declared: Any) -> Rig:
    """A copy of the rig with other declarations, as between={...}: the same rig object serves all
    assemblies of a run."""
    changed = copy.copy(rig)
    vars(changed).update(declared)
    return changed


def background_by_port(rig: Rig) -> dict[str, tuple[Effect, ...]]:
    """The rig's background terms; a port that declares a single term has a tuple of it."""
    return {
        port: tuple(terms) if isinstance(terms, tuple | list) else (terms,)
        for port, terms in rig.background.items()
    }


def chain_of_links(angles: Sequence[Array], lengths: Sequence[float]) -> Array:
    """Links in a row from the origin, (samples, 1 + links, 2) in the unit of `lengths`; angles from
    the x axis, rad."""
    points = [np.zeros((len(angles[0]), 2))]
    for angle, length in zip(angles, lengths, strict=True):
        points.append(points[-1] + length * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    return np.stack(points, axis=1)


def check_rig(rig: Rig, where: str) -> None:
    """Refuse a rig whose declarations cannot be used; equations are checked when they are
    assembled."""
    kind = f"{where}: rig {rig.name!r}"
    for what in ("inputs", "outputs", "ports"):
        if not isinstance(getattr(rig, what), dict):
            raise FileError(
                f"{kind}: {what} must be a dict", "see pamid rigs one-dof and data/rigs/cart.py"
            )
    if not rig.outputs:
        raise FileError(
            f"{kind} has no outputs, so nothing can be compared", 'outputs = {"position_m": "m"}'
        )
    for what in ("inputs", "outputs"):
        for column, declared in getattr(rig, what).items():
            _check_column(f"{kind}: {what[:-1]} {column!r}", column, declared)
    read_before = {c for c, way in rig.between.items() if way == BEFORE and c in rig.outputs}
    for what, stated in (("between", rig.between), ("ranges", rig.ranges)):
        for column in stated:
            if column not in rig.inputs and not (what == "between" and column in read_before):
                raise FileError(
                    f"{kind}: {what} names {column!r}, which is not among the inputs",
                    nearest(column, list(rig.inputs)) or f"inputs: {', '.join(rig.inputs)}",
                )
    for column, way in rig.between.items():
        if way not in BETWEEN and column not in read_before:
            raise FileError(
                f"{kind}: between is {way!r} for the input {column!r}",
                f'between = {{"{column}": "linear"}}, or "held"',
            )
    for column, limits in rig.ranges.items():
        sound = isinstance(limits, tuple | list) and len(limits) == 2
        if not sound or not float(limits[0]) < float(limits[1]):
            raise FileError(
                f"{kind}: the range of {column!r} is {limits!r:.60}",
                f'ranges = {{"{column}": (lowest, highest)}}, in the unit of the column',
            )
    for name, port in rig.ports.items():
        if port.kind not in KINDS:
            raise FileError(
                f"{kind}: port {name!r} has the unknown kind {port.kind!r}",
                nearest(port.kind, list(KINDS)) or f"kinds: {', '.join(KINDS)}",
            )
    counts = Counter(p.name for p in rig.parameters)
    for twice in sorted(name for name, count in counts.items() if count > 1):
        raise FileError(f"{kind}: parameter {twice!r} is declared twice", "give it another name")
    for column in rig.optional:
        if column not in rig.inputs:
            raise FileError(
                f"{kind}: optional input {column!r} is not among the inputs",
                nearest(column, list(rig.inputs)),
            )
    for what in ("excited", "centre", "ramped"):
        sent = {*rig.inputs, *(q.reference for q in rig.loops)}
        for column in getattr(rig, what):
            if column not in sent:
                raise FileError(
                    f"{kind}: {what} names {column!r}, which is not an input or reference",
                    nearest(column, sorted(sent)) or f"choose from: {', '.join(sorted(sent))}",
                )
    for name in rig.background:
        if name not in rig.ports:
            raise FileError(
                f"{kind}: background names the port {name!r}, which it does not have",
                nearest(name, list(rig.ports)),
            )


def _check_column(what: str, column: str, declared: str) -> None:
    stem, written = split_column(column)
    if fault := name_fault(column):
        raise FileError(f"{what} {fault}", "letters, digits and _ are safe, as in angle_deg")
    if not isinstance(declared, str):
        raise FileError(f"{what} is declared as {declared!r:.40}", f'"{column}": "SI unit"')
    seen = unit(declared)
    if written == NONE and seen.symbol != NONE:
        raise FileError(
            f"{what} has no unit in its name, but is declared in {declared!r}",
            f'name the column "{with_unit(stem, declared)}"',
            code="unit",
        )
    meant = divided_name(column)
    if meant and compatible(split_column(meant)[1], declared):
        raise FileError(
            f"{what} ends in {written!r}, but is declared in {declared!r}: in a name _ multiplies",
            f'name the column "{meant}", here and in the recordings: _per_ divides',
            code="unit",
        )
    if not compatible(written, declared) or seen.factor != 1.0 or seen.offset:
        raise FileError(
            f"{what}: declare it in {si_symbol(written)!r}, not in {declared!r}; the equations see "
            f"SI, and recordings are converted from {written!r}",
            f'"{column}": "{si_symbol(written)}"',
            code="unit",
        )
