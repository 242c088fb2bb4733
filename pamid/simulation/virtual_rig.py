"""A virtual rig made to order: rig, effects with parameters, known and hidden values, noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pamid.base.arrays import Array
from pamid.base.errors import FileError, UsageError, nearest
from pamid.base.progress import tell
from pamid.model.assembly import Assembly
from pamid.model.attachment import Attachment, attach
from pamid.model.between_samples import as_recorded
from pamid.model.effect import Effect
from pamid.model.registry import effects_with, in_catalogue, name_of, rig_named
from pamid.model.rig import Rig
from pamid.model.sampling import as_sampled
from pamid.recording.recording import Recording
from pamid.simulation.free_runs import port_sizes, virtual_recording
from pamid.simulation.rig_data import data_of


@dataclass(frozen=True)
class VirtualRecording:
    """columns in their units; meta: the tables of the TOML next to the recording, which name a
    rig of the catalogue only: a file's name may reveal the planted effect;
    effects: labels with values; remarks: what is odd about what was simulated, but not wrong."""

    columns: dict[str, Array]
    meta: dict[str, Any]
    effects: list[str]
    remarks: tuple[str, ...] = ()


def split_spec(spec: str) -> tuple[str, dict[str, float]]:
    """ "dead-time:delay_s=0.03,gain=2" -> ("dead-time", {...})."""
    name, _, rest = spec.partition(":")
    values = {}
    for pair in filter(None, rest.split(",")):
        key, sign, value = pair.partition("=")
        try:
            values[key.strip()] = float(value)
        except ValueError:
            sign = ""
        if not sign:
            raise UsageError(
                f"effect {spec!r}: {pair!r} is not parameter=number",
                "for example dead-time:delay_s=0.03",
            )
    return name, values


def attach_specs(
    rig: Any, specs: tuple[str | type[Effect], ...]
) -> list[tuple[Attachment, dict[str, float]]]:
    """Attachments named on the command line, with the values given for their parameters."""
    catalogue, names = effects_with(specs)
    attached = []
    for spec in names:
        name, values = split_spec(spec)
        attached.append((attach(rig, name, catalogue), values))
    labels = [a.label for a, _ in attached]
    for label in sorted({x for x in labels if labels.count(x) > 1}):
        raise UsageError(f"effect {label!r} is given twice", f"name the ports: {label}@PORT")
    return attached


def form_remarks(rig: Rig, excitation: Recording, columns: Mapping[str, Array]) -> tuple[str, ...]:
    """Interactions in a simulated motion that the form of the rig leaves out, in sentences.

    columns: readings by name, in their units.
    """
    if rig.forms is None:
        return ()
    motion = replace(excitation, columns=dict(columns), path=Path("the simulated motion"))
    return tuple(filter(None, [rig.forms.left_out(rig, motion)]))


def in_its_loop(rig: Rig, excitation: Recording) -> bool:
    """Whether the controller runs: with the references of all loops and no command it does, with
    all commands or nothing of either it does not. FileError for anything between."""
    commands = [q.command for q in rig.loops if excitation.has(q.command)]
    references = [q.reference for q in rig.loops if excitation.has(q.reference)]
    if len(commands) == len(rig.loops) or not commands and not references:
        return False
    if not commands and len(references) == len(rig.loops):
        return True
    there = " and ".join([*references, *commands])
    lacking = (q.command if commands else q.reference for q in rig.loops)
    missing = " and ".join(c for c in lacking if not excitation.has(c))
    raise FileError(
        f"{excitation.path} has {there}, but not {missing}",
        f"rig {rig.name!r} runs with the references of all its loops, or with all their commands "
        "(a command of 0 has no effect)",
    )


def stated_tables(
    rig: str, excitation: Recording, known: dict[str, float], controller: dict[str, float] | None
) -> dict[str, Any]:
    """Tables of the TOML next to a simulated recording. rig: stated if the catalogue has it;
    controller: its settings, None for an open loop."""
    named = {"rig": rig} if in_catalogue(rig) else {}
    loop = {
        "loop": "open" if controller is None else "closed",
        "sampling_period_s": excitation.sampling_period_s,
    }
    tables = {"known": known, "controller": controller, "between": excitation.between}
    filled = {title: t for title, t in tables.items() if t or (title == "controller" and t == {})}
    return {"recording": named | loop, **filled}


def simulate_virtual_rig(
    rig_name: str | Rig,
    excitation: Recording,
    specs: tuple[str | type[Effect], ...],
    known: dict[str, float],
    hidden: dict[str, float],
    noise: float,
    seed: int,
) -> VirtualRecording:
    """Simulate. Effects without given values act at their typical size; `known` goes before what
    the excitation has.
    """
    tell("equations")
    rig = as_recorded(rig_named(rig_name), [excitation])
    rig = as_sampled(rig, [excitation.sampling_period_s])
    chosen = attach_specs(rig, specs)
    known = {**excitation.known, **known}
    closed = in_its_loop(rig, excitation)
    settings = {**rig.controller, **excitation.controller} if closed else {}
    sizes = {}
    plain = Assembly(rig)
    if not closed:
        u = data_of(rig, excitation).inputs(plain)
        sizes = port_sizes(plain, [(u, plain.values(known), excitation.sampling_period_s)])
    assembly = Assembly(
        rig, tuple(a for a, _ in chosen), controller=tuple(sorted(settings.items())), sizes=sizes
    )
    p = assembly.values({**known, **hidden})
    labels = []
    for a, values in chosen:
        bounds = {b.name: b for b in assembly.parameters if b.owner == a.label}
        for name, value in values.items():
            if name not in bounds:
                raise FileError(
                    f"effect {a.label!r} has no parameter {name!r}",
                    nearest(name, list(bounds))
                    or f"Name a parameter that it has: {', '.join(bounds)}.",
                )
            p[assembly.index_of(f"{a.label}:{name}")] = value * bounds[name].factor
        given = ",".join(
            f"{b.name}={p[assembly.keys[b.key]] / b.factor:.6g}" for b in bounds.values()
        )
        labels.append(f"{a.label}:{given}")
    tell("running")
    columns = virtual_recording(assembly, excitation, p, noise=noise, seed=seed)
    meta = stated_tables(name_of(rig_name), excitation, known, settings if closed else None)
    remarks = tuple(fault.text for fault in plain.known_objections(known))
    remarks += form_remarks(rig, excitation, columns)
    return VirtualRecording(columns, meta, labels, remarks)
