"""Stores that fill and empty, of air, water or heat: their true equations and recordings."""

from __future__ import annotations

import math

import numpy as np
from virtual import Columns, clock, free_run, levels, read, rough, swept

ATMOSPHERE_KPA = 101.3


# ---- a pneumatic muscle with a hole, valve shut or filling ---------------------------------------


def _choked(upstream: float, downstream: float) -> float:
    """Share of the choked mass flow through a hole, after ISO 6358 with b = 0.3."""
    ratio = min(downstream / max(upstream, 1.0), 1.0)
    return 1.0 if ratio <= 0.3 else math.sqrt(max(1.0 - ((ratio - 0.3) / 0.7) ** 2, 1e-9))


def _muscle(
    seed: int, valve: np.ndarray, period_s: float, fine: int, start_kpa: float, hole: float
) -> Columns:
    random = np.random.default_rng(seed)

    def rates(x: list[float], u: list[float], t: float) -> list[float]:
        gauge = x[0]
        air = gauge + ATMOSPHERE_KPA
        volume = 1.0 + 0.03 * gauge / 600.0  # the muscle fattens
        out = hole * air * _choked(air, ATMOSPHERE_KPA) if gauge > 0.0 else 0.0
        supply = 590.0 * (1.0 - 0.02 * math.sin(0.05 * t))
        fill = max(u[0], 0.0) * (supply - gauge) / 0.9
        vent = max(-u[0], 0.0) * gauge / 1.5
        return [(fill - vent - out) / (volume + 0.03 * air / 600.0)]

    pressure = free_run(rates, [start_kpa], valve, period_s, fine)[:, 0]
    seen = read(random, 1.004 * pressure + 0.8, 0.25, 0.244, drift=0.6)
    return {"time_s": clock(len(valve), period_s), "valve": valve, "pressure_kpa": seen}


def muscle_shut(lacking: float) -> list[Columns]:
    """Two decays from another pressure each, 2 Hz, some minutes."""
    return [
        _muscle(11, np.zeros(900), 0.5, 4, 545.0, 0.011 * lacking),
        _muscle(12, np.zeros(700), 0.5, 4, 380.0, 0.011 * lacking),
    ]


def muscle_filled(lacking: float) -> list[Columns]:
    """Filled and emptied by pulses, waited for in between, 10 Hz."""
    out = []
    for seed in (13, 14):
        random = np.random.default_rng(100 + seed)
        valve = np.zeros(1500)
        k = 20
        while k < len(valve):
            n = int(random.integers(4, 14))
            valve[k : k + n] = 1.0 if random.random() < 0.6 else -1.0
            k += n + int(random.integers(20, 90))
        out.append(_muscle(seed, valve, 0.1, 10, 5.0, 0.035 * lacking))
    return out


# ---- tanks ---------------------------------------------------------------------------------------


def _tank(seed: int, samples: int, hole: float) -> Columns:
    """One tank with pump and outlet valve; the hole is 6 cm above the ground."""
    random = np.random.default_rng(seed)
    pump = levels(random, samples, (25, 90), 1.5, 9.0)
    valve = levels(random, samples, (30, 120), 0.25, 0.95)
    pumped = rough(random, 0.0, 10.0, 0.015)

    def rates(x: list[float], u: list[float], t: float) -> list[float]:
        height = max(x[0], 0.0)
        inflow = 0.0021 * max(x[1], 0.0) * pumped(x[1])
        outflow = 0.0335 * u[1] * max(height, 1e-6) ** 0.51
        lost = hole * math.sqrt(max(height - 0.06, 0.0))
        return [inflow - outflow - lost, (u[0] - x[1]) / 0.7]

    height = free_run(rates, [0.12, 2.0], np.column_stack([pump, valve]), 2.0, 4)[:, 0]
    return {
        "time_s": clock(samples, 2.0),
        "pump_v": pump,
        "valve": valve,
        "level_cm": read(random, 100.0 * height, 0.08, 0.02, drift=0.1),
    }


def water_tank(lacking: float) -> list[Columns]:
    """An hour and a half, and another hour."""
    return [_tank(21, 1500, 0.0065 * lacking), _tank(22, 1000, 0.0065 * lacking)]


def two_tanks(lacking: float) -> list[Columns]:
    """Two tanks in a row, nothing missing: rough pump, an outlet exponent of 0.51."""
    out = []
    for seed, samples in ((23, 1200), (24, 900)):
        random = np.random.default_rng(seed)
        pump = levels(random, samples, (20, 90), 1.5, 7.5)
        pumped = rough(np.random.default_rng(230), 0.0, 10.0, 0.02)

        def rates(x: list[float], u: list[float], t: float, pumped=pumped) -> list[float]:
            through = 0.0106 * max(x[0], 1e-6) ** 0.51
            return [
                0.00082 * u[0] * pumped(u[0]) - through,
                through - 0.0094 * max(x[1], 1e-6) ** 0.51,
            ]

        height = free_run(rates, [0.08, 0.1], pump, 2.0, 4)
        out.append(
            {
                "time_s": clock(samples, 2.0),
                "pump_v": pump,
                "upper_cm": read(random, 100.0 * height[:, 0], 0.06, 0.02),
                "lower_cm": read(random, 100.0 * height[:, 1], 0.06, 0.02, drift=0.08),
            }
        )
    return out


# ---- a heated block ------------------------------------------------------------------------------


def hot_block(lacking: float) -> list[Columns]:
    """The heater's resistance rises as it bakes: its power falls by 28 %, with 25 min.

    Radiation, a thermocouple with a lag of 2 s, a room that warms by a degree.
    """
    out = []
    for seed, samples in ((31, 1400), (32, 1100)):
        random = np.random.default_rng(seed)
        heater = np.round(levels(random, samples, (30, 120), 0.0, 100.0))
        room = 21.0 + np.cumsum(random.normal(0.0, 0.01, samples)) + np.linspace(0, 1.0, samples)

        def rates(x: list[float], u: list[float], t: float) -> list[float]:
            given = 0.62 * u[0] * (1.0 - 0.28 * lacking * (1.0 - math.exp(-t / 1500.0)))
            above = x[0] - u[1]
            lost = 0.43 * above + 1.5e-4 * above * abs(above)
            return [(given - lost) / 212.0, (x[0] - x[1]) / 2.0]

        block = free_run(rates, [21.0, 21.0], np.column_stack([heater, room]), 5.0, 4, held=True)[
            :, 1
        ]
        out.append(
            {
                "time_s": clock(samples, 5.0),
                "heater_percent": heater,
                "ambient_degc": read(random, room, 0.05, 0.1),
                "block_degc": read(random, block, 0.05, 0.1, drift=0.1),
            }
        )
    return out


# ---- a hydraulic cylinder behind a valve ---------------------------------------------------------


def valve_cylinder(lacking: float) -> list[Columns]:
    """The spool overlaps its ports by 7 and 8 %; flow with the root of the pressure drop."""
    out = []
    for seed, samples in ((41, 3000), (42, 2000)):
        random = np.random.default_rng(seed)
        time = clock(samples, 0.01)
        wanted = levels(random, samples, (60, 200), 60.0, 240.0) + 6.0 * swept(time, 0.2, 1.5)
        opened = rough(np.random.default_rng(410), -60.0, 60.0, 0.02)

        def rates(x: list[float], u: list[float], t: float, opened=opened) -> list[float]:
            spool, rate, _, flow = x
            up, down = 7.0 * lacking, 8.0 * lacking
            past = spool - up if spool > up else spool + down if spool < -down else 0.0
            wish = (5.0 if past > 0.0 else 5.15) * past * opened(spool)
            w = 2.0 * math.pi * 28.0
            return [rate, w * w * (u[0] - spool) - 1.6 * w * rate, flow, (wish - flow) / 0.012]

        def control(row: list[float], x: list[float]) -> list[float]:
            sent = min(max(0.75 * (row[0] - x[2]), -60.0), 60.0)
            return [round(sent / 0.05) * 0.05]

        moved = free_run(rates, [0.0, 0.0, 150.0, 0.0], wanted, 0.01, 4, control=control)[:, 2]
        out.append(
            {
                "time_s": time,
                "valve_percent": wanted,
                "position_mm": read(random, moved, 0.05, 0.05),
            }
        )
    return out
