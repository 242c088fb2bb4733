"""Form of a mechanism: equations, or steps of MuJoCo.

A mechanism whose only hindrance is contact may take either form. Recordings decide. If no geoms
touch and no joint reaches an end of its range, equations describe the machine in full. Without
recordings the share of configurations with contacts decides (`mujoco_findings.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from pamid.base.errors import FileError
from pamid.model.rig import Rig
from pamid.recording.recording import Recording
from pamid.rigs.simulators.compiled_rig import CompiledMechanism
from pamid.rigs.simulators.mechanism import Mechanism
from pamid.rigs.simulators.mujoco_findings import CONTACT
from pamid.rigs.simulators.recorded_contacts import GeomPair, RecordedContacts, recorded_contacts
from pamid.rigs.simulators.stepped_mechanism import SteppedMechanism

EQUATIONS_FORM, STEPPED_FORM = "equations", "stepped"


def mechanism_rig(mechanism: Mechanism) -> Rig:
    """Mechanism in its form without recordings, with the forms to choose from."""
    rig = SteppedMechanism if mechanism.hindrances else CompiledMechanism
    typed_rig: Rig = rig(mechanism)
    if mechanism.collides and all(f.element == CONTACT for f in mechanism.hindrances):
        untyped: Any = typed_rig
        untyped.forms = MechanismForms(mechanism)
    return typed_rig


@dataclass(frozen=True)
class MechanismForms:
    """The two forms of a mechanism whose only hindrance is contact."""

    mechanism: Mechanism

    def named(self, form: str) -> Rig:
        """See `pamid.model.rig.RigForms`."""
        return self._rig(form, "")

    def suiting(self, recordings: Sequence[Recording]) -> Rig | None:
        """See `pamid.model.rig.RigForms`."""
        if not any(r.has(s.column) for s in self.mechanism.sensors for r in recordings):
            return None  # an excitation has no measured motion
        met = recorded_contacts(self.mechanism, recordings)
        if met.unread:
            if not self.mechanism.hindrances:
                return None
            joints = ", ".join(map(repr, met.unread))
            return self._rig(
                STEPPED_FORM,
                f"Stepped by MuJoCo: no reading shows the position of {joints}, so that contacts "
                "cannot be ruled out.",
            )
        if met.free:
            return self._rig(EQUATIONS_FORM, _free_words(met))
        return self._rig(
            STEPPED_FORM, f"Stepped by MuJoCo: {_acting_words(met, self.mechanism.path)}"
        )

    def left_out(self, rig: Rig, recording: Recording) -> str:
        """See `pamid.model.rig.RigForms`."""
        if isinstance(rig, SteppedMechanism):
            return ""
        met = recorded_contacts(self.mechanism, [recording])
        if met.free or met.unread:
            return ""
        return (
            "The model runs as equations, without contacts and ends of ranges. "
            f"{_acting_words(met, self.mechanism.path)}"
        )

    def _rig(self, form: str, note: str) -> Rig:
        kinds = {EQUATIONS_FORM: CompiledMechanism, STEPPED_FORM: SteppedMechanism}
        if form not in kinds:
            raise FileError(
                f"{self.mechanism.path}: it cannot be run as {form!r}.",
                f"Its forms: {', '.join(kinds)}.",
                code="form",
            )
        findings = [f for f in self.mechanism.findings if f.element != CONTACT]
        if form == STEPPED_FORM:
            findings = [
                replace(f, hinders=f.hinders or f.element == CONTACT)
                for f in self.mechanism.findings
            ]
        rig: Any = kinds[form](replace(self.mechanism, findings=tuple(findings)))
        rig.forms, rig.form, rig.form_note = self, form, note
        typed_rig: Rig = rig
        return typed_rig


def _free_words(met: RecordedContacts) -> str:
    first = "Written as equations: no geoms touch in these recordings"
    if met.nearest is None:
        return f"{first}, and none come near each other."
    pair = met.nearest
    return (
        f"{first}. {_pair_words(pair)} come nearest: {_length(pair.distance_m)}, at "
        f"{pair.time_s:.3g} s of {pair.recording}."
    )


def _acting_words(met: RecordedContacts, path: str) -> str:
    """Sentences on the interactions along a recording, and on how to leave them out."""
    if met.touching is None:
        return f"{met.limit}."
    pair = met.touching
    first, second = pair.bodies
    cure = f'<contact><exclude body1="{first}" body2="{second}"/></contact>'
    cure = "remove one <collision>" if path.endswith(".urdf") else cure
    return (
        f"{_pair_words(pair)} touch in about {100 * met.share:.2g} % of the samples of "
        f"{pair.recording}, first at {pair.time_s:.3g} s. If the machine itself does not touch "
        f"there, leave the pair out of the model: {cure}."
    )


def _pair_words(pair: GeomPair) -> str:
    """Two geoms with the bodies that carry them."""
    first, second = (
        f"{geom} of {body}" for geom, body in zip(pair.geoms, pair.bodies, strict=True)
    )
    return f"{first} and {second}"


def _length(metres: float) -> str:
    return f"{1e3 * max(metres, 0.0):.2g} mm" if metres < 0.1 else f"{metres:.2g} m"
