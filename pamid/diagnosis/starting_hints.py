"""Starting values from the gap: the strongest lines of its spectrum, and how far the signals at a
port reach."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pamid.diagnosis.candidate_model import CandidateModel
from pamid.diagnosis.settings import DEFAULT, Settings
from pamid.model.effect import Hints
from pamid.simulation.data_split import DataSplit
from pamid.simulation.replay import Replay, run_windows
from pamid.simulation.windows import Window
from pamid.symbolic.vocabulary import Expr

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GapHints:
    """peaks_hz: strongest first; reach: largest magnitude of every signal at every port (SI)."""

    peaks_hz: tuple[float, ...]
    reach: dict[str, dict[str, float]]

    def at(self, port: str) -> Hints:
        return Hints(self.peaks_hz, self.reach.get(port, {}))


def gather_hints(
    evidence: DataSplit, base: CandidateModel, settings: Settings = DEFAULT
) -> GapHints:
    """From the windows of a model's fit and its held-out replays."""
    return GapHints(spectrum_peaks(list(base.replays), evidence.noise, settings), _reach(base))


def _reach(base: CandidateModel) -> dict[str, dict[str, float]]:
    """Largest magnitudes where windows begin: there the states are near those of the recording;
    later on a model that knows no limit runs past it."""
    assembly, fit = base.assembly, base.fit
    wanted = {
        f"{q.where}.{name}": (q.port, name, value)
        for q in assembly.traced.passages
        for name, value in q.signals
        if isinstance(value, Expr)
    }
    program = assembly.program_with({key: value for key, (_, _, value) in wanted.items()})
    places = [
        (t, fit.problem.windows(t), x) for t, x in zip(fit.problem.tracks, fit.starts, strict=True)
    ]
    places += [(r.track, list(r.windows), r.entered) for r in base.replays]
    seen = [
        run_windows(
            program,
            assembly,
            fit.p,
            track,
            [Window(w.start, w.start + 1) for w in windows],
            x,
            fit.stepping,
        )
        for track, windows, x in places
    ]
    most = np.abs(np.concatenate(seen)).max(axis=0)[len(program.outputs) - len(wanted) :]
    reach: dict[str, dict[str, float]] = {}
    for (port, name, _), far in zip(wanted.values(), most, strict=True):
        there = reach.setdefault(port, {})
        there[name] = max(there.get(name, 0.0), float(far))
    return reach


def spectrum_peaks(
    before: list[Replay], noise: Array, settings: Settings = DEFAULT
) -> tuple[float, ...]:
    """Strongest lines of the gap, Hz, resolved to a fraction of 1/duration."""
    b = max(before, key=lambda r: len(r.track))
    r = (b.residual / noise) * np.hanning(len(b.track))[:, None]
    n = 1 << (4 * len(b.track) - 1).bit_length()  # padded: at least four points per 1/duration
    power = (np.abs(np.fft.rfft(r, n, axis=0)) ** 2).sum(axis=1)
    axis = np.fft.rfftfreq(n, b.track.period_s)
    power[axis * b.track.timescale_s < settings.slowest_line] = 0.0
    # odd; of a short recording all there is
    width = min(settings.spectrum_smooth, len(power) - 1 + len(power) % 2)
    smooth = np.convolve(power, np.ones(width) / width, "same")
    # against the mean around it: a broad hump, however strong, is no line
    contrast = power / (smooth + 1e-12 * power.max() + 1e-300)
    peaks, apart = [], settings.spectrum_apart
    for _ in range(settings.spectrum_lines):
        k = int(np.argmax(contrast * np.sqrt(power)))
        peaks.append(float(axis[k]))
        contrast[max(0, k - apart) : k + apart] = 0.0  # the line with the window's skirts
    return tuple(peaks)
