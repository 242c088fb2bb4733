"""Recordings without a machine in them, and genuine ones that resemble them.

    python benchmarks/nonsense.py [--jobs 2] [--rig NAME ...] [--kind NAME ...] [--output FOLDER]

Every kind of nonsense is made for every rig and diagnosed by `pamid diagnose`. It has to be refused
(exit code 3 or 4) or reported as not showing the machine. A genuine recording of the same rig with
a planted effect stands next to it, made as similar to the nonsense as a machine can be. It has to
be answered. Printed: one line per diagnosis, then the counts. Exit code 1 if any nonsense was
explained or any genuine recording was not answered.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.model.registry import rig_named
from pamid.recording.recording import read_recording, write_recording
from pamid.simulation.excitation.aprbs import aprbs
from pamid.simulation.virtual_rig import simulate_virtual_rig

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Bench:
    """A rig with an excitation that shows it.

    effect, family: planted in the genuine recordings; specimen: parameters that differ from the
    data sheet; response_s: about how long the rig takes to answer.
    """

    rig: str
    command: str
    amplitude: float
    centre: float
    hold_s: tuple[float, float]
    period_s: float
    response_s: float
    effect: str
    family: str
    specimen: dict[str, float]
    samples: int = 1500
    constant: dict[str, float] = field(default_factory=dict)  # further inputs


BENCHES = {
    "cart": Bench(
        str(ROOT / "benchmarks" / "rigs" / "dragged_cart.py"),
        "force_n",
        3.0,
        0.0,
        (0.16, 0.8),
        0.02,
        0.5,
        "coulomb-friction@force",
        "friction",
        {"mass_kg": 1.1, "drag_n_s_per_m": 2.3},
    ),
    "dc-motor": Bench(
        "dc-motor",
        "voltage_v",
        12.0,
        0.0,
        (0.1, 0.6),
        0.005,
        0.1,
        "coulomb-friction@shaft",
        "friction",
        {"inertia": 0.033, "resistance": 1.1},
    ),
    "thermal-block": Bench(
        "thermal-block",
        "power_w",
        40.0,
        50.0,
        (200.0, 1200.0),
        10.0,
        500.0,
        "first-order-lag@sensor",
        "sensor-dynamics",
        {"capacity": 430.0, "loss": 0.9},
        constant={"ambient_degc": 20.0},
    ),
    "cascaded-tanks": Bench(
        "cascaded-tanks",
        "pump_v",
        1.5,
        3.0,
        (20.0, 120.0),
        2.0,
        50.0,
        "first-order-lag@gauge",
        "sensor-dynamics",
        {"gain": 11.0, "upper_hole": 0.21},
    ),
}
Columns = dict[str, Array]


@dataclass(frozen=True)
class Genuine:
    """What a kind of nonsense is made from: time (s), inputs and outputs of the machine, outputs
    of the same machine with another excitation, and a generator."""

    bench: Bench
    time: Array
    sent: Columns
    measured: Columns
    foreign: Columns
    random: np.random.Generator

    @property
    def phase(self) -> Array:
        """Time in response times of the rig."""
        return self.time / self.bench.response_s

    def instead(self, curve: Callable[[Array], Array]) -> tuple[Columns, Columns]:
        """Every output replaced by a curve of the given one; offset and spread stay, with 0.2 %
        of sensor noise."""
        made = {}
        for name, y in self.measured.items():
            c = np.asarray(curve(y), dtype=float)
            c = (c - c.mean()) / (c.std() or 1.0)
            noise = 2e-3 * self.random.standard_normal(len(y))
            made[name] = y.mean() + y.std() * (c + noise)
        return self.sent, made


Making = Callable[[Genuine], tuple[Columns, Columns]]


def _shuffled(g: Genuine, block: int) -> NDArray[np.intp]:
    """Rows in another order, in blocks of so many samples."""
    blocks = g.random.permutation(np.arange(len(g.time)).reshape(-1, block))
    return np.asarray(blocks.reshape(-1))


def _telegraph(g: Genuine) -> Array:
    return np.where(g.random.random(len(g.time)) < 0.02, -1.0, 1.0).cumprod()


def _low_pass(g: Genuine, white: Array) -> Array:
    from scipy.signal import lfilter

    a = float(np.exp(-g.bench.period_s / g.bench.response_s))
    return np.asarray(lfilter([1.0 - a], [1.0, -a], white))


def _white(g: Genuine) -> Array:
    return g.random.standard_normal(len(g.time))


def _echo(g: Genuine, shape: Callable[[Array], Array]) -> tuple[Columns, Columns]:
    u = g.sent[g.bench.command]
    return g.sent, {name: shape(u) for name in g.measured}


def _of_both(g: Genuine, rows: Any) -> tuple[Columns, Columns]:
    return {k: v[rows] for k, v in g.sent.items()}, {k: v[rows] for k, v in g.measured.items()}


#: what is sent and measured, of every kind of nonsense
NONSENSE: dict[str, Making] = {
    "ramp": lambda g: g.instead(lambda y: g.time),
    "falling ramp": lambda g: g.instead(lambda y: -g.time),
    "parabola": lambda g: g.instead(lambda y: g.time**2),
    "sine, slow": lambda g: g.instead(lambda y: np.sin(0.5 * g.phase)),
    "sine, fast": lambda g: g.instead(lambda y: np.sin(3.0 * g.phase)),
    "two sines": lambda g: g.instead(lambda y: np.sin(0.7 * g.phase) + np.sin(1.9 * g.phase)),
    "chirp": lambda g: g.instead(lambda y: np.sin(0.3 * g.phase * (1.0 + g.time / g.time[-1]))),
    "decay": lambda g: g.instead(lambda y: np.exp(-3.0 * g.time / g.time[-1])),
    "rise to a plateau": lambda g: g.instead(lambda y: -np.exp(-6.0 * g.time / g.time[-1])),
    "sigmoid": lambda g: g.instead(lambda y: np.tanh(8.0 * g.time / g.time[-1] - 4.0)),
    "sawtooth": lambda g: g.instead(lambda y: g.phase % 5.0),
    "counter": lambda g: g.instead(lambda y: np.floor(50.0 * g.time / g.time[-1])),
    "white noise": lambda g: g.instead(lambda y: _white(g)),
    "low-pass noise": lambda g: g.instead(lambda y: _low_pass(g, _white(g))),
    "random walk": lambda g: g.instead(lambda y: _white(g).cumsum()),
    "random telegraph": lambda g: g.instead(lambda y: _telegraph(g)),
    "at rest with noise": lambda g: (
        g.sent,
        {k: y.mean() + 2e-3 * y.std() * _white(g) for k, y in g.measured.items()},
    ),
    "shuffled rows": lambda g: _of_both(g, _shuffled(g, 1)),
    "shuffled outputs": lambda g: (g.sent, _of_both(g, _shuffled(g, 1))[1]),
    "shuffled blocks of outputs": lambda g: (g.sent, _of_both(g, _shuffled(g, 50))[1]),
    "foreign output": lambda g: (g.sent, g.foreign),
    "foreign output, first channel": lambda g: (
        g.sent,
        {**g.measured, **dict(list(g.foreign.items())[:1])},
    ),
    "sine in the last channel": lambda g: (
        g.sent,
        {**g.measured, **dict(list(NONSENSE["sine, fast"](g)[1].items())[-1:])},
    ),
    "foreign output, with drift": lambda g: (
        g.sent,
        {k: y + y.std() * g.time / g.time[-1] for k, y in g.foreign.items()},
    ),
    "output half a recording late": lambda g: (
        g.sent,
        _of_both(g, np.roll(np.arange(len(g.time)), len(g.time) // 2))[1],
    ),
    "reversed output": lambda g: (g.sent, _of_both(g, slice(None, None, -1))[1]),
    "reversed time": lambda g: _of_both(g, slice(None, None, -1)),
    "foreign input": lambda g: (
        {**g.sent, g.bench.command: _sent(g.bench, 99)[g.bench.command]},
        g.measured,
    ),
    "echo of the input": lambda g: _echo(g, lambda u: u),
    "noisy echo": lambda g: _echo(g, lambda u: u + 0.02 * u.std() * _white(g)),
    "filtered echo": lambda g: _echo(
        g, lambda u: np.convolve(np.r_[[u[0]] * 4, u], np.ones(5) / 5.0, "valid")
    ),
}


def _sent(bench: Bench, seed: int) -> Columns:
    u = aprbs(
        bench.samples * bench.period_s,
        bench.period_s,
        bench.amplitude,
        bench.hold_s,
        seed=seed,
        offset=bench.centre,
    )
    return {bench.command: u, **{k: np.full(len(u), v) for k, v in bench.constant.items()}}


def _swept(bench: Bench, curve: Callable[[Array], Array]) -> Columns:
    """The usual excitation at half its size, on top of a curve of time in response times."""
    sent = _sent(bench, 1)
    time = bench.period_s * np.arange(bench.samples)
    u = 0.5 * (sent[bench.command] + bench.centre) + 0.5 * bench.amplitude * curve(
        time / bench.response_s
    )
    return {**sent, bench.command: u}


@dataclass(frozen=True)
class Variation:
    """How a genuine recording differs from the usual one."""

    sent: Callable[[Bench], Columns] = lambda bench: _sent(bench, 1)
    noise: float = 1.0
    after: Callable[[Array, Array], Array] = lambda y, time: y  # what the logger adds


#: the genuine recording that resembles a kind of nonsense; the usual one of those not listed
GENUINE: dict[str, Variation] = {
    "ramp": Variation(lambda b: _swept(b, lambda t: t / t[-1])),
    "falling ramp": Variation(lambda b: _swept(b, lambda t: -t / t[-1])),
    "parabola": Variation(lambda b: _swept(b, lambda t: (t / t[-1]) ** 2)),
    "sine, slow": Variation(lambda b: _swept(b, lambda t: np.sin(0.5 * t))),
    "sine, fast": Variation(lambda b: _swept(b, lambda t: np.sin(3.0 * t))),
    "two sines": Variation(
        lambda b: _swept(b, lambda t: 0.5 * (np.sin(0.7 * t) + np.sin(1.9 * t)))
    ),
    "chirp": Variation(lambda b: _swept(b, lambda t: np.sin(0.3 * t * (1.0 + t / t[-1])))),
    "decay": Variation(lambda b: _swept(b, lambda t: np.exp(-3.0 * t / t[-1]))),
    "rise to a plateau": Variation(lambda b: _swept(b, lambda t: -np.exp(-6.0 * t / t[-1]))),
    "sigmoid": Variation(lambda b: _swept(b, lambda t: np.tanh(8.0 * t / t[-1] - 4.0))),
    "sawtooth": Variation(lambda b: _swept(b, lambda t: (t % 5.0) / 2.5 - 1.0)),
    "counter": Variation(after=lambda y, time: np.round(y / (0.02 * y.std())) * 0.02 * y.std()),
    "white noise": Variation(noise=3.0),
    "low-pass noise": Variation(noise=2.0),
    "random walk": Variation(
        after=lambda y, time: y + 0.01 * y.std() * np.sin(3.0 * time / time[-1])
    ),
    "foreign output": Variation(lambda b: _sent(b, 2)),
    "foreign output, with drift": Variation(lambda b: _sent(b, 3)),
    "foreign input": Variation(lambda b: _sent(b, 4)),
    "noisy echo": Variation(noise=0.5),
}


def _machine(bench: Bench, sent: Columns, noise: float, seed: int) -> Columns:
    """Outputs of the rig with its planted effect."""
    time_s = bench.period_s * np.arange(bench.samples)
    with tempfile.TemporaryDirectory() as folder:
        write_recording(Path(folder) / "sent.csv", time_s, sent)
        made = simulate_virtual_rig(
            bench.rig,
            read_recording(Path(folder) / "sent.csv"),
            (bench.effect,),
            {},
            bench.specimen,
            noise,
            seed,
        )
    return {name: made.columns[name] for name in rig_named(bench.rig).outputs}


def columns_of(name: str, kind: str, genuine: bool) -> tuple[Array, Columns]:
    """Time and columns of one recording: nonsense of this kind, or the genuine one next to it."""
    bench = BENCHES[name]
    place = list(NONSENSE).index(kind)
    time_s = bench.period_s * np.arange(bench.samples)
    if genuine:
        variation = GENUINE.get(kind, Variation())
        sent = variation.sent(bench)
        measured = _machine(bench, sent, variation.noise, 100 + place)
        return time_s, {**sent, **{k: variation.after(y, time_s) for k, y in measured.items()}}
    sent = _sent(bench, 1)
    g = Genuine(
        bench,
        time_s,
        sent,
        _machine(bench, sent, 1.0, 1),
        _machine(bench, _sent(bench, 7), 1.0, 2),
        np.random.default_rng(place),
    )
    sent, measured = NONSENSE[kind](g)
    return time_s, {**sent, **measured}


@dataclass(frozen=True)
class Outcome:
    """What became of one recording: the word that counts, and the answer's first sentence."""

    rig: str
    kind: str
    genuine: bool
    word: str
    sentence: str
    cpu_s: float


def outcome_of(name: str, kind: str, genuine: bool, folder: Path) -> Outcome:
    """Write the recording, diagnose it through the command line, and read the answer."""
    from pamid_cli.frame import run

    bench = BENCHES[name]
    stem = f"{name}-{kind}-{'genuine' if genuine else 'nonsense'}".replace(" ", "-").replace(
        ",", ""
    )
    time_s, columns = columns_of(name, kind, genuine)
    write_recording(folder / f"{stem}.csv", time_s, columns)
    words = ["diagnose", str(folder / f"{stem}.csv"), "--rig", bench.rig, "--output"]
    words += [str(folder / stem), "--overwrite", "--jobs", "1", "--json"]
    out, begun = io.StringIO(), time.process_time()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(io.StringIO()):
        code = run(words)
    answer: dict[str, Any] = json.loads(out.getvalue())
    word = _word(bench, code, answer, genuine)
    sentence = answer.get("message") or answer.get("sentence", "")
    return Outcome(name, kind, genuine, word, sentence, time.process_time() - begun)


def _word(bench: Bench, code: int, answer: dict[str, Any], genuine: bool) -> str:
    if code in (3, 4):
        return "refused"
    if code not in (0, 6):
        return f"exit {code}"
    if answer["verdict"] == "cannot-tell" and answer["remark"]:
        return "called nonsense"
    families = {c["family"] for c in answer["causes"]}
    if genuine:
        return "right" if bench.family in families else "answered"
    return "explained" if families or answer["verdict"] == "no-structural-gap" else "left open"


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--rig", nargs="*", choices=BENCHES, default=list(BENCHES))
    parser.add_argument("--kind", nargs="*", choices=NONSENSE, default=list(NONSENSE))
    parser.add_argument("--only", choices=("nonsense", "genuine"))
    parser.add_argument("--output", type=Path, help="keep recordings and runs here")
    options = parser.parse_args()
    roles = [
        role for role in (False, True) if options.only in (None, ("nonsense", "genuine")[role])
    ]
    counts: dict[bool, Counter[str]] = {False: Counter(), True: Counter()}
    begun, cpu_s = time.monotonic(), 0.0
    with contextlib.ExitStack() as stack:
        folder = options.output or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        folder.mkdir(parents=True, exist_ok=True)
        pool = stack.enter_context(ProcessPoolExecutor(options.jobs))
        work = [
            pool.submit(outcome_of, name, kind, role, folder)
            for kind in options.kind
            for name in options.rig
            for role in roles
        ]
        for done in as_completed(work):
            o = done.result()
            counts[o.genuine][o.word] += 1
            cpu_s += o.cpu_s
            print(
                f"{'genuine' if o.genuine else 'nonsense':8s} {o.rig:14s} {o.kind:28s} "
                f"{o.word:15s} {o.cpu_s:5.1f} s  {o.sentence[:150]}",
                flush=True,
            )
    nonsense, genuine = counts[False], counts[True]
    print(f"\n{cpu_s:.0f} s of CPU, {time.monotonic() - begun:.0f} s by the clock")
    print(f"nonsense {nonsense.total()}: {dict(nonsense)}")
    print(f"genuine {genuine.total()}: {dict(genuine)}")
    bad = nonsense.total() - nonsense["refused"] - nonsense["called nonsense"]
    unanswered = genuine.total() - genuine["right"] - genuine["answered"]
    print(f"nonsense not rejected {bad}, genuine not answered {unanswered}")
    return 1 if bad or unanswered else 0


if __name__ == "__main__":
    sys.exit(main())
