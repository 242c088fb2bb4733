"""Suffixes and conversions."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pamid.base.errors import FileError
from pamid.base.units import (
    from_si,
    is_unit,
    quantity_of,
    quotient,
    split_column,
    suffix_of,
    to_si,
    unit,
    with_unit,
)

QUANTITIES = {
    "N": "force",
    "N m": "torque",
    "kPa": "pressure",
    "deg": "angle",
    "mm": "position",
    "1": "dimensionless",
    "V": "voltage",
    "rad/s": "angular velocity",
    "m/s": "velocity",
    "Hz": "frequency",
    "m2 s": "m2 s",
}

COLUMNS = {
    "time_s": ("time", "s"),
    "angle_deg": ("angle", "deg"),
    "angle_1_deg": ("angle_1", "deg"),
    "command": ("command", "1"),
    "command_1": ("command_1", "1"),
    "contraction_11": ("contraction_11", "1"),
    "pressure_1_kpa": ("pressure_1", "kPa"),
    "pressure_1": ("pressure_1", "1"),
    "pressure_1_psi": ("pressure_1_psi", "1"),
    "external_torque_nm": ("external_torque", "N m"),
    "torque_n_m": ("torque", "N m"),
    "inertia_kg_m2": ("inertia", "kg m2"),
    "damping_m2_s": ("damping", "m2 s"),
    "kp_per_deg": ("kp", "1/deg"),
    "kd_s_per_deg": ("kd", "s/deg"),
    "stiffness_n_m_per_rad": ("stiffness", "N m/rad"),
    "speed_rad_per_s": ("speed", "rad/s"),
    "conductance_m3_per_s_pa": ("conductance", "m3/(s Pa)"),
    "temperature_degc": ("temperature", "degC"),
    "mass_g_kg": ("mass_g", "kg"),
    "force_N": ("force", "N"),
    "critical_ratio": ("critical_ratio", "1"),
    "deg": ("deg", "1"),
    "_deg": ("_deg", "1"),
    "speed_per_s_per_s": ("speed_per_s", "1/s"),
    "gain_mm_per_s_per_v": ("gain", "mm/(s V)"),
    "acceleration_m_per_s_per_s": ("acceleration", "m/s2"),
    "capacity_j_per_kg_per_k": ("capacity", "J/(kg K)"),
    "flow_l_per_h": ("flow", "l/h"),
    "bessel_h": ("bessel_h", "1"),
    "x_per_per_s": ("x_per", "1/s"),
    "dose_ml": ("dose", "ml"),
    "power_kw": ("power", "kW"),
}


@pytest.mark.parametrize(("name", "parts"), COLUMNS.items())
def test_split_column(name, parts):
    assert split_column(name) == parts


SYMBOLS = sorted({symbol for _, symbol in COLUMNS.values()} | {"m2", "cm3", "rad/s", "K", "degF"})


@pytest.mark.parametrize("symbol", SYMBOLS)
def test_every_symbol_survives_the_way_through_a_name(symbol):
    assert split_column(with_unit("thing", symbol)) == ("thing", symbol)


FACTORS = {
    "deg": math.pi / 180,
    "kPa": 1e3,
    "bar": 1e5,
    "cm3": 1e-6,
    "l": 1e-3,
    "ms": 1e-3,
    "1/deg": 180 / math.pi,
    "s/deg": 180 / math.pi,
    "deg/s": math.pi / 180,
    "l/(min bar)": 1e-3 / 60 / 1e5,
    "N*m": 1.0,
    "mbar": 1e2,
    "MPa": 1e6,
    "mm": 1e-3,
    "cm": 1e-2,
    "um": 1e-6,
    "us": 1e-6,
    "min": 60.0,
    "mrad": 1e-3,
    "g": 1e-3,
    "kN": 1e3,
    "mA": 1e-3,
    "mV": 1e-3,
    "percent": 1e-2,
    "J": 1.0,
    "W": 1.0,
    "kW": 1e3,
    "kJ": 1e3,
    "kHz": 1e3,
    "hPa": 1e2,
    "ml": 1e-6,
    "l/h": 1e-3 / 3600,
}


@pytest.mark.parametrize(("symbol", "factor"), FACTORS.items())
def test_factor(symbol, factor):
    assert to_si(1.0, symbol) == pytest.approx(factor, rel=1e-14)
    np.testing.assert_allclose(to_si(np.array([0.0, 2.0]), symbol), [0.0, 2 * factor], rtol=1e-14)


@pytest.mark.parametrize(
    ("written", "symbol", "factor"),
    [
        ("m/s^2", "m/s2", 1.0),
        ("m s^-2", "m/s2", 1.0),
        ("rad/s²", "rad/s2", 1.0),
        ("kg m^2", "kg m2", 1.0),
        ("kgm2", "kg m2", 1.0),
        ("kgcm^2", "kg cm2", 1e-4),
        ("Nm", "N m", 1.0),
        ("N*m", "N m", 1.0),
        ("N·m", "N m", 1.0),
        ("mNm", "mN m", 1e-3),
        ("Nmm", "N mm", 1e-3),
        ("Nm/rad", "N m/rad", 1.0),
        ("Nms/rad", "N m s/rad", 1.0),
        ("Nms", "N m s", 1.0),
        ("Nm/(rad/s)", "N m s/rad", 1.0),
        ("Vs/rad", "V s/rad", 1.0),
        ("mAh", "mA h", 3.6),
        ("kV", "kV", 1e3),
        ("°F", "degF", 1.0 / 1.8),
        ("°C", "degC", 1.0),
    ],
)
def test_a_unit_is_read_as_people_write_it(written, symbol, factor):
    """Units run together are the quantity that they make; "Nms" is not N ms."""
    read = unit(written)
    assert (read.symbol, read.factor) == (symbol, pytest.approx(factor, rel=1e-14))
    assert read.dimension == unit(symbol).dimension and read.suffix == suffix_of(symbol)


@pytest.mark.parametrize(
    "symbol",
    ["psi", "bananas", "hmm", "mass", "1^2", "N mm2x", "kPA", "m/(s", "N//m", "m-2", "2", "N (m"],
)
def test_unknown_symbols_are_refused(symbol):
    assert not is_unit(symbol)
    with pytest.raises(FileError, match="is not a unit"):
        unit(symbol)


@given(st.sampled_from(SYMBOLS), st.floats(-1e6, 1e6))
def test_there_and_back(symbol, value):
    assert from_si(to_si(value, symbol), symbol) == pytest.approx(value, rel=1e-12, abs=1e-9)


def test_temperature_has_an_offset_except_in_a_product():
    assert to_si(20.0, "degC") == 293.15
    assert from_si(293.15, "degC") == pytest.approx(20.0)
    assert to_si(1.0, "N/degC") == 1.0


@pytest.mark.parametrize(("symbol", "quantity"), QUANTITIES.items())
def test_quantity(symbol, quantity):
    assert quantity_of(symbol) == quantity


def test_a_rate_of_temperature_keeps_the_size_of_its_degree():
    assert quotient("degC", "s") == "K/s" and quotient("degF", "s") == "degF/s"
    assert to_si(1.8, "degF/s") == pytest.approx(1.0)
    assert to_si(212.0, "degF") == pytest.approx(373.15)
    assert split_column("tc_degF") == ("tc", "degF")
    assert split_column("heater_pct") == ("heater", "percent")
