"""Content and faults of a file, before anything is fitted: recordings, rig files, effect files."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pamid.base.errors import DataError, FileError, PamidError, nearest
from pamid.base.files import read_lines
from pamid.base.metrics import motion
from pamid.base.progress import tell
from pamid.base.schemas import check_file as result
from pamid.base.schemas.rig_map import RigMap
from pamid.base.trust import MODEL_ENDINGS
from pamid.base.units import NONE, divided_name, is_unit, split_column
from pamid.engine.simulator_warnings import counted_warnings
from pamid.intake.checks.conformance import background_findings, effect_findings, rig_findings
from pamid.intake.checks.findings import (
    CheckOutcome,
    QualityIssue,
    fault,
    named,
    note,
    outcome,
    passed,
)
from pamid.intake.checks.recording_quality import before_a_fit, examine, signals_of
from pamid.intake.checks.sampling_slips import compare_holds, misplaced_readings
from pamid.intake.logs.matcher import with_stand_ins
from pamid.model import registry as library
from pamid.model.assembly import Assembly
from pamid.model.between_samples import as_recorded
from pamid.model.effect import Effect
from pamid.model.known_bounds import CURE
from pamid.model.port_flow import rig_map
from pamid.model.port_guide import TOLERANCES, driving_words, ports_of, tolerance_words
from pamid.model.rig import Rig, check_rig
from pamid.model.step_rig import StepRig
from pamid.recording.file_checks import (
    check_header,
    check_stamps,
    explain_cells,
    read_header,
    require_file,
    sidecar_of,
)
from pamid.recording.recording import (
    MIN_SAMPLES,
    Recording,
    match_column,
    read_recording,
)
from pamid.simulation.data_split import require_informative
from pamid.simulation.idle_background import without_idle_terms
from pamid.simulation.rig_data import data_of
from pamid.simulation.tracks import noise_remarks

STILL_SHARE = 0.02  # of a column's range: a smaller motion is rest


@dataclass(frozen=True)
class Inspection:
    """Result of an inspection.

    summary: printed result, also for scripts; recording, issues: of a recording that could be read.
    """

    summary: dict[str, Any]
    recording: Recording | None = None
    issues: tuple[QualityIssue, ...] = ()


def inspect(
    source: Path | Recording | type[Rig] | type[Effect], rig: str | Rig | None = None
) -> Inspection:
    """Check a recording (.csv), a Python file with rigs and effects (.py), a rig or an effect.

    The result has the keys "schema", "kind", "ok" and "findings", and further ones by kind. Faults
    inside the file are listed, not raised. rig: rig of a recording; by default that which its
    TOML names. Raises FileError: the file is absent or of another kind.
    """
    recording: Recording | None = None
    issues: tuple[QualityIssue, ...] = ()
    if isinstance(source, Recording):
        path, recording = source.path, source
        about, findings, issues = _recording(source, rig)
    elif isinstance(source, type):
        path = Path(source.__qualname__)
        about, findings = _classes(path, [source])
    else:
        path = source
        require_file(path, "recording, rig or effect file")
        if path.suffix == ".csv":
            try:
                recording = read_recording(path)
            except (FileError, DataError) as error:
                about, findings = {"kind": "recording"}, _every_problem(path, error)
            else:
                about, findings, issues = _recording(recording, rig)
        elif path.suffix == ".py":
            try:
                module = library.load_file(path)
            except PamidError as error:
                about, findings = {"kind": "python"}, [fault("file", str(error))]
            else:
                classes = [v for v in vars(module).values() if isinstance(v, type)]
                written = [c for c in classes if c.__module__ == module.__name__]
                about, findings = _classes(path, written)
        elif path.suffix in MODEL_ENDINGS:
            try:
                model = library.rig_named(str(path))
            except PamidError as error:
                about, findings = {"kind": "rig"}, [fault("model", str(error))]
            else:
                findings, ports = _built(model, library.effects(), slopes=False)
                about = {"kind": "rig", "rigs": [model.name], "effects": []}
                about |= {"ports": ports} if ports else {}
        else:
            raise FileError(
                f"{path}: pamid checks recordings (.csv), rig or effect files (.py) and models "
                f"({', '.join(MODEL_ENDINGS)}).",
                "`pamid ingest` reads other kinds of log.",
                code="suffix",
            )
    wrong = [f for f in findings if f.wrong]
    summary: dict[str, Any] = {"file": str(path), **about, "ok": not wrong}
    if wrong:
        summary |= {"code": "file", "message": f"{path}: {wrong[0].detail}"}
        summary["hint"] = "Every problem is in `findings`."
    file = result.CheckFile(**summary, findings=tuple(findings))
    return Inspection(file.as_json(), recording, issues)


def require_sound(recording: Recording, rig: Rig) -> tuple[str, ...]:
    """Refuse a recording on which any fit of this rig is nonsense.

    The message names every fault of its values that `inspect` calls wrong. A sensor without a
    signal raises DataError, any other fault FileError. The result are sentences on advice: an
    offset or a scale that a fit would attribute to the machine.
    """
    issues = before_a_fit(recording, rig)
    wrong = [issue for issue in issues if issue.severity == "wrong"]
    if not wrong:
        return tuple(f"{issue.message.partition(': ')[0]}." for issue in issues)
    first = wrong[0]
    more = "".join(f"; {i.kind}: {i.message}" for i in wrong[1:])
    hint = f"{first.hint} `pamid check` has the details; --no-check fits it as it is.".lstrip()
    if all(i.kind == "dead" for i in wrong):
        raise DataError(f"{recording.path}: {first.message}{more}.", hint, code="not-excited")
    raise FileError(f"{recording.path}: {first.kind}: {first.message}{more}.", hint, code="check")


# ---- recordings --------------------------------------------------------------------------------


def _recording(
    recording: Recording, rig_name: str | Rig | None
) -> tuple[dict[str, Any], list[CheckOutcome], tuple[QualityIssue, ...]]:
    findings = [passed("file", "uniform stamps, finite numbers, no row missing")]
    findings += [note("warning", w) for w in recording.warnings]
    findings += [
        note(
            "unit",
            f"column {n!r} is read in {split_column(n)[1]!r}: in a name _ multiplies and _per_ "
            f"divides. If a rate is meant, name it {divided_name(n)!r}",
        )
        for n in recording.columns
        if divided_name(n)
    ]
    tell("columns")
    name = rig_name or recording.rig
    rig, against = None, list[CheckOutcome]()
    if name:
        recording, rig, against = _against_rig(recording, rig_name)
    tell("quality")
    signals = signals_of(recording, rig)
    with counted_warnings() as warned:
        issues = examine(recording, rig, signals)
        tell("held or linear")
        sound = None if any(i.severity == "wrong" for i in issues) else rig
        between = compare_holds(recording, sound) if sound else []
    findings += [note("simulator", text) for text in warned.sentences("in the runs of this check")]
    findings += [outcome("between", not h.wrong, h.text(recording), h.wrong) for h in between]
    if sound is not None:
        orders = misplaced_readings(recording, sound)
        findings += [note("rows", order.text(recording)) for order in orders]
    if rig is not None:
        # outputs whose noise in fits contradicts the rig or the samples
        data = data_of(rig, recording)
        moving = [c for c in rig.outputs if c in data.values and motion(data.values[c]) > 0.0]
        findings += [note(r.kind, r.text) for r in noise_remarks(rig, [data], moving)]
    findings += against
    findings += [outcome(i.kind, False, i.text, i.severity == "advice") for i in issues]
    fine = "nothing clipped, frozen, lost, exchanged, late or in another unit"
    findings += [] if issues else [passed("quality", fine)]
    period = recording.sampling_period_s
    about = {
        "kind": "recording",
        "samples": len(recording),
        "duration_s": len(recording) * period,
        "sampling_period_s": period,
        "loop": recording.loop,
        "rig": library.name_of(name) if name else None,
        "known": recording.known,
        "controller": recording.controller,
        "columns": {name: _column(recording, name) for name in recording.columns},
        "quality": {
            "channels": {
                s.name: {"span": s.span, "step": s.step, "noise": s.noise} for s in signals
            },
            "issues": issues,
        },
        **({"between": between} if between else {}),
    }
    return about, findings, issues


def _column(recording: Recording, name: str) -> dict[str, Any]:
    """Range, level and length of the rest at the start, and the share of time at standstill."""
    values = recording.columns[name]
    # scaled to it, since numbers need not be small
    size = float(np.abs(values).max()) or 1.0
    scaled = values / size
    low, high = float(scaled.min()), float(scaled.max())
    moved = np.abs(scaled - scaled[0]) > STILL_SHARE * (high - low)
    first = int(np.argmax(moved)) if moved.any() else len(values)
    return {
        "unit": split_column(name)[1],
        "low": float(values.min()),
        "high": float(values.max()),
        "mean": size * float(scaled.mean()),
        "rest_value": size * float(np.median(scaled[: max(first, 1)])),
        "rest_s": first * recording.sampling_period_s,
        "distinct_values": int(np.unique(values).size),
        "constant": high == low,
    }


def _against_rig(
    recording: Recording, rig_name: str | Rig | None
) -> tuple[Recording, Rig | None, list[CheckOutcome]]:
    """Recording with the rig's columns, rig, and findings on columns that are not part of it.

    A rig file only runs if the user names it. A rig file that a recording's TOML names is reported,
    not run.
    """
    try:
        if rig_name:
            rig = library.rig_named(rig_name)
        else:
            rig = library.catalogue_rig(library.rig_of([recording]))
        recording, stand_ins = with_stand_ins(recording, rig)
        rig = as_recorded(rig, [recording])
        wanted = {c: match_column(recording.columns, c) for c in (*rig.inputs, *rig.outputs)}
    except PamidError as error:
        return recording, None, [fault("rig", str(error))]
    findings = [note("column", text) for text in stand_ins]
    findings += background_findings(rig)
    for c in rig.inputs:
        if wanted[c] is None and c not in rig.optional:
            text = f"the input {c!r} of rig {rig.name!r} is missing. "
            findings.append(fault("input", f"{text}{nearest(c, recording.columns)}".rstrip()))
    lacking = [c for c in rig.outputs if wanted[c] is None]
    if len(lacking) == len(rig.outputs):
        text = f"none of the outputs of rig {rig.name!r} is there: {', '.join(rig.outputs)}"
        findings.append(fault("output", text))
    else:
        text = "is not recorded: effects that only it shows stay unknown"
        findings += [note("output", f"{c} {text}") for c in lacking]
    used = {*wanted.values(), *(loop.reference for loop in rig.loops)}
    for c in recording.columns:
        if c not in used:
            text = f"rig {rig.name!r} does not know the column {c!r}; it is kept and not used. "
            findings.append(note("column", f"{text}{nearest(c, wanted)}".rstrip()))
    if rig.form_note:
        stepped = isinstance(rig, StepRig)
        findings.append(outcome("form", not stepped, rig.form_note, advice=stepped))
    # known values without a parameter in the rig, or outside their bounds
    plain = Assembly(rig)
    known = {key: value for key, value in recording.known.items() if plain.knows(key)}
    for key in recording.known:
        if key not in known:
            near = nearest(key, [p.outside_name for p in rig.parameters])
            text = f"[known] {key!r} is not a parameter of rig {rig.name!r}. {near}"
            findings.append(fault("known", text.rstrip()))
    for objection in plain.known_objections(known):
        text = f"{objection.text}. {CURE}"
        findings.append(outcome("known", False, text, advice=not objection.impossible))
    if not any(f.wrong for f in findings):
        data = data_of(rig, recording)
        findings += [note("sign", words) for words in driving_words(rig)]
        findings += [note("background", t.text) for t in without_idle_terms(rig, [data])[1]]
        try:
            require_informative(rig, data)
        except DataError as error:
            findings.append(fault("excitation", f"nothing can be fitted: {error}"))
    every = passed("rig", f"every column of rig {rig.name!r} is there")
    return recording, rig, findings or [every]


def _every_problem(path: Path, first: PamidError) -> list[CheckOutcome]:
    """Problem that stopped the reader, and problems of the remaining stages that can still run."""
    outcomes: dict[str, CheckOutcome] = {first.message: fault(first.code, str(first))}

    def attempt(stage: Callable[[], Any]) -> Any:
        try:
            return stage()
        except PamidError as error:
            outcomes.setdefault(error.message, fault(error.code, str(error)))
            return None

    names = attempt(lambda: read_header(path))
    if names is None or len(names) == 1:  # another dialect: its cells would be misread, too
        return list(outcomes.values())
    attempt(lambda: check_header(path, names))
    attempt(lambda: explain_cells(path, names))
    # readable stamps, for every row
    stamps = []
    for row in itertools.islice(read_lines(path, errors="replace"), 1, None):
        try:
            stamps.append(float(row.split(",", 1)[0]))
        except ValueError:
            continue
    time = np.array(stamps)
    time = time[np.isfinite(time)]
    if time.size > 1:
        attempt(lambda: check_stamps(path, time))
        if first.code != "sampling-period":
            attempt(lambda: sidecar_of(path, names, time))
    if time.size < MIN_SAMPLES and first.code != "empty":
        outcomes.setdefault(
            "short", fault("too-short", f"{time.size} samples, at least {MIN_SAMPLES} are needed")
        )
    for n in names[1:]:
        plain = "_" in n and split_column(n)[1] == NONE and not is_unit(n)
        if plain and not n.rsplit("_", 1)[1].isdigit():
            outcomes[n] = note("unit", f"column {n!r} does not end in a known unit")
    return list(outcomes.values())


# ---- rig and effect files ----------------------------------------------------------------------


def _classes(path: Path, classes: list[type]) -> tuple[dict[str, Any], list[CheckOutcome]]:
    rigs = [v for v in classes if issubclass(v, Rig)]
    effects = [v for v in classes if issubclass(v, Effect)]
    kind = "rig" if rigs else "effect" if effects else "python"
    about = {"kind": kind, "rigs": [r.name for r in rigs], "effects": [e.name for e in effects]}
    if kind == "python":
        text = (
            "it holds neither a rig nor an effect (a class derived from pamid.Rig or pamid.Effect)"
        )
        return about, [fault("file", text)]
    findings: list[CheckOutcome] = []
    if len(rigs) > 1:
        findings.append(fault("file", f"it holds {len(rigs)} rigs; keep a single rig in each file"))
    catalogue = library.effects()
    for effect in effects:
        others = [r() for r in library.rigs().values()]
        findings += named(effect.name, effect_findings(effect, others))
        if effect.name in catalogue:
            text = (
                f"{effect.name!r} is the name of an effect of the catalogue, which it would replace"
            )
            findings.append(note("name", text))
    ports: list[dict[str, Any]] = []
    for rig in rigs:
        rig_findings_, rows = _rig(path, rig, {**catalogue, **{e.name: e for e in effects}})
        findings, ports = findings + rig_findings_, ports + rows
    return {**about, **({"ports": ports} if ports else {})}, findings


def _rig(
    path: Path, kind: type[Rig], effects: dict[str, type[Effect]]
) -> tuple[list[CheckOutcome], list[dict[str, Any]]]:
    """Findings on a rig, and its ports if its equations can be built."""
    try:
        rig = kind()
        check_rig(rig, str(path))
    except PamidError as error:
        return [fault("declarations", str(error))], []
    except Exception as error:  # a rig's __init__ may raise anything
        text = f"{kind.__name__}() failed: {type(error).__name__}: {error}"
        return [fault("declarations", text)], []
    findings, ports = _built(rig, effects)
    if ports and not isinstance(rig, StepRig):
        words = tolerance_words(rig)
        findings += named(rig.name, [note(TOLERANCES, w) for w in words])
    return findings, ports


def _built(
    rig: Rig, effects: dict[str, type[Effect]], *, slopes: bool = True
) -> tuple[list[CheckOutcome], list[dict[str, Any]]]:
    findings = [note("remark", text) for text in rig.remarks]
    findings += rig_findings(rig, effects.values(), slopes=slopes)
    built = not any(f.wrong and f.check == "equations" for f in findings)
    return named(rig.name, findings), ports_of(rig, effects.values()) if built else []


def checked_ports(source: Path | type[Rig]) -> RigMap | None:
    """Ports of a rig, or of a rig file or model, which is run; None if it does not build."""
    try:
        rig = library.rig_named(str(source)) if isinstance(source, Path) else source()
        return rig_map(rig, rig.outputs)
    except PamidError:
        return None
