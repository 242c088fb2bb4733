"""The mapping of a raw log: every key checked with its path, units by quantity, gauge and absolute
never guessed."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from pamid.base.errors import FileError
from pamid.base.units import unit
from pamid.intake.logs.channel_words import meanings, number
from pamid.intake.logs.channels import Channel, Log
from pamid.intake.logs.guessed_mapping import Answers, guess_of
from pamid.intake.logs.mapping import Mapping, load_mapping, mapping_of, resolved_signals
from pamid.intake.logs.source_units import in_unit, read_unit
from pamid.model.registry import rig_named

ONE_DOF = rig_named("one-dof")
ANGLE = '[signals.angle_deg]\nsource = "Winkel"\nunit = "rad"\n'
PRESSURE = '[signals.pressure_1_kpa]\nsource = "p1"\nunit = "bar"\n'


def load(folder: Path, text: str, pressures: str | None = None) -> Mapping:
    path = folder / "map.toml"
    path.write_text(text, encoding="utf-8")
    return load_mapping(path, pressures)


# ---- keys --------------------


def test_a_pressure_is_answered_by_mapping_unit_or_option(tmp_path):
    def absolute(text, pressures=None):
        return resolved_signals(load(tmp_path, text, pressures), ONE_DOF, {}, "map.toml")[
            0
        ].absolute

    assert absolute(PRESSURE + 'pressure = "absolute"') and not absolute(
        PRESSURE + 'pressure = "gauge"'
    )
    assert absolute(PRESSURE.replace("bar", "bara")) and not absolute(
        PRESSURE.replace("bar", "psig")
    )
    assert absolute(PRESSURE, "absolute") and absolute(PRESSURE + 'pressure = "?"', "absolute")
    assert not absolute(PRESSURE.replace("bar", "barg"), "absolute")
    with pytest.raises(FileError, match='but --pressures is "absolute"'):
        absolute(PRESSURE + 'pressure = "gauge"', "absolute")


def test_what_is_held_follows_the_rig_unless_the_mapping_says(tmp_path):
    names = {
        "reference_deg": "deg",
        "command": "1",
        "angle_deg": "deg",
        "external_torque_nm": "N m",
    }
    text = "".join(f'[signals.{n}]\nsource = "{n}"\nunit = "{u}"\n' for n, u in names.items())
    for rig in (ONE_DOF, None):
        held = {
            s.column: s.hold for s in resolved_signals(load(tmp_path, text), rig, {}, "map.toml")
        }
        assert held == {
            "reference_deg": True,
            "command": True,
            "angle_deg": False,
            "external_torque_nm": False,
        }
    told = resolved_signals(
        load(tmp_path, ANGLE + 'interpolation = "hold"'), ONE_DOF, {}, "map.toml"
    )[0]
    assert told.hold and told.events


# ---- units --------------------

CONVERSIONS = [
    ("bar", 2.0, "kPa", 200.0),
    ("psi", 100.0, "kPa", 689.4757293168361),
    ("psig", 100.0, "kPa", 689.4757293168361),
    ("mmHg", 760.0, "kPa", 101.325),
    ("N/mm2", 0.5, "kPa", 500.0),
    ("°C", 20.0, "K", 293.15),
    ("degF", 212.0, "degC", 100.0),
    ("rpm", 60.0, "deg/s", 360.0),
    ("U/min", 60.0, "deg/s", 360.0),
    ("rev", 0.25, "deg", 90.0),
    ("gon", 100.0, "deg", 90.0),
    ("mrad", 1000.0, "rad", 1.0),
    ("%", 50.0, "1", 0.5),
    ("N·m", 3.0, "N m", 3.0),
    ("Ncm", 100.0, "N m", 1.0),
    ("lbf", 1.0, "N", 4.4482216152605),
    ("m/s²", 2.0, "m/s2", 2.0),
    ("µs", 5.0, "s", 5e-6),
    ("[kPa]", 7.0, "kPa", 7.0),
    ("°/s", 10.0, "deg/s", 10.0),
    ("Volts", 10.0, "V", 10.0),
    ("Celsius", 20.0, "degC", 20.0),
    ("Torr", 760.0, "kPa", 101.325),
]


@pytest.mark.parametrize(
    ("text", "value", "symbol", "made"), CONVERSIONS, ids=[c[0] for c in CONVERSIONS]
)
def test_units_are_converted(text, value, symbol, made):
    assert in_unit(np.array([value]), read_unit(text), symbol)[0] == pytest.approx(made, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "mark"),
    [
        ("barg", "gauge"),
        ("bar(g)", "gauge"),
        ("bar rel", "gauge"),
        ("kPa(a)", "absolute"),
        ("bara", "absolute"),
        ("kPa abs", "absolute"),
        ("psia", "absolute"),
        ("mbara", "absolute"),
        ("kPa", ""),
        ("Pa", ""),
        ("bar", ""),
    ],
)
def test_gauge_and_absolute_are_read_from_the_unit(text, mark):
    found = read_unit(text)
    assert found.pressure == mark and found.dimension == unit("Pa").dimension


# ---- guessing --------------------


@pytest.mark.parametrize(
    ("name", "kind", "which"),
    [
        ("Sollwinkel", "reference", ""),
        ("Istwinkel", "angle", ""),
        ("Druck_1", "pressure", "1"),
        ("p2", "pressure", "2"),
        ("tlak B", "pressure", "2"),
        ("Ventil", "command", ""),
        ("angle_cmd", "reference", ""),
        ("Čas", "time", ""),
        ("ciśnienie 1", "pressure", "1"),
        ("ángulo", "angle", ""),
        ("Kraft rechts", "force", "2"),
        ("u", "command", ""),
    ],
)
def test_names_are_understood_in_several_languages(name, kind, which):
    assert kind in meanings(name) and number(name) == which


def guessed(*, p_unit: str = "bar", pressures: str | None = None) -> tuple[str, tuple[str, ...]]:
    n = 3000
    t = np.arange(n) * 3.0
    rng = np.random.default_rng(0)
    angle = 0.5 * np.sin(t / 400.0) + 1e-4 * rng.standard_normal(n)
    channels = (
        Channel("Zeit", t, None, "ms"),
        Channel('Winkel "ist"\x7f', angle, None, "rad"),
        Channel("Sollwinkel", np.round(angle, 1), None, "rad"),
        Channel("u", np.sin(t), None, ""),
        Channel("p1", 3.0 + angle, None, p_unit),
        Channel("p2", 1.01 + np.abs(angle), None, p_unit),
        Channel("Kraft links", np.where(rng.random(n) > 0.01, 500.0, np.nan), None, "V"),
        Channel("T_Raum", np.full(n, 20.0), None, "°C"),
    )
    found = guess_of(
        Log(Path("log.csv"), "csv", channels, ("decimal\ncomma",)),
        ONE_DOF,
        "one-dof",
        Answers(pressures or ""),
    )
    return found.text, found.open


def test_a_guess_is_a_mapping_with_open_questions():
    text, left = guessed()
    tables = tomllib.loads(text)
    assert {c: s["source"] for c, s in tables["signals"].items()} == {
        "reference_deg": "Sollwinkel",
        "command": "u",
        "angle_deg": 'Winkel "ist"\x7f',
        "pressure_1_kpa": "p1",
        "pressure_2_kpa": "p2",
        "force_1_n": "Kraft links",
    }
    assert tables["time"] == {
        "source": "Zeit",
        "unit": "ms",
        "period_s": 0.003,
        "max_gap_s": 0.03,
        "repair": "ask",
    }
    assert left == (
        "signals.pressure_1_kpa.pressure",
        "signals.pressure_2_kpa.pressure",
        "signals.force_1_n.unit",
    )
    assert "no absolute pressure" not in text and "101 kPa with the air off" in text  # a hint only
    assert (
        '"T_Raum"' in text
        and "of the cells empty" in text
        and "333.3 Hz" in text
        and 'loop = "closed"' in text
    )
    with pytest.raises(FileError, match=r'signals\.pressure_1_kpa\.pressure is "\?"'):
        mapping_of(tables, "map.toml")
