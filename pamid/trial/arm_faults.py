"""Faults that can be planted in the trial's arm, and their places.

A planted fault is called fault@place, the place being a port of the rig: either a single port of
several alike ("joint_2", "pressure_21"), or what they all are ("pressure": all four muscles alike).
Sizes are those of the joint, but for:

torques    larger at joint 1, which carries the whole arm
asymmetry  a single muscle is other than the data sheet, by as much as two opponents of the joint
           differ
wear       of valves driven less, by the gentler controller: twice as bad
end-stop   within the smaller travel

Left out is gravity, which is no fault of an arm that hangs in a vertical plane.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import radians
from typing import Any

import numpy as np

from pamid.base.errors import UsageError, nearest
from pamid.trial.faults import FAULTS, Fault, Planted, between, planted

MUSCLES, JOINTS = ("11", "12", "21", "22"), ("1", "2")
EVERYWHERE = 0.3  # share of the faults of muscles that all four have alike
#: like ports of the arm -> their numbers
KIN = {
    "command": JOINTS,
    "valve": MUSCLES,
    "pressure": MUSCLES,
    "muscle": MUSCLES,
    "relief": MUSCLES,
    "chain": MUSCLES,
    "joint": JOINTS,
    "arm": JOINTS,
    "angle_sensor": JOINTS,
    "pressure_sensor": MUSCLES,
}
GROUP = {
    "relief": "muscle",
    "chain": "structure",
    "arm": "structure",
    "angle_sensor": "sensor",
    "pressure_sensor": "sensor",
}
_PORT = {
    "force-compensator": "relief",
    "chain-stretch": "chain",
    "two-mass": "arm",
    "backlash": "arm",
    "nameless:eccentric-wheel": "arm",
    "angle-sensor-offset": "angle_sensor",
    "angle-sensor-lag": "angle_sensor",
    "pressure-sensor-lag": "pressure_sensor",
    "pressure-sensor-offset": "pressure_sensor",
    "pressure-sensor-gain": "pressure_sensor",
}
# at all alike they are no fault
_SINGLE_MUSCLE = ("force-asymmetry", "length-asymmetry", "flow-mismatch")
_SHARED = {"supply-sag": "valve", "clock-skew": "sensor"}  # shared by the whole arm
_TWICE = ("force_difference", "length_difference", "flow_mismatch", "wear")
#: factors of sizes at joint 1
_AT_JOINT_1 = {
    **dict.fromkeys(
        (
            "dahl_nm",
            "stick_nm",
            "plastic_nm",
            "shake_nm",
            "detent_nm",
            "bent_damping",
            "stop_nm_rad",
        ),
        3.0,
    ),
    "stop_rad": 0.7,
}
_LEFT_OUT = ("gravity",)


def _for_arm(fault: Fault) -> Fault:
    sizes = {
        name: (lambda random, draw=draw: 2.0 * draw(random)) if name in _TWICE else draw
        for name, draw in fault.sizes.items()
    }
    if fault.name == "end-stop":
        sizes["stop_rad"] = between(radians(20.0), radians(27.0))
    # a length moves its muscle only, the zero of an angle moves two
    return replace(
        fault,
        sizes=sizes,
        exact=fault.exact & {fault.name} if fault.family == "asymmetry" else fault.exact,
    )


ARM_FAULTS: dict[str, Fault] = {
    name: _for_arm(fault) for name, fault in FAULTS.items() if name not in _LEFT_OUT
}


def draw_site(name: str, random: np.random.Generator) -> str:
    """fault@place for a drawn place."""
    if name in _SHARED:
        return f"{name}@{_SHARED[name]}"
    kin = _kin(name)
    places = KIN[kin]
    # each sensor fails alone
    alike = places == MUSCLES and name not in _SINGLE_MUSCLE and kin != "pressure_sensor"
    if alike and random.random() < EVERYWHERE:
        return f"{name}@{kin}"
    return f"{name}@{kin}_{places[int(random.integers(len(places)))]}"


def draw_sizes(site: str, random: np.random.Generator) -> dict[str, float]:
    """Sizes of a fault at its place, SI."""
    name, place = split(site)
    sizes = ARM_FAULTS[name].draw(random)
    return (
        {k: v * _AT_JOINT_1.get(k, 1.0) for k, v in sizes.items()} if place == "joint_1" else sizes
    )


def truth_of(site: str) -> dict[str, Any]:
    """Right answer for a fault at its place. The port is as reported."""
    name, place = split(site)
    return {**ARM_FAULTS[name].truth, "fault": site, "port": reported(place)}


def reported(place: str) -> str:
    """The name under which a place of the arm is reported: chain_21 is part of structure_2, all
    chains of structure."""
    kin, number = _kin_and_number(place)
    group = GROUP.get(kin, kin)
    return f"{group}_{number[0] if kin == 'chain' else number}" if number else group


def split(site: str) -> tuple[str, str]:
    """Fault and place."""
    name, _, place = site.partition("@")
    return name, place


def placed(faults: Mapping[str, Mapping[str, float]]) -> tuple[Planted, ...]:
    """Faults planted in each muscle (11, 12, 21, 22), in each joint and in shared parts, from the
    sizes by fault@place.

    UsageError for a fault or a place that the arm does not have, or two faults that set the same
    size at a place.
    """
    spots: list[dict[str, Mapping[str, float]]] = [{} for _ in range(7)]
    for site, sizes in faults.items():
        name, place = split(site)
        if _SHARED.get(name) == place:
            spots[6][name] = sizes
            continue
        kin, number = _kin_and_number(place)
        if name not in ARM_FAULTS or kin != _kin(name) or number not in ("", *KIN[kin]):
            raise UsageError(
                f"{site!r} cannot be planted in the arm",
                nearest(name, list(ARM_FAULTS)) or "see ARM_FAULTS",
            )
        first = 0 if KIN[kin] == MUSCLES else len(MUSCLES)
        for k, joint in enumerate(KIN[kin], start=first):
            if number in ("", joint):
                spots[k][name] = sizes
    return tuple(planted(spot) for spot in spots)


def _kin_and_number(place: str) -> tuple[str, str]:
    """angle_sensor_2 -> angle_sensor, 2; muscle -> muscle, and no number."""
    kin, _, number = place.rpartition("_")
    return (kin, number) if number.isdigit() else (place, "")


def _kin(name: str) -> str:
    return _PORT.get(name, ARM_FAULTS[name].port)
