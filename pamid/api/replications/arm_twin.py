"""The twin of the second paper's arm: a virtual arm that departs from its data sheet, and the tests
it is put to.

Not the authors' arm: neither its recordings nor its parameters are published. Departures are of the
size that such data sheets have been found to be off by; many other twins would do.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pamid.api.replications.joint_twin import departed
from pamid.base.arrays import Array
from pamid.base.csv_table import table_bytes
from pamid.base.files import write_atomically
from pamid.base.units import from_si, split_column, to_si
from pamid.effects.coulomb_friction import CoulombFriction
from pamid.model.registry import catalogue_rig
from pamid.model.rig import Rig
from pamid.networks.correction.force_map import COLUMNS, ForceMap, pulls
from pamid.recording.recording import Recording, read_recording, write_recording
from pamid.rigs.muscle import LAWS
from pamid.rigs.muscle_experiments import gravity_test, muscle_pulses
from pamid.rigs.two_link import JOINTS
from pamid.simulation.data_split import DataSplit, split_recordings
from pamid.simulation.excitation.experiments import nothing_sent
from pamid.simulation.virtual_rig import simulate_virtual_rig

# recordings and what a model leaves of them, samples x VARIABLES (SI)
Pieces = Iterable[tuple[Recording, Array]]

ARM_RIG = "two-link"
#: what the paper compares: angles, contractions, pressures
VARIABLES = tuple(name for name in catalogue_rig(ARM_RIG).outputs if not name.startswith("force_"))
GRAVITY_TEST, PULSES = "gravity", "pulses"
#: what the twin's joints have and the rig has not
DRY_FRICTION = tuple(f"{CoulombFriction.name}@joint_{j}" for j in JOINTS)
DRY_LEVELS = tuple(f"{label}:torque_n_m" for label in DRY_FRICTION)
WITH_PAYLOAD, PAYLOAD_KG = "gravity-payload", 0.5
TRAINED_LEVEL, HELD_OUT_LEVEL = 1.0, 0.6
MAP_CONTRACTION, MAP_PRESSURE_KPA, MAP_NOISE_N = (
    np.linspace(0.0, 0.20, 6),
    np.linspace(0.0, 600.0, 21),
    3.0,
)


@dataclass(frozen=True)
class ArmTwin:
    """Hidden truth of the virtual arm: the force law of the muscles, the factor of each parameter
    over the data sheet, and dry friction of the joints, which the data sheet lacks.

    Inertial data are off by 15 to 25 %, as weighing and CAD without muscles, chains and screws
    leave them; the rest by about as much as its prior states. scale is that of the twin's law.
    """

    law: str = "braid-and-rubber"
    link_1_mass_kg: float = 1.22
    link_1_centre_m: float = 0.84
    link_1_inertia_kg_m2: float = 1.25
    link_2_mass_kg: float = 1.18
    link_2_centre_m: float = 1.15
    link_2_inertia_kg_m2: float = 0.80
    viscous_1_n_m_s: float = 1.5
    viscous_2_n_m_s: float = 1.5
    damping_m2_s: float = 0.60
    scale: float = 1.12
    conductance_in_m3_per_s_pa: float = 1.10
    conductance_out_m3_per_s_pa: float = 0.91
    critical_ratio: float = 0.88
    contraction_0: float = 1.04
    dead_volume_cm3: float = 1.6
    dry_friction_n_m: tuple[float, float] = (0.12, 0.04)

    @property
    def friction(self) -> dict[str, float]:
        """Level of the dry friction by name of the parameter that stands for it, N m."""
        return dict(zip(DRY_LEVELS, self.dry_friction_n_m, strict=True))

    def hidden(self) -> dict[str, float]:
        """Parameters that differ from the data sheet, by outside name."""
        return departed(ARM_RIG, asdict(self))

    def record(self, session: Session, *, noise: float = 1.0, seed: int = 0) -> dict[str, Any]:
        """columns (samples,) in their units and the meta of a recording; no load cells."""
        specs = tuple(f"{name}={value}" for name, value in self.friction.items())
        rig, sent, hidden = f"{ARM_RIG}:{self.law}", session.excitation, self.hidden()
        simulated = simulate_virtual_rig(rig, sent, specs, session.known, hidden, noise, seed)
        columns = {
            k: v for k, v in simulated.columns.items() if k in (*VARIABLES, *session.columns)
        }
        about = {**simulated.meta["recording"], "rig": ARM_RIG}
        return {"columns": columns, "meta": {**simulated.meta, "recording": about}}

    def force_map(self, path: Path, seed: int | list[int]) -> None:
        """A static test of a muscle at every contraction and pressure of the grid, with a noisy
        load cell, as CSV."""
        grid = np.meshgrid(MAP_CONTRACTION, MAP_PRESSURE_KPA, indexing="ij")
        contraction, pressure = (x.ravel() for x in grid)
        points = ForceMap(path, contraction, pressure, np.zeros(pressure.size))
        force = self.scale * pulls(LAWS[self.law], points)
        force = force + MAP_NOISE_N * np.random.default_rng(seed).standard_normal(force.size)
        rows = np.stack([contraction, pressure, force], axis=1)
        write_atomically(path, table_bytes(COLUMNS, rows, ["%.6g"] * len(COLUMNS)))


@dataclass(frozen=True, eq=False)
class Session:
    """A recording to be made. columns: what is sent (samples,); known: what the arm is set to."""

    name: str
    kind: str
    held_out: bool
    columns: dict[str, Array]
    known: dict[str, float]
    period_s: float

    @property
    def excitation(self) -> Recording:
        samples = len(next(iter(self.columns.values())))
        time = self.period_s * np.arange(samples, dtype=np.float64)
        return Recording(self.name, Path(self.name), "", time, self.columns, self.period_s)


def sessions(swing_s: float, muscles: tuple[str, ...], period_s: float) -> list[Session]:
    """Swings of this length with the muscles vented, then pulses on the valves of these muscles,
    and how often all of it is sampled.

    Both links free from two releases, link 1 clamped, a known payload on the tip; held out:
    releases from elsewhere, and pulses of another level in the opposite order.
    """
    rig = catalogue_rig(ARM_RIG)
    idle = nothing_sent(rig, round(swing_s / period_s))

    def swing(
        name: str,
        release: tuple[float, float],
        *,
        clamped: tuple[str, ...] = (),
        payload: float | None = None,
        held_out: bool = False,
    ) -> Session:
        known = gravity_test(rig, release, clamped, payload)
        return Session(name, GRAVITY_TEST, held_out, idle, known, period_s)

    def pulses(name: str, order: tuple[str, ...], level: float, held_out: bool) -> Session:
        sent = muscle_pulses(rig, order, level, period_s)
        return Session(name, PULSES, held_out, sent, {}, period_s)

    return [
        swing("gravity-free", (30.0, 40.0)),
        swing("gravity-free-other", (-35.0, 20.0)),
        swing("gravity-clamped", (0.0, 45.0), clamped=("1",)),
        swing(WITH_PAYLOAD, (25.0, -30.0), payload=PAYLOAD_KG),
        swing("gravity-free-held-out", (35.0, -35.0), held_out=True),
        swing("gravity-clamped-held-out", (0.0, -30.0), clamped=("1",), held_out=True),
        pulses("pulses", muscles, TRAINED_LEVEL, False),
        pulses("pulses-held-out", muscles[::-1], HELD_OUT_LEVEL, True),
    ]


# ---- what was recorded -------------------------------------------------------------------------


def unit_of(variable: str) -> str:
    """The unit in which tables and figures show a variable."""
    return {"deg": "deg", "kPa": "kPa"}.get(split_column(variable)[1], "%")


def shown(variable: str, value: Any) -> Any:
    """SI -> deg, %, kPa."""
    return from_si(value, {"%": "percent"}.get(unit_of(variable), unit_of(variable)))


def shown_mae(pieces: Pieces) -> dict[str, float]:
    """Mean absolute error (deg, %, kPa) of every variable where its joint is not clamped."""
    every = list(pieces)

    def moves(variable: str, r: Recording) -> bool:
        return not r.known.get(f"clamped_{variable.split('_')[1][0]}")

    errors = {}
    for k, v in enumerate(VARIABLES):
        left = np.concatenate([np.abs(left[:, k]) for r, left in every if moves(v, r)])
        errors[v] = float(shown(v, left.mean()))
    return errors


@dataclass(frozen=True, eq=False)
class Taken:
    """A recording of the twin, and what noise alone makes of it (samples x VARIABLES, SI)."""

    session: Session
    recording: Recording
    noise: Array


@dataclass(frozen=True, eq=False)
class ArmRecords:
    """All recordings of the twin."""

    taken: tuple[Taken, ...]

    def of(self, kind: str, *, held_out: bool) -> list[Recording]:
        """The recordings of gravity tests or of pulses that are fitted, or held out."""
        return [t.recording for t in self.taken_of(kind, held_out=held_out)]

    def taken_of(self, kind: str, *, held_out: bool) -> list[Taken]:
        """The same with what noise alone makes of them."""
        return [t for t in self.taken if (t.session.kind, t.session.held_out) == (kind, held_out)]

    def evidence(self, rig: Rig, kind: str, without: str = "") -> DataSplit:
        """The recordings of a kind as a fit wants them; any of them may be left out by name."""
        fitted = [r for r in self.of(kind, held_out=False) if r.name != without]
        return split_recordings(rig, fitted, self.of(kind, held_out=True))

    def floor(self, kind: str) -> dict[str, float]:
        """Error of the twin itself on what is held out, as `shown_mae`."""
        return shown_mae((t.recording, t.noise) for t in self.taken_of(kind, held_out=True))


def record_arm(folder: Path, twin: ArmTwin, planned: list[Session], seed: int) -> ArmRecords:
    """Make all recordings, with the default sensor noise, as files a user could have."""
    recordings = []
    for k, session in enumerate(planned):
        path = folder / f"{session.name}.csv"
        record = twin.record(session, seed=len(planned) * seed + k)
        write_recording(path, session.excitation.time, **record)
        recording, quiet = read_recording(path), twin.record(session, noise=0.0)["columns"]
        clean = np.stack([to_si(quiet[v], split_column(v)[1]) for v in VARIABLES], axis=1)
        measured = np.stack([recording.si(v) for v in VARIABLES], axis=1)
        recordings.append(Taken(session, recording, measured - clean))
    return ArmRecords(tuple(recordings))
