"""How far pulses on a joint of the second paper's arm swing the other, and what of it is lost
where the equations leave the coupling out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pamid.api.replications.arm_twin import ARM_RIG, VARIABLES, Taken, shown
from pamid.base.arrays import Array
from pamid.base.metrics import mae
from pamid.base.schemas import paper_files as result
from pamid.engine.symbolic.vocabulary import ZERO, Expr
from pamid.recording.recording import Recording
from pamid.report.paper_figure import Panel, coupling_picture
from pamid.rigs.two_link import JOINTS, TwoLink

SETTLED_S = 1.0  # after the last pulse on a joint, until what it set moving has come to rest
SHOWN_S = (0.3, 0.9)  # of the figure, before and after the largest deflection


class Uncoupled(TwoLink):
    """The arm without M12 and without Coriolis and centrifugal forces: each joint feels the other
    through gravity alone."""

    name = ARM_RIG

    def coupling(self, x: Any, p: Any, lever: Expr, about_2: Expr) -> tuple[Expr, Expr]:
        return ZERO, ZERO


@dataclass(frozen=True, eq=False)
class PulsedStretch:
    """Samples (slice) in which the valves of a joint are pulsed and those of the other are not:
    numbers of the joints."""

    pulsed: str
    moved: str
    rows: slice

    @property
    def angle(self) -> str:
        """The column that moves."""
        return f"angle_{self.moved}_deg"


def stretches(r: Recording) -> list[PulsedStretch]:
    """A stretch per joint whose valves are pulsed, in time apart from the other's."""
    selected, samples = [], round(SETTLED_S / r.sampling_period_s)
    for pulsed, moved in zip(JOINTS, JOINTS[::-1], strict=True):
        sent, other = (np.flatnonzero(r.signal(f"command_{j}")) for j in (pulsed, moved))
        if not len(sent):
            continue
        first, last = int(sent[0]), min(int(sent[-1]) + samples, len(r))
        later = other[other > first]
        last = min(last, int(later[0])) if len(later) else last
        selected.append(PulsedStretch(pulsed, moved, slice(first, last)))
    return selected


def coupling_json(
    pulse_record: Taken, runs: dict[str, Array]
) -> tuple[tuple[result.ArmCoupling, ...], list[Panel]]:
    """The figures of the coupling in a recording with pulses, and what to draw of them.

    runs: whole free runs (samples x VARIABLES, SI) of the data sheet, the fitted model and the
    fitted model without the coupling, by name in `ArmCoupling.mae`.
    """
    r, couplings, drawn = pulse_record.recording, [], []
    for stretch in stretches(r):
        k = VARIABLES.index(stretch.angle)
        measured, noise = r.signal(stretch.angle), shown(stretch.angle, pulse_record.noise[:, k])
        angles = {name: shown(stretch.angle, run[:, k]) for name, run in runs.items()}
        clean = (measured - noise)[stretch.rows]
        errors = {n: mae(measured[stretch.rows], a[stretch.rows]) for n, a in angles.items()}
        errors["noise_floor"] = float(np.abs(noise[stretch.rows]).mean())
        couplings.append(
            result.ArmCoupling(
                pulsed=stretch.pulsed,
                moved=stretch.angle,
                from_s=r.time[stretch.rows][0],
                to_s=r.time[stretch.rows][-1],
                swing_deg=np.ptp(clean),
                mae=errors,
            )
        )
        middle = stretch.rows.start + int(np.argmax(np.abs(clean - np.median(clean))))
        before, after = (round(s / r.sampling_period_s) for s in SHOWN_S)
        seen = slice(max(middle - before, 0), middle + after)
        title = f"angle {stretch.moved} [deg]\npulse on joint {stretch.pulsed}"
        lines = {
            "measured": measured[seen],
            "fitted, coupling terms left out": angles["without_coupling"][seen],
            "fitted": angles["fitted"][seen],
        }
        drawn.append(Panel(title, r.time[seen], lines))
    return tuple(couplings), drawn


def coupling_png(couplings: tuple[result.ArmCoupling, ...], drawn: list[Panel]) -> bytes:
    """PNG of the largest deflection at each joint; its title states how far, and why."""

    def each(name: str) -> str:
        return " and ".join(f"{coupling.mae[name]:.2g}" for coupling in couplings)

    moved = ", ".join(
        f"joint {coupling.moved.split('_')[1]} by {coupling.swing_deg:.1f} deg"
        for coupling in couplings
    )
    title = (
        f"Pulses on either joint swing the other: {moved}. The fitted arm is off by "
        f"{each('fitted')} deg, without coupling terms by {each('without_coupling')} deg "
        f"(noise alone: {each('noise_floor')})"
    )
    return coupling_picture(title, drawn)
