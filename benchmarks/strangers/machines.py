"""The machines of strangers: what each lacks, and what would be a right answer.

What is right was decided by physics, before anything was run.
"""

from __future__ import annotations

import electric_machines as electric
import fluid_machines as fluid
import moving_machines as moving
from virtual import NOTHING, Stranger

OUTSIDE = "outside the catalogue: "

STRANGERS = (
    Stranger(
        "muscle-shut",
        "a hole in a pneumatic muscle, valve shut",
        ("leak",),
        ("muscle",),
        "muscle_air.py",
        fluid.muscle_shut,
        at_rest=True,
    ),
    Stranger(
        "muscle-filled",
        "a hole in a pneumatic muscle, filled and emptied",
        ("leak",),
        ("muscle",),
        "muscle_air.py",
        fluid.muscle_filled,
    ),
    Stranger(
        "belt-drives",
        "a speed sensor that is blind to the sign",
        ("saturation",),
        ("sensor",),
        "belt.py",
        electric.belt_drives,
    ),
    Stranger(
        "fluid-damper",
        "a yield force that follows the coil's voltage",
        ("friction",),
        ("damper",),
        "damper.py",
        moving.fluid_damper,
    ),
    Stranger(
        "servo-pendulum",
        "gear friction that grows with the load",
        ("friction",),
        ("joint",),
        "servo.py",
        electric.servo_pendulum,
    ),
    Stranger(
        "hot-block",
        "a heater that loses 28 % of its power",
        ("gain-drift",),
        ("heater",),
        "block.py",
        fluid.hot_block,
    ),
    Stranger(
        "quarter-car",
        "a damper three times as stiff in rebound",
        ("friction",),
        ("strut",),
        "suspension.py",
        moving.quarter_car,
    ),
    Stranger(
        "coil-stage",
        "cogging of a linear motor",
        ("cogging",),
        ("stage", "coil"),
        "stage.py",
        electric.coil_stage,
    ),
    Stranger(
        "valve-cylinder",
        "the overlap of a valve's spool, 7 and 8 %",
        ("saturation", "valve-dead-band"),
        ("valve",),
        "cylinder.py",
        fluid.valve_cylinder,
    ),
    Stranger(
        "coupled-link",
        "play in a coupling",
        ("flexible-transmission",),
        ("coupling",),
        "link.py",
        moving.coupled_link,
    ),
    Stranger(
        "water-tank",
        "a hole 6 cm above the ground",
        ("leak", "overflow"),
        ("tank",),
        "one_tank.py",
        fluid.water_tank,
    ),
    Stranger(
        "filter-circuit",
        "a diode that clips one side",
        ("saturation",),
        ("stage",),
        "circuit.py",
        electric.filter_circuit,
    ),
    Stranger(
        "aero-pendulum",
        "drag with the square of speed",
        ("drag",),
        ("pivot",),
        "propeller.py",
        moving.aero_pendulum,
    ),
    Stranger(
        "shaker-mass",
        "dry friction of a guide",
        ("friction",),
        ("mass",),
        "shaken.py",
        moving.shaker_mass,
    ),
    Stranger("plain-motor", NOTHING, (), (), "wheel.py", electric.plain_motor),
    Stranger("two-tanks", NOTHING, (), (), "tank_row.py", fluid.two_tanks),
    Stranger(
        "crank-motor",
        OUTSIDE + "an inertia that changes with the angle",
        (),
        (),
        "wheel.py",
        electric.crank_motor,
    ),
)
