"""Test bench for effects: rigs and attachments found by scanning, excited runs, and one way to run
them."""

from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.engine.program import Stepping
from pamid.engine.sampled_inputs import SampledInputs
from pamid.engine.symbolic.expression import symbol
from pamid.model.assembly import Assembly
from pamid.model.attachment import Attachment, attachments
from pamid.model.bound_parameter import Sizes
from pamid.model.registry import effects, rig_named, rigs
from pamid.model.rig import Rig
from pamid.simulation.excitation.experiments import usual_range
from pamid.simulation.excitation.waveforms import ramps
from pamid.simulation.free_runs import port_sizes

TEST_RIGS = sorted(Path(__file__).parents[1].joinpath("rigs").glob("*.py"))
STEPPING = Stepping(2)
DURATION_S = 5.0
FEWEST = 500  # samples, where the rig is slow


@dataclass(frozen=True)
class Case:
    """An effect attached to a rig."""

    rig: str
    attachment: Attachment

    def __str__(self) -> str:
        return f"{Path(self.rig).stem}:{self.attachment.label}"


@lru_cache
def rig_of(name: str) -> Rig:
    return rig_named(name)


def rig_names() -> list[str]:
    return [*rigs(), *map(str, TEST_RIGS)]


def cases() -> list[Case]:
    """Every effect at every port of every rig; of ports that are kin at one of them, another one
    for the next effect, and at all together."""
    found: list[Case] = []
    for name in rig_names():
        alike: dict[tuple[str, str], list[Attachment]] = {}
        for a in attachments(rig_of(name), effects().values()):
            kin = rig_of(name).ports[a.ports[0]].kin
            if kin and len(a.ports) == 1:
                alike.setdefault((a.effect.name, kin), []).append(a)
            else:
                found.append(Case(name, a))
        found += [Case(name, same[k % len(same)]) for k, same in enumerate(alike.values())]
    return found


def sample(every: list[Case], rigs_of_effect: int = 3) -> set[Case]:
    """Cases in which every effect meets every kind of port that it fits and some rigs, and every
    port of every rig meets an effect."""
    chosen: list[Case] = []
    seen: set[tuple[str, ...]] = set()

    def take(case: Case, *keys: tuple[str, ...]) -> None:
        if not seen.issuperset(keys):
            chosen.append(case)
            rig, a = case.rig, case.attachment
            kind = rig_of(rig).ports[a.ports[0]].kind
            seen.update({(a.effect.name, kind), (a.effect.name, rig)})
            seen.update((rig, port, "port") for port in a.ports)

    names = sorted({case.attachment.effect.name for case in every})
    for number, name in enumerate(names):
        own_cases = [case for case in every if case.attachment.effect.name == name]
        rigs = sorted({case.rig for case in own_cases})
        turned = rigs[number % len(rigs) :] + rigs[: number % len(rigs)]
        for rig in turned[:rigs_of_effect]:
            on_rig = [case for case in own_cases if case.rig == rig]
            take(on_rig[number % len(on_rig)], (name, rig))
    for case in every:
        a, ports = case.attachment, rig_of(case.rig).ports
        take(case, (a.effect.name, ports[a.ports[0]].kind))
        take(case, *((case.rig, port, "port") for port in a.ports))
    return set(chosen)


def _steps(rng: np.random.Generator, n: int, shortest: int, longest: int, size: float) -> Array:
    out = np.empty(n)
    k = 0
    while k < n:
        hold = int(rng.integers(shortest, longest))
        out[k : k + hold] = rng.uniform(-size, size)
        k += hold
    return out


@lru_cache
def excitation(name: str) -> Array:
    """Inputs (samples x inputs) that move the plain rig through its range at several speeds."""
    rig = rig_of(name)
    rng = np.random.default_rng(7)
    n = max(FEWEST, round(DURATION_S / rig.period_s))
    if rig.loops:
        return _closed_loop_commands(rig, rng, n)
    columns = []
    for column in rig.inputs:
        declared = next(
            (q.size["value"] for q in rig.ports.values() if q.kind == "command" and q.size), 1.0
        )
        usual = usual_range(rig, column)
        centre, half = usual or (0.4 * declared, 0.6 * declared)
        wave = _steps(rng, n, n // 25, n // 8, 0.7)
        wave = ramps(wave) if column in rig.ramped else wave
        wave += 0.2 * np.sin(np.arange(n) * (DURATION_S / n) * 9.0)
        idle = column in rig.optional and usual is None
        columns.append(np.full(n, rig.optional[column]) if idle else centre + half * wave)
    # a rig without inputs moves from its start
    return np.column_stack(columns) if columns else np.zeros((n, 0))


def _closed_loop_commands(rig: Rig, rng: np.random.Generator, n: int) -> Array:
    """Record what the rig's own controller sends while its reference steps, ramps and rests."""
    closed = Assembly(rig, controller=tuple(rig.controller.items()))
    u = np.zeros((n, len(closed.program.inputs)))
    for loop in rig.loops:
        reference = _steps(rng, n, n // 12, n // 5, np.deg2rad(35.0))
        slow = slice(n // 2, 3 * n // 4)
        reference[slow] = np.deg2rad(30.0) * np.sin(
            np.linspace(0.0, 2.0 * np.pi, reference[slow].size)
        )
        u[:, closed.program.inputs.index(loop.reference)] = reference
    p = closed.values()
    extra = {f"sent_{loop.command}": loop.command for loop in rig.loops}
    program = closed.program_with({k: symbol("cell", v) for k, v in extra.items()})
    y, _, bad = program.run(program.memory(closed.start(p)), SampledInputs(u, rig.period_s), p)
    assert bad == -1
    sent = dict(zip(extra.values(), y[:, -len(extra) :].T, strict=True))
    plain = Assembly(rig).program.inputs
    return np.column_stack([sent.get(c, np.zeros(n)) for c in plain])


@cache
def one_sided(case: Case) -> bool:
    """Does what passes through the case's port keep its sign throughout?"""
    plain, name = Assembly(rig_of(case.rig)), case.attachment.ports[0]
    through = [q.value for q in plain.traced.passages if q.port == name]
    program = plain.program_with({f"through_{k}": value for k, value in enumerate(through)})
    p = plain.values()
    period = plain.rig.period_s
    memory = program.memory(plain.start(p), stepping=STEPPING, period_s=period)
    y, _, bad = program.run(
        memory, SampledInputs(excitation(case.rig), period), p, stepping=STEPPING
    )
    values = y[:, -len(through) :]
    assert bad == -1
    return bool(values.min() >= 0.0 or values.max() <= 0.0)


@cache
def sizes_of(name: str) -> Sizes:
    """Magnitudes at the ports of a rig that declares none, over its excitation."""
    rig = rig_of(name)
    if any(port.size for port in rig.ports.values()):
        return {}
    plain = Assembly(rig)
    return port_sizes(plain, [(excitation(name), plain.values(), rig.period_s)])


@cache
def assembled(case: Case) -> Assembly:
    return Assembly(rig_of(case.rig), (case.attachment,), sizes=sizes_of(case.rig))


def run(
    assembly: Assembly,
    u: Array,
    p: Array,
    columns: list[int] | None = None,
    *,
    stepping: Stepping = STEPPING,
) -> tuple[Array, Array, int]:
    """Outputs (samples x outputs), sensitivities for the parameters in `columns`, first bad sample
    or -1."""
    program = assembly.program
    period = assembly.rig.period_s
    memory = program.memory(
        assembly.start(p), len(columns or []), stepping=stepping, period_s=period
    )
    chosen: NDArray[np.int64] | None = None
    if columns is not None:
        chosen = np.full(len(program.parameters), -1, np.int64)
        chosen[columns] = np.arange(len(columns))
    return program.run(memory, SampledInputs(u, period), p, stepping=stepping, columns=chosen)


@cache
def plain_run(name: str) -> Array:
    assembly = Assembly(rig_of(name))
    y, _, bad = run(assembly, excitation(name), assembly.values())
    assert bad == -1
    return y


def own(assembly: Assembly) -> list[int]:
    """Indices of the effects' parameters."""
    return [i for i, b in enumerate(assembly.parameters) if b.owner]


def drawn(assembly: Assembly, rng: np.random.Generator) -> Array:
    """Data-sheet rig with the effect's parameters anywhere between their bounds."""
    p = assembly.values()
    for i in own(assembly):
        b = assembly.parameters[i]
        p[i] = (
            np.exp(rng.uniform(np.log(b.low), np.log(b.high)))
            if b.log
            else rng.uniform(b.low, b.high)
        )
    return p


def at_null(assembly: Assembly, p: Array) -> Array:
    """`p` with every null taken."""
    p = p.copy()
    for i in own(assembly):
        null = assembly.parameters[i].null
        if null is not None:
            p[i] = null
    return p


def typical(assembly: Assembly) -> Array:
    """A point at which every parameter has something to do: a typical value, off nulls and bounds.

    It is also moved off round numbers: a delay of whole samples or a pulse of whole ticks is a
    kink.
    """
    p = assembly.values()
    for i in own(assembly):
        b = assembly.parameters[i]
        p[i] = b.tries[0] if b.tries else b.value
        if p[i] in (b.null, b.low, b.high):
            p[i] = b.low + 0.4 * (b.high - b.low)
        if p[i] == b.null:
            p[i] = b.low + 0.6 * (b.high - b.low)
        p[i] += 0.01370417 * min(b.high - p[i], p[i] - b.low)
    return p
