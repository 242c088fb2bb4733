"""`pamid.score`: the models of a run on recordings that it has not seen: the data sheet, the
refitted model, with the causes, with the network.

Replayed by the rules of a fit, in windows on the recorded command, each from a state estimated on
its beginning; and where a controller ran, once more under that controller, from the beginning to
the end. A network that was trained on either comparison is judged by that alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from pathlib import Path

import numpy as np

from pamid.api.given import (
    effects_given,
    recording_given,
    recordings_given,
    unknown_columns,
    warn_in_python,
)
from pamid.api.options.record import verb
from pamid.api.options.simulating import ScoreArguments
from pamid.api.workers import OpenedRun
from pamid.base.arrays import Array
from pamid.base.errors import DataError, PamidError, UsageError
from pamid.base.files import sha256_of
from pamid.base.network_folders import channel_networks
from pamid.base.progress import tell
from pamid.base.result_file import need_result
from pamid.base.run_folder import FIT_FILE, NETWORK_FILE
from pamid.base.schemas.fit_file import FitFile
from pamid.base.schemas.score_file import RecordingError, ScoreFile
from pamid.base.units import from_si, split_column, to_si
from pamid.model.assembly import Assembly
from pamid.model.effect import Effect
from pamid.model.registry import catalogue_rig, in_catalogue, resolved_rig
from pamid.model.rig import Rig
from pamid.networks.correction.identified_model import (
    Identified,
    channel_network,
    load_identified,
    record_identified,
    require_period,
)
from pamid.networks.correction.port_network import ADDED
from pamid.recording.overlap import require_apart
from pamid.recording.recording import Recording, read_recording
from pamid.report.recording_errors import recording_errors_text
from pamid.simulation.data_split import DataSplit, split_recordings
from pamid.simulation.replay import Replay, replay_track
from pamid.simulation.rig_data import Data, data_of
from pamid.simulation.scored_recording import IN_LOOP, REPLAYED, recording_error
from pamid.simulation.tracks import track_of


class ScoreResult(ScoreFile):
    """Errors of a run's models on recordings that were not used before.

    rig: its name; models: "data_sheet", "refitted", "with_cause", "with_network", those that the
    run has; recordings: a row per recording, comparison ("replay", "loop") and channel, with `mae`
    and `rms` by model in the channel's unit, and what the recording states as `known`.
    """

    to_dict = ScoreFile.as_json

    def summary(self) -> str:
        """The table, as lines of text."""
        return "\n".join([recording_errors_text(self.recordings), *self.notes])

    def __repr__(self) -> str:
        return f"<ScoreResult of {self.rig}>\n{self.summary()}"


@dataclass(frozen=True, eq=False)
class _Models:
    """The models of a run, those that it has, by name; channels: that it was fitted to;
    channel_networks: the model that a channel's network was trained on with it, where the run has
    several."""

    refitted: Identified
    named: dict[str, Identified]
    channels: tuple[str, ...]
    channel_networks: dict[str, Identified]

    def of(self, channel: str) -> dict[str, Identified]:
        """By name, with the channel's network where it has any."""
        network = self.channel_networks.get(channel)
        return self.named if network is None else {**self.named, "with_network": network}

    @property
    def every(self) -> list[tuple[str, Identified]]:
        """Each model once, with its name; networks of other channels with their channel."""
        others = [(f"with network of {channel}", m) for channel, m in self.channel_networks.items()]
        return [*self.named.items(), *others]


@verb(ScoreArguments)
def score(arguments: ScoreArguments) -> ScoreResult:
    """Score the models of a run on new recordings: data sheet, refitted, with causes, with network.

    Errors are mean absolute and root mean square, per recording and channel; in replay of the
    recorded command, and under the controller where it ran.

    Raises
    ------
    PamidError
        A recording was used in the run, or does not fit its rig.
    """
    given = recordings_given(arguments.recordings)
    if not given:
        raise UsageError("There is no recording to score the run on.", "Give a recording.")
    run = OpenedRun.of(arguments.run)
    folder = run.folder
    rig = resolved_rig(arguments.rig) or run.code[0]
    effects = effects_given(arguments.effects) or run.code[1]
    recordings = [recording_given(item, f"recording-{k + 1}") for k, item in enumerate(given)]
    fit = need_result(folder / FIT_FILE, FitFile, also=("model", "cause"))
    models = _models_of(folder, fit, rig, effects)
    _require_unseen(recordings, folder, fit, models.refitted)
    model_rig = models.refitted.assembly.rig
    most, begun = 2 * len(recordings) * len(models.every), count()

    def say(name: str, recording: Recording) -> None:
        tell(f"runs {next(begun)}/{most}: {name.replace('_', ' ')}, {recording.name}")

    rows = [row for item in recordings for row in _rows(models, item, say)]
    notes, corrected = [], models.named.get("with_network")
    if corrected is not None and corrected.network is not None:
        in_loop = corrected.network.in_loop
        where, other = ("closed loop", "replay") if in_loop else ("replay", "")
        labels, without = ([a.label for a in m.effects] for m in (corrected, models.refitted))
        model = "model with its causes" if labels != without else "refitted model"
        text = f"The network was trained in {where}{f' and is not scored in {other}' * bool(other)}"
        notes.append(f"{text}; it corrects the {model}.")
    form = model_rig.forms
    if form is not None:  # something acts in a recording that the form of the rig leaves out
        notes += filter(None, (form.left_out(model_rig, item) for item in recordings))
    warn = arguments.warn or warn_in_python
    for recording in recordings:
        texts = list(recording.warnings)
        if in_catalogue(models.refitted.name):
            texts += unknown_columns(catalogue_rig(models.refitted.name), recording)
        for text in texts:
            warn(f"{recording.path}: {text}")
    return ScoreResult(
        run=str(folder),
        rig=models.refitted.name,
        models=tuple(models.named),
        recordings=tuple(rows),
        notes=tuple(notes),
    )


def _require_unseen(
    recordings: list[Recording], folder: Path, fit: FitFile, refitted: Identified
) -> None:
    """DataError where a recording belongs to the run, holds its samples, or is sampled otherwise;
    FileError where it lacks a column that the rig needs, or holds no channel of the run."""
    rig = refitted.assembly.rig
    # The run's recordings, where they still lie there as they were: a part of one, or one under
    # another name, is known by its samples.
    used = []
    for of_run in fit.recordings:
        path = Path(of_run.path)
        try:
            if path.is_file() and sha256_of(path) == of_run.sha256:
                used.append(read_recording(path))
        except (PamidError, OSError):  # it has moved or changed: its digest is what is left
            continue
    for recording in recordings:
        same = next((r for r in fit.recordings if r.sha256 and r.sha256 == recording.sha256), None)
        if same is not None:
            raise DataError(
                f"{recording.path} was used in {folder} ({same.role}, as {same.name}): a score "
                "needs new data.",
                f"Give recordings that the run has not used; `pamid report {folder}` shows the "
                "errors on the held-out part.",
                code="overlap",
            )
        require_apart(tuple(rig.outputs), used, [recording])
        remedy = "Record with the model's period, or fit a model with this period."
        require_period(recording, refitted, remedy, code="period")
        data_of(rig, recording).measured(rig)


def _models_of(
    folder: Path, fit: FitFile, rig: str | Rig | None, effects: tuple[str | type[Effect], ...]
) -> _Models:
    load = partial(load_identified, folder, rig=rig, effects=effects)
    refitted = load(which="refitted")
    named = {
        "data_sheet": replace(refitted, values=refitted.assembly.data_sheet()),
        "refitted": refitted,
    }
    if fit.cause is not None:
        named["with_cause"] = load(which="cause")
    others: dict[str, Identified] = {}
    if (folder / NETWORK_FILE).exists():
        named["with_network"] = load(which="network")
        network = named["with_network"].network
        others = {
            channel: channel_network(named, place, fit.channels)
            for channel, place in channel_networks(folder).items()
            if network is not None and channel != network.channel
        }
    return _Models(refitted, named, tuple(fit.channels), others)


# ---- rows --------------------------------------------------------------------------------------


def _rows(
    available: _Models, recording: Recording, say: Callable[[str, Recording], None]
) -> Iterator[RecordingError]:
    """Replay, then closed loop, channel by channel."""
    split = split_recordings(available.refitted.assembly.rig, [recording], [])
    (data,) = split.recordings
    seen = [c for c in available.channels if c in data.values]
    replays = {}
    for name, model in available.every:
        say(name, recording)
        if model.network is None or not model.network.in_loop:
            replays[id(model)] = _Replayed(model, available.channels, split, data).outputs()
    scored = next(iter(replays.values()))[0].scored
    for channel in seen:
        k = available.channels.index(channel)
        models = {
            name: from_si(replays[id(model)][1][scored, k], split_column(channel)[1])
            if replays[id(model)][0].finite
            else None
            for name, model in available.of(channel).items()
            if id(model) in replays
        }
        measured = data.shown(channel)[scored]
        yield recording_error(recording.name, recording.known, REPLAYED, channel, measured, models)
    if data.runs_in_loop(available.refitted.assembly.rig):
        loops: dict[int, dict[str, Array] | None] = {}
        for name, model in available.every:
            say(name, recording)
            # under the recording's controller, columns in their units; None: it becomes unstable
            commands = {q.command for q in model.assembly.rig.loops}
            sent = {n: v for n, v in recording.columns.items() if n not in commands}
            loops[id(model)] = None
            with suppress(DataError):
                simulated = record_identified(model, replace(recording, columns=sent), noise=0.0)
                loops[id(model)] = {n: np.asarray(v) for n, v in simulated.columns.items()}
        for channel in seen:
            runs = {name: loops[id(model)] for name, model in available.of(channel).items()}
            models = {n: None if run is None else run[channel] for n, run in runs.items()}
            yield recording_error(
                recording.name,
                recording.known,
                IN_LOOP,
                channel,
                data.shown(channel),
                models,
            )


@dataclass(frozen=True, eq=False)
class _Replayed:
    """A model over the whole of a recording, window by window; channels: what its windows find
    their start by."""

    model: Identified
    channels: tuple[str, ...]
    split: DataSplit
    recording: Data

    def outputs(self) -> tuple[Replay, Array]:
        """The replay, and its outputs with the network's value (samples x channels, SI)."""
        network = self.model.network
        if network is None:
            done = self._run(self.model.assembly, self.model.values)
            return done, done.model
        if network.entry is None:
            done = self._run(self.model.assembly, self.model.values)
            outputs, k = done.model.copy(), self.channels.index(network.channel)
            unit = split_column(network.channel)[1]
            outputs[:, k] = to_si(from_si(outputs[:, k], unit) + self._value(done), unit)
            return done, outputs
        assert self.model.uncorrected is not None
        before = self._run(*self.model.uncorrected)
        unit = split_column(network.trained.output_name)[1]
        done = self._run(
            self.model.assembly, self.model.values, np.asarray(to_si(self._value(before), unit))
        )
        return done, done.model

    def _run(self, assembly: Assembly, p: Array, added: Array | None = None) -> Replay:
        measured = replace(assembly, outputs=self.channels)
        split, inputs = self.split, assembly.traced.inputs
        track = track_of(measured, self.recording, self.channels, split.jump, split.timescale_s)
        if added is not None:
            u = track.u.copy()
            u[:, inputs.index(ADDED)] = added
            track = replace(track, u=u)
        # of a channel that was not recorded nothing is weighed
        noise = np.array(
            [
                split.noise[split.channels.index(c)] if c in split.channels else 1.0
                for c in self.channels
            ]
        )
        return replay_track(measured, p, track, self.model.stepping, noise)

    def _value(self, done: Replay) -> Array:
        """The network over every window from a zero state, in its unit (samples,)."""
        network, inputs = self.model.network, self.model.assembly.traced.inputs
        assert network is not None
        signals = {}
        for name, source in zip(network.trained.input_names, network.sources, strict=True):
            if source in self.channels:
                values = done.model[:, self.channels.index(source)]
            else:
                values = done.track.u[:, inputs.index(source)]
            signals[name] = from_si(values, split_column(source)[1])
        prediction = np.zeros(len(done.model))
        for w in done.windows:
            rows = slice(w.start, w.stop)
            prediction[rows] = network.trained.predict({k: v[rows] for k, v in signals.items()})
        return prediction
