"""Shapes of an error by which people search for its cause."""

from __future__ import annotations

#: name -> as a sentence
SYMPTOMS = {
    "lags": "The machine lags behind the model",
    "stops-short": "It stops short of the target",
    "rings": "It overshoots and rings",
    "direction": "The error depends on the direction",
    "reversals": "The error jumps or pauses at reversals",
    "speed": "Right at one speed, wrong at another",
    "position": "Right in the middle, wrong at the ends",
    "load": "Right without load, wrong under load",
    "history": "The error depends on what happened before",
    "drifts": "It drifts with time or heat",
    "saturates": "It saturates",
    "one-frequency": "It buzzes or ripples at one frequency",
    "steps": "It moves or reads in steps",
    "constant-error": "It is off by a constant or a fixed share",
    "level": "A level, pressure or temperature falls or rises by itself",
}
