"""What to measure next: the experiment whose known blind spots best split what is still alike."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Experiment:
    """An entry of the menu. sees: families that leave a trace in it; the others do not."""

    name: str
    minutes: float
    sees: frozenset[str]
    why: str
    air: bool = True     # needs a pneumatic rig


_MUSCLE = {"muscle-hysteresis", "asymmetry", "muscle-creep", "threshold-pressure"}
_AIR = {"command-timing", "valve-dead-band", "tube-lag", "supply-sag", "flow-mismatch"}

MENU = (
    Experiment("torque-loops-two-pressures", 8.0, frozenset(_MUSCLE | {"friction", "end-stop", "gravity",
                                                                    "flexible-transmission", "hysteresis",
                                                                    "stiffness"}),
               "slow torque loops at 2 and 5 bar: friction in the joint keeps its width, muscle hysteresis grows with "
               "pressure, nothing in the valves is seen"),
    Experiment("quick-release", 4.0, frozenset({"friction", "muscle-hysteresis", "flexible-transmission",
                                                "sensor-dynamics", "drag"}),
               "release from a held torque with the valves shut: sensor lag and compliance show, valves and dead time "
               "do not"),
    Experiment("pressure-hold", 3.0, frozenset({"leak", "heat-transfer", "muscle-creep", "sensor-offset"}),
               "fill, shut all valves, wait 60 s: a leak falls for ever, heat settles within 2 s, friction is silent"),
    Experiment("valve-pulses", 3.0, frozenset(_AIR | {"leak", "heat-transfer", "sensor-gain"}),
               "pulses of 30-500 ms on each valve from four pressures: dead-band, delays and flow show, the joint "
               "hardly moves"),
    Experiment("duty-staircase", 3.0, frozenset({"valve-dead-band", "flow-mismatch", "saturation"}),
               "duty from 0 to 0.3 in small steps: only a dead-band leaves the pressure where it was"),
    Experiment("aprbs-other-inertia", 4.0, frozenset({"flexible-transmission", "friction", "command-timing"}),
               "the same excitation with another inertia: structural modes move, delays do not", air=False),
    Experiment("odd-multisine", 4.0, frozenset({"flexible-transmission", "sensor-dynamics", "command-timing",
                                                "asymmetry", "external-disturbance", "stiffness", "drag"}),
               "odd random-phase multisine up to 15 Hz: an anti-resonance marks compliance, even lines mark asymmetry",
               air=False),
    Experiment("slow-reversals", 4.0, frozenset({"friction", "hysteresis", "muscle-hysteresis", "valve-dead-band"}),
               "slow triangles with nested reversals and stops: dry friction sticks, drag vanishes with the speed",
               air=False),
    Experiment("constant-speed-runs", 4.0, frozenset({"drag", "friction", "sensor-gain"}),
               "constant speeds a decade apart: drag rises with speed, dry friction does not", air=False),
)


def next_experiment(contenders: list[tuple[str, str]], air: bool = True) -> dict[str, Any] | None:
    """contenders: (effect, family) still in question, best first; air: is the rig pneumatic? None where nothing is
    left to separate."""
    if len(contenders) < 2:
        return None
    (first, family), *others = contenders

    def splits(e: Experiment) -> list[str]:
        return [label for label, other in others if (family in e.sees) != (other in e.sees)]

    menu = [e for e in MENU if air or not e.air]
    best = max(menu, key=lambda e: (len(splits(e)), -e.minutes))
    separated = splits(best)
    if not separated:
        best, separated = next(e for e in MENU if e.name == "slow-reversals"), [others[0][0]]
    return {"name": best.name, "why": f"{best.why} ({best.minutes:g} min on the rig)",
            "separates": [first, separated[0]]}
