"""The model that a run found, rebuilt from its folder: rig, effects and their values, with a
network where it was trained. What leaves the laboratory starts from it, and `simulate_identified`
lists the inputs that it needs.

A run folder is data: nothing in it is executed. A rig or effect file is code: it is run only where
the caller names it again, and only if it still is what the run was made with.

The whole model is a single set of equations. A network at the output is added to its channel behind
them. A network at a port receives the outputs of the uncorrected model, which runs in parallel
under names that begin with "uncorrected."; its value is held over a sample.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import DataError, FileError, UsageError, nearest
from pamid.base.files import sha256_of
from pamid.base.json_file import read_json
from pamid.base.result_file import need_result
from pamid.base.run_folder import FIT_FILE, NETWORK_FILE, Run
from pamid.base.schemas.fit_file import FitFile
from pamid.base.units import from_si, split_column, to_si
from pamid.engine.program import Stepping
from pamid.engine.sampled_inputs import SampledInputs
from pamid.engine.symbolic.expression import symbol
from pamid.engine.symbolic.memory_cells import Cell, StateEquations, expand_memory
from pamid.engine.symbolic.vocabulary import Expr
from pamid.estimation.closed_loop import loop_motion, loop_names
from pamid.model.assembly import Assembly
from pamid.model.attachment import Attachment
from pamid.model.effect import Effect
from pamid.model.executable import Executable, program_of
from pamid.model.registry import name_of, noted_effects, noted_rig
from pamid.model.rig import Rig
from pamid.model.trace import Traced, prefixed_model, signals_of, with_input_replaced
from pamid.networks.correction.port_network import ADDED, Entry, entered, entry_of
from pamid.networks.correction.residual_data import (
    CAUSES,
    MODEL_COLUMNS,
    REFIT,
    REFIT_REMEDY,
    derived,
)
from pamid.networks.correction.stored_model import refuse, stored_model
from pamid.networks.trained_network import TrainedNetwork, load_network
from pamid.recording.recording import Recording
from pamid.simulation.free_runs import noisy_inputs, sensor_noise
from pamid.simulation.rig_data import data_of
from pamid.simulation.virtual_rig import VirtualRecording, form_remarks, in_its_loop, stated_tables

WHICH = ("best", "cause", "network", "refitted")
UNCORRECTED = "uncorrected."
GIVEN_PREFIX, MEMORY, VALUE = "network.given_", "network.memory", "network"
NETWORK_LEFT_OUT = (
    "the model with the causes is used without the network, which was trained on the residual of "
    "the refitted model; choose --which network for the refitted model with the network, or train "
    "a network for the model with the causes by train-residual --on causes"
)
_PERIODS_AGREE = 0.01  # share by which a recording's period may differ from the model's


@dataclass(frozen=True, eq=False)
class ModelNetwork:
    """A trained network and its place: behind `channel`, or at a port's entry. sources: what each
    of its inputs is, an input or output of the model by name.

    in_loop: it corrects a model in a control loop, whose motion it is given with derivatives
    that look ahead; then it has no sources, and only a finished run can be corrected.
    """

    trained: TrainedNetwork
    channel: str = ""
    entry: Entry | None = None
    sources: tuple[str, ...] = ()
    in_loop: bool = False

    def value(self, known: Mapping[str, Expr]) -> tuple[Expr, tuple[Cell, ...]]:
        """Its value in its unit, from inputs and outputs of a model by name (SI), held over a
        sample; its cells.

        Scaled inputs lead with GIVEN_PREFIX, what it remembers with MEMORY; the scaled output
        is VALUE.
        """
        t, given = self.trained, []
        ranges = zip(self.sources, t.input_scaling.low, t.input_scaling.high, strict=True)
        for i, (name, low, high) in enumerate(ranges):
            scaled = (from_si(known[name], split_column(name)[1]) - low) * (
                2.0 / (high - low)
            ) - 1.0
            given.append(Cell(f"{GIVEN_PREFIX}{i}", scaled, scaled, sampled=True))
        output, cells = t.network.equations(t.weights, [c.here for c in given], MEMORY)
        held = Cell(VALUE, output, output, sampled=True)
        (low,), (high,) = t.output_scaling.low, t.output_scaling.high
        return low + 0.5 * (held.here + 1.0) * (high - low), (*given, *cells, held)


@dataclass(frozen=True, eq=False)
class Identified:
    """A rig with its effects and the values that a run found for them; perhaps with a network
    for what is left.

    assembly     what the values belong to, the input for a network at a port included
    values       of every parameter, SI, in the assembly's order
    uncorrected  values of the uncorrected model, where a network at a port needs it
    period_s     the sample over which inputs are held and the integration is stepped
    controller   [controller] of the first recording made in a closed loop, {} where none was
    source       the rig as the run names it: with its variant, or the path of its file
    sha256       of the run's fit.json
    folder       of the run
    notes        on what the run holds and the model lacks
    rivals       effects that the run's recordings cannot tell apart, that of the model among
                 them, with their probabilities
    chosen       the rival that was chosen, "" for none
    """

    name: str
    assembly: Assembly
    values: Array
    period_s: float
    stepping: Stepping
    network: ModelNetwork | None = None
    uncorrected: tuple[Assembly, Array] | None = None
    controller: Mapping[str, float] = field(default_factory=dict)
    source: str = ""
    sha256: str = ""
    folder: Path | None = None
    notes: tuple[str, ...] = ()
    rivals: Mapping[str, float] = field(default_factory=dict)
    chosen: str = ""

    @property
    def effects(self) -> tuple[Attachment, ...]:
        """Effects attached to the rig, without the entry of a network."""
        return (self.uncorrected[0] if self.uncorrected else self.assembly).attachments

    @cached_property
    def equations(self) -> Traced:
        """Rates, outputs and cells (SI), those of network and uncorrected model included."""
        traced = self.assembly.traced
        if self.network is None or self.network.in_loop:
            return traced
        if self.network.entry is None:
            value, cells = self.network.value(signals_of(traced))
            unit = split_column(self.network.channel)[1]
            behind = to_si(from_si(traced.outputs[self.network.channel], unit) + value, unit)
            return replace(
                traced,
                outputs={**traced.outputs, self.network.channel: behind},
                cells=(*traced.cells, *cells),
            )
        assert self.uncorrected is not None
        before = prefixed_model(self.uncorrected[0].traced, traced, UNCORRECTED)
        value, cells = self.network.value(signals_of(before))
        value = to_si(value, split_column(self.network.trained.output_name)[1])
        return with_input_replaced(traced, before, ADDED, value, cells)

    @cached_property
    def lowered(self) -> StateEquations:
        """The same without memory operators."""
        e = self.equations
        return expand_memory(e.rates, e.outputs, e.cells, e.linear)

    @property
    def inputs(self) -> tuple[str, ...]:
        return self.equations.inputs

    @property
    def outputs(self) -> tuple[str, ...]:
        return tuple(self.equations.outputs)

    @property
    def start(self) -> Array:
        """Initial state (SI), in the order of `lowered.states`."""
        begin = self.assembly.begin(self.values)
        if self.uncorrected is not None:
            begin |= {
                f"{UNCORRECTED}{name}": value
                for name, value in self.uncorrected[0].begin(self.uncorrected[1]).items()
            }
        return np.array([begin.get(name, 0.0) for name in self.lowered.states])

    @cached_property
    def constants(self) -> dict[str, float]:
        """Every parameter of `lowered` by name, SI."""
        values = dict(zip(self.assembly.keys, self.values.tolist(), strict=True))
        if self.uncorrected is not None:
            uncorrected = zip(self.uncorrected[0].keys, self.uncorrected[1].tolist(), strict=True)
            values |= {f"{UNCORRECTED}{key}": value for key, value in uncorrected}
        return values

    def program_with(self, extra: Mapping[str, Expr]) -> Executable:
        """Compiled, with further outputs behind the model's."""
        e = self.equations
        outputs = {**e.outputs, **extra}
        return program_of(self.assembly.rig, e, outputs, tuple(self.constants), frozenset())

    def knowing(self, known: Mapping[str, float]) -> Identified:
        """The same model with other known values of these parameters (outside names and units)."""
        uncorrected = self.uncorrected
        if uncorrected is not None:
            assembly, values = uncorrected
            uncorrected = assembly, assembly.with_known(values, known)
        return replace(
            self, values=self.assembly.with_known(self.values, known), uncorrected=uncorrected
        )


def simulate_identified(
    model: Identified, u: Array, extra: Mapping[str, Expr] | None = None
) -> Array:
    """Outputs, then what is extra (samples x both, SI), for inputs u (samples x inputs, SI) held
    over each sample, from the model's start. DataError where it becomes unstable; UsageError where
    its network needs the loop."""
    if model.network is not None and model.network.in_loop and not model.assembly.controller:
        raise UsageError(
            "This network corrects the model in its control loop, not on given commands.",
            "Leave it out with --which refitted, give references instead of commands, or train a "
            "network at a port with train-residual --port PORT.",
        )
    program = model.program_with(extra or {})
    memory = program.memory(model.start, stepping=model.stepping, period_s=model.period_s)
    p = np.array(list(model.constants.values()))
    Y, _, bad = program.run(memory, SampledInputs(u, model.period_s), p, stepping=model.stepping)
    if bad >= 0:
        raise DataError(
            f"The model of {model.name!r} became unstable at {bad * model.period_s:.3f} s.",
            "Lower the amplitude.",
        )
    return Y


def require_period(recording: Recording, model: Identified, remedy: str, code: str = "") -> None:
    """DataError unless a recording is sampled with the model's period."""
    period = recording.sampling_period_s
    if abs(period - model.period_s) > _PERIODS_AGREE * model.period_s:
        raise DataError(
            f"{recording.path} is sampled every {period:g} s, the model's sample is "
            f"{model.period_s:g} s.",
            remedy,
            code=code,
        )


def record_identified(
    model: Identified,
    excitation: Recording,
    known: Mapping[str, float] | None = None,
    *,
    noise: float = 1.0,
    seed: int = 0,
) -> VirtualRecording:
    """Simulate the model's sensors on an excitation, with its known parameters or those that the
    excitation states.

    References run it in its control loop: the excitation's controller, else that of the run's
    recordings, else the rig's. Columns in their units.
    """
    rig, n = model.assembly.rig, len(excitation)
    require_period(excitation, model, "Make the excitation with the model's period.")
    known = {**excitation.known, **(known or {})}
    model, closed = model.knowing(known), in_its_loop(rig, excitation)
    settings = {**rig.controller, **model.controller, **excitation.controller} if closed else {}
    if closed:  # references in the place of commands
        controller = tuple(sorted(settings.items()))
        model = replace(model, assembly=replace(model.assembly, controller=controller))
    jitter = sensor_noise(model.assembly, n, noise, seed)
    u = noisy_inputs(
        data_of(rig, excitation).inputs(model.assembly, model.inputs), model.inputs, jitter
    )
    commands = [q.command for q in rig.loops] if closed else []
    Y = simulate_identified(model, u, {c: symbol("cell", c) for c in commands})
    clean = {
        name: from_si(Y[:, i], split_column(name)[1])
        for i, name in enumerate((*model.outputs, *commands))
    }
    if model.network is not None and model.network.in_loop:
        signals, data = dict(clean), data_of(rig, excitation)
        signals |= {name: data.shown(name) for name in rig.inputs if name in data.values}
        for q in rig.loops:
            motion = loop_motion(clean[q.reading], clean[q.command], model.period_s)
            signals |= dict(zip(loop_names(q, len(rig.loops) > 1), motion, strict=True))
            signals[q.reference] = data.shown(q.reference)
        channel = model.network.channel
        clean[channel] = clean[channel] + model.network.trained.predict(signals)
    columns = {
        **excitation.columns,
        **{name: values + jitter.get(name, 0.0) for name, values in clean.items()},
    }
    meta = stated_tables(model.source, excitation, known, settings if closed else None)
    remarks = (*model.notes, *form_remarks(rig, excitation, columns))
    return VirtualRecording(columns, meta, [a.label for a in model.effects], remarks)


# ---- reading a run -----------------------------------------------------------------------------


def load_identified(
    run_folder: Path,
    *,
    which: str = "best",
    rig: str | Rig | None = None,
    effects: tuple[str | type[Effect], ...] = (),
    choose: str = "",
) -> Identified:
    """The model of a run; FileError where the folder is damaged or its rig or effect files are not
    named here, UsageError for an effect to choose that is none of the run's rivals.

    which          "cause" (of a diagnosis), "network" (the model that the run's network was trained
                   on, with it: refitted, or with the causes), "refitted", or
                   "best": with causes and network where the network was trained on the model with
                   the causes, else the first of these that the run has
    rig, effects   paths of the rig file and the effect files that the run was made with, which are
    run; or the rig and the effects themselves
    choose         of the effects that the run could not separate, the label of the effect to take;
    default: the most probable
    """
    if which not in WHICH:
        raise UsageError(f"--which {which!r}: choose from {', '.join(WHICH)}.")
    record, path = Run.open(run_folder).record, run_folder / FIT_FILE
    fit = need_result(path, FitFile, also=("model", "cause", "rivals", "controller"))
    if fit.model is None:
        raise FileError(
            f"{path} does not hold its model.", f"An older version wrote it. {REFIT_REMEDY}"
        )
    trained_on = _trained_on(run_folder) if (run_folder / NETWORK_FILE).exists() else ""
    has = {"cause": fit.cause is not None, "network": bool(trained_on), "refitted": True}
    best = ("network",) * (trained_on == CAUSES) + tuple(name for name in has if has[name])
    chosen = best[0] if which == "best" else which
    if not has[chosen]:
        raise FileError(
            f"{run_folder} has no {chosen}.",
            f"It has {', '.join(filter(has.get, has))}.",
            code="missing",
        )
    with _sound(path):
        noted = {str(input_["path"]): str(input_["sha256"]) for input_ in record["inputs"]}
        source = str(record["options"].get("rig") or fit.rig)
        if (rig_object := noted_rig(source, rig, noted)).name != fit.rig:
            raise FileError(
                f"The run is of the rig {fit.rig!r}, not of {rig_object.name!r}.",
                "Give --rig the rig of the run.",
                code="rig",
            )
        catalogue = noted_effects(
            tuple(map(str, record["options"].get("effects", ()))), effects, noted
        )
        on_causes = chosen == "cause" or (chosen == "network" and trained_on == CAUSES)
        saved = fit.cause if on_causes else fit.model
        if saved is None:
            refuse(run_folder / NETWORK_FILE, f"its network corrects a cause that {path} lacks")
        rivals = {k: r.probability for k, r in (fit.rivals or {}).items()}
        rivals = rivals if chosen == "cause" else {}
        known = rivals or saved.effects
        if choose and choose not in known:
            raise UsageError(
                f"--choose {choose!r}: the run does not offer it.",
                nearest(choose, known)
                or (f"It offers {', '.join(known)}." if known else "It names no cause."),
            )
        if rivals and fit.rivals:
            saved = fit.rivals[choose or max(rivals, key=lambda k: rivals[k])].model
        period = (fit.recordings[0].period_s if fit.recordings else None) or 0.0
        if period <= 0.0:
            refuse(path, "the sampling period of its recordings is out of range")
        assembly, p, step = stored_model(rig_object, saved, fit.recordings, catalogue, path)
        model = Identified(
            rig_object.name,
            assembly,
            p,
            period,
            step,
            controller=next((r.controller for r in fit.recordings if r.loop == "closed"), {}),
            source=name_of(rig or source),
            sha256=sha256_of(path),
            folder=run_folder,
            rivals=rivals,
            chosen=saved.effects[0] if rivals else "",
        )
    if chosen != "network":
        left_out = trained_on == REFIT and which == "best"
        return replace(model, notes=(NETWORK_LEFT_OUT,)) if left_out and fit.cause else model
    with _sound(run_folder / NETWORK_FILE):
        return _with_network(model, run_folder, fit.channels)


def channel_network(
    models: Mapping[str, Identified], folder: Path, channels: Sequence[str]
) -> Identified:
    """The model that another network of a run was trained on, with that network, of the folder of
    its channel; FileError as `load_identified`. models: "refitted" and, where it exists,
    "with_cause"; channels: that the run was fitted to."""
    with _sound(folder / NETWORK_FILE):
        base = models["with_cause" if _trained_on(folder) == CAUSES else "refitted"]
        return _with_network(base, folder, channels)


def _trained_on(folder: Path) -> str:
    """The model whose residual the network of a folder was trained on: REFIT or CAUSES; FileError
    where it states another."""
    path = folder / NETWORK_FILE
    with _sound(path):
        on = str(read_json(path).get("on", REFIT))
    if on not in MODEL_COLUMNS:
        refuse(path, f"it was trained on {on!r:.60}, which is none of {', '.join(MODEL_COLUMNS)}")
    return on


def _with_network(model: Identified, folder: Path, channels: Sequence[str]) -> Identified:
    """The model that the network of the folder was trained on with that network in its place."""
    about, trained = read_json(folder / NETWORK_FILE), load_network(folder)
    enters, offered = about["enters"], {name: name for name in model.assembly.rig.inputs}
    offered |= {derived(c, MODEL_COLUMNS[_trained_on(folder)]): c for c in channels}
    if (
        about["model"] == "loop" or enters == "output"
    ) and trained.output_name not in model.assembly.rig.outputs:
        refuse(
            folder / NETWORK_FILE, f"its output {trained.output_name!r} is no output of the model"
        )
    if about["model"] == "loop":
        return replace(model, network=ModelNetwork(trained, trained.output_name, in_loop=True))
    for name in trained.input_names:
        if name not in offered:
            raise FileError(
                f"{folder / NETWORK_FILE}: its input {name!r} is neither an input of the rig nor "
                "an output of the model that it corrects, so that it cannot run with it.",
                f"Train it with --inputs out of {', '.join(offered)}.",
            )
    sources = tuple(offered[name] for name in trained.input_names)
    if enters == "output":
        return replace(model, network=ModelNetwork(trained, trained.output_name, sources=sources))
    try:
        entry = entry_of(model.assembly.rig, str(enters["port"]))
    except UsageError as error:
        refuse(folder / NETWORK_FILE, error.message)
    corrected = entered(model.assembly, entry)
    p = corrected.values({str(k): float(v) for k, v in about["parameters"].items()})
    free = [corrected.index_of(str(name)) for name in about["parameters"]]
    for key, i in corrected.keys.items():
        if i not in free:
            p[i] = model.values[model.assembly.keys[key]]
    if not np.isfinite(p).all():
        refuse(folder / NETWORK_FILE, "a parameter is not finite")
    return replace(
        model,
        assembly=corrected,
        values=p,
        network=ModelNetwork(trained, "", entry, sources),
        uncorrected=(model.assembly, model.values),
    )


@contextmanager
def _sound(path: Path) -> Iterator[None]:
    """FileError where what is read from a file lacks entries, or they are of another kind."""
    try:
        yield
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        refuse(
            path,
            f"it lacks entries, or they are not what they should be ({type(error).__name__}: "
            f"{error})",
        )
