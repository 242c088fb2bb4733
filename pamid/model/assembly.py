"""Rig + effects = a flat system of equations, checked when it is put together and never while
solving."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import FileError, nearest
from pamid.base.units import NONE, compatible, split_column, to_si
from pamid.engine.lane_program import LaneProgram
from pamid.engine.sampled_inputs import SampledInputs
from pamid.engine.symbolic.expression import walk
from pamid.engine.symbolic.vocabulary import Expr, held
from pamid.model.attachment import Attachment
from pamid.model.bound_parameter import (
    PERIODS,
    Bound,
    Range,
    Sizes,
    bind,
    parameters_of,
    within,
)
from pamid.model.effect import Effect
from pamid.model.executable import Executable, lane_program_of, program_of
from pamid.model.known_bounds import CURE, KnownObjection, objection
from pamid.model.rig import Rig, background_by_port
from pamid.model.trace import Names, Traced, trace

MEMORIES = frozenset({"play", "bristle"})  # operators whose deflection only travel makes forget
EVEN_DRAWS = 3  # points at which outputs are tested for the sign of a state


def nuisance_owner(term: Effect, place: str) -> str:
    """Owner of a background term's parameters: background.force_map_1."""
    return f"background.{term.name}_{place}" if place else f"background.{term.name}"


@dataclass(frozen=True, eq=False)
class Assembly:
    """A rig with effects attached.

    sizes       magnitudes of signals at ports, for effects' parameters (see
                `pamid.simulation.free_runs.port_sizes`)
    background  whether the rig's tolerance-sized nuisance terms take part
    controller  the [controller] table of a recording: the command is then computed, not read
    sensitive   keys of the parameters with sensitivities (default: all); fewer are
                cheaper
    outputs     only these outputs of the rig (empty: all): what a recording lacks need not be
                computed
    ranges      lowest and highest value (SI) of parameters by key, in place of the declared range
    """

    rig: Rig
    attachments: tuple[Attachment, ...] = ()
    background: bool = False
    controller: tuple[tuple[str, float], ...] = ()
    sizes: Sizes = field(default_factory=dict)
    outputs: tuple[str, ...] = ()
    sensitive: frozenset[str] | None = None
    ranges: Mapping[str, Range] = field(default_factory=dict)

    def __getstate__(self) -> dict[str, Any]:
        """Sent to another process without what was compiled here."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    # ---- parameters -----------------------------------------------------------------------------

    @cached_property
    def parameters(self) -> tuple[Bound, ...]:
        period = self.rig.period_s
        usual = {("", "period"): period, ("", "timescale"): PERIODS * period}
        usual["", "time"] = PERIODS * PERIODS * period
        sizes = {**usual, **self.sizes}
        bound = [bind(p, "", None, "", sizes) for p in self.rig.parameters]
        for port_name, place, term in self._nuisance():
            owner = nuisance_owner(term, place)
            bound += [
                bind(p, owner, self.rig.ports[port_name], port_name, sizes) for p in term.parameters
            ]
        for a in self.attachments:
            port = self.rig.ports[a.ports[0]]
            bound += [
                bind(p, a.label, port, a.ports[0], sizes) for p in parameters_of(a.effect, port)
            ]
        return tuple(within(b, self.ranges.get(b.key)) for b in bound)

    def _nuisance(self) -> list[tuple[str, str, Effect]]:
        """(port, place, term): a copy of every background term at every place of its port."""
        if not self.background:
            return []
        return [
            (name, place, term)
            for name, terms in background_by_port(self.rig).items()
            for term in terms
            for place in self.rig.ports[name].places or ("",)
        ]

    @cached_property
    def background_terms(self) -> dict[str, Effect]:
        """By the owner of their parameters."""
        return {nuisance_owner(term, place): term for _, place, term in self._nuisance()}

    def for_fitting(self) -> Assembly:
        """The same with derivatives by fitted parameters only."""
        return replace(self, sensitive=frozenset(b.key for b in self.parameters if b.fitted))

    @cached_property
    def with_plain_readings(self) -> Assembly | None:
        """The same without the effects at its readings; None where there are none."""
        others = tuple(a for a in self.attachments if self.rig.ports[a.ports[0]].kind != "reading")
        return replace(self, attachments=others) if len(others) < len(self.attachments) else None

    @cached_property
    def keys(self) -> dict[str, int]:
        return {b.key: i for i, b in enumerate(self.parameters)}

    def values(self, known: dict[str, float] | None = None) -> Array:
        """Parameter vector (SI): data-sheet values, then `known` given by outside name or key
        (outside units). FileError where a known value cannot be."""
        return self.with_known(np.array([b.value for b in self.parameters]), known or {})

    def with_known(self, p: Array, known: Mapping[str, float]) -> Array:
        """A parameter vector (SI) with known values put in; errors as of `values`."""
        for fault in self.known_objections(known):
            if fault.impossible:
                raise FileError(f"{fault.text} (rig {self.rig.name!r}).", CURE, code="known")
        out = p.copy()
        for name, value in known.items():
            i, factor = self.place_of(name)
            out[i] = value * factor
        return out

    def known_objections(self, known: Mapping[str, float]) -> list[KnownObjection]:
        """Known values of the rig's parameters that lie outside their bounds."""
        objections = []
        for name, value in known.items():
            i, factor = self.place_of(name)
            b = self.parameters[i]
            if not b.owner and (fault := objection(b, name, value, value * factor)):
                objections.append(fault)
        return objections

    def data_sheet(self) -> Array:
        """Parameter vector (SI) of the rig as its data sheet has it: every effect at its null."""
        return np.array([b.value if b.null is None else b.null for b in self.parameters])

    def index_of(self, name: str) -> int:
        """Place of a parameter; see `place_of`."""
        return self.place_of(name)[0]

    def place_of(self, name: str) -> tuple[int, float]:
        """Place of a parameter given as outside name, `label:outside_name` or key, and the factor
        to SI of a number in the unit of that name: "area_mm2" names area_cm2 as well, as columns
        do. FileError where there is none."""
        for i, b in enumerate(self.parameters):
            if name in (b.key, b.full_name):
                return i, b.factor
        stem, symbol = split_column(name)
        for i, b in enumerate(self.parameters):
            known, unit = split_column(b.full_name)
            if known == stem and symbol != NONE and unit != NONE and compatible(symbol, unit):
                return i, to_si(1.0, symbol) - to_si(0.0, symbol)
        names = [b.full_name for b in self.parameters]
        raise FileError(
            f"rig {self.rig.name!r} has no parameter {name!r}",
            nearest(name, names) or f"Name a parameter that it has: {', '.join(names)}.",
        )

    def knows(self, name: str) -> bool:
        """Whether there is a parameter of this name. See `place_of`."""
        try:
            self.place_of(name)
        except FileError:
            return False
        return True

    def start(self, p: Array) -> Array:
        """Initial state of a recording at parameters p, states of effects included (zero)."""
        begin = self.begin(p)
        return np.array([begin.get(name, 0.0) for name in self.program.states])

    def begin(self, p: Array) -> dict[str, float]:
        """The rig's states at the beginning of a recording, by name (SI)."""
        values = {b.key: float(p[i]) for i, b in enumerate(self.parameters) if not b.owner}
        given = self.rig.start(Names(values, "parameter"))
        return {s.name: given.get(s.name, s.start) for s in self.rig.states}

    # ---- equations ------------------------------------------------------------------------------

    @cached_property
    def traced(self) -> Traced:
        def effects_at(port: str, place: str) -> list[tuple[str, Effect]]:
            nuisance = [
                (nuisance_owner(term, at), term)
                for name, at, term in self._nuisance()
                if (name, at) == (port, place)
            ]
            attached = [
                (a.label, a.effect)
                for a in sorted(self.attachments, key=lambda a: a.label)
                if a.acts_at(port, place)
            ]
            return nuisance + attached

        upper_bounds = {b.key: b.high for b in self.parameters if b.owner}
        return trace(self.rig, effects_at, dict(self.controller), upper_bounds)

    @cached_property
    def program(self) -> Executable:
        return self.program_with({})

    @cached_property
    def keeps_memories(self) -> bool:
        """Whether an equation holds a play or a bristle. Its deflection fades over travel, not over
        time: a wide bristle keeps its initial value for good."""
        t = self.traced
        cells = [e for c in t.cells for e in (c.update, c.joined) if isinstance(e, Expr)]
        return any(n.op in MEMORIES for n in walk([*t.rates.values(), *t.outputs.values(), *cells]))

    @cached_property
    def even_states(self) -> tuple[int, ...]:
        """Places of the rig's states whose size the outputs show, but not their sign: the speed
        behind a reading |v|. Found by trying it, at points drawn at random."""
        n, random = len(self.rig.states), np.random.default_rng(0)
        even, shown = np.ones(n, bool), np.zeros(n, bool)
        for _ in range(EVEN_DRAWS):
            x = random.standard_normal(n)
            u = random.standard_normal(len(self.traced.inputs))
            if not even.any():  # a single point is enough to show a sign
                break
            readings = self._read(x, u)
            for i in np.flatnonzero(even):
                turned, larger = x.copy(), x.copy()
                turned[i], larger[i] = -x[i], 2.0 * x[i]
                even[i] = bool(np.allclose(self._read(turned, u), readings, rtol=1e-9, atol=0.0))
                if even[i]:
                    shown[i] |= not np.allclose(
                        self._read(larger, u), readings, rtol=1e-6, atol=0.0
                    )
        return tuple(int(i) for i in np.flatnonzero(even & shown))

    def reads_as(self, other: Assembly) -> bool:
        """Whether the outputs are the same expressions as those of another assembly."""
        traced, theirs = self.traced, other.traced
        return traced.cells == theirs.cells and traced.outputs == theirs.outputs

    def _read(self, x: Array, u: Array) -> Array:
        """Outputs in these states of the rig, at the data sheet's parameters and inputs u."""
        p = self.values()
        begun = self.start(p)
        begun[: len(x)] = x
        memory = self.program.memory(begun, period_s=self.rig.period_s)
        outputs: Array = self.program.run(memory, SampledInputs(u[None, :], self.rig.period_s), p)[
            0
        ]
        return outputs[0]

    def program_with(self, extra: dict[str, Expr]) -> Executable:
        """Compiled equations with further outputs, in the order of `extra`, after the rig's.
        These have no sensitivities, and where there are any, no parameter has."""
        sensitive = frozenset[str]() if extra else self.sensitive
        return program_of(
            self.rig, self.traced, self._outputs_with(extra), tuple(self.keys), sensitive
        )

    @cached_property
    def lane_program(self) -> LaneProgram:
        """The equations for several hypotheses side by side."""
        return self.lane_program_with({})

    def lane_program_with(self, extra: dict[str, Expr]) -> LaneProgram:
        """`lane_program` with further outputs, as of `program_with`."""
        outputs = self._outputs_with(extra)
        return lane_program_of(self.rig, self.traced, outputs, tuple(self.keys))

    def _outputs_with(self, extra: dict[str, Expr]) -> dict[str, Expr]:
        outputs = {k: self.traced.outputs[k] for k in self.outputs or self.traced.outputs}
        return outputs | {k: held(value) for k, value in extra.items()}
