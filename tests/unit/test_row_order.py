"""Readings that a log holds in another row than their own: seen, named with the cure, and cured."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from virtual_recordings import virtual_recording

import pamid
from pamid.diagnosis.verdict.notes import _row_order
from pamid.intake.checks.sampling_slips import OF_THE_LOG, RowOrder, misplaced_readings
from pamid.intake.logs.channels import Channel, Log
from pamid.intake.logs.conversion import convert
from pamid.intake.logs.mapping import mapping_of
from pamid.model.between_samples import as_recorded, stated
from pamid.model.registry import rig_named
from pamid.recording.recording import Recording, recording_of

PERIOD_S = 0.002
SAMPLES = 3000
ANGLES = {"dc-motor": ("angle_deg",), "geared-motor": ("motor_angle_deg", "load_angle_deg")}


def driven(name: str, *effects: str, before: bool = False) -> dict[str, np.ndarray]:
    """Columns of a motor under steps of its voltage, with the data sheet's noise."""
    random = np.random.default_rng(4)
    voltage = np.repeat(random.uniform(-12.0, 12.0, SAMPLES // 25), 25)
    t = PERIOD_S * np.arange(SAMPLES)
    rig = stated(rig_named(name), {"current_a": "before"} if before else {})
    off = {"resistance_ohm": 1.1, "inertia_kg_m2": 0.025}
    made = virtual_recording(rig, {"voltage_v": voltage}, PERIOD_S, *effects, true=off, seed=3)
    return {"time_s": t, **made.columns}


def logged(columns: dict[str, np.ndarray], rows: int = 0, **between: str) -> Recording:
    """The columns as a recording whose current stands so many rows late."""
    moved = {**columns, "current_a": np.roll(columns["current_a"], rows)}
    cut = {name: values[2:-2] for name, values in moved.items()}
    time = cut.pop("time_s")
    return recording_of(time - time[0], cut, {"between": between} if between else {})


def found(recording: Recording, name: str) -> list[RowOrder]:
    return misplaced_readings(recording, as_recorded(rig_named(name), [recording]))


@pytest.mark.parametrize("name", list(ANGLES))
@pytest.mark.parametrize(
    ("rows", "order", "cure"),
    [
        (1, "late", "rows = 1 below [signals.current_a] in the mapping of `pamid ingest`"),
        (-1, "early", "rows = -1 below [signals.current_a] in the mapping"),
    ],
)
def test_a_current_in_another_row_is_the_log(name, rows, order, cure):
    recording = logged(driven(name), rows)
    (one,) = found(recording, name)
    assert one.column == "current_a" and order in one.orders
    assert one.corrected < 0.3 * one.as_recorded
    text = one.text(recording)
    assert OF_THE_LOG in text and cure in text


@pytest.mark.parametrize("name", list(ANGLES))
def test_a_current_read_before_its_command_is_cured_by_one_line(name):
    columns = driven(name, before=True)
    (one,) = found(logged(columns), name)
    assert "before" in one.orders
    assert '[between] current_a = "before"' in one.text(logged(columns))
    assert found(logged(columns, current_a="before"), name) == []


@pytest.mark.parametrize(
    "effect", ["", "dead-time@ammeter:delay_s=0.006", "first-order-lag@ammeter"]
)
def test_neither_right_rows_nor_a_slow_sensor_are_the_log(effect):
    recording = logged(driven("dc-motor", *[effect] * bool(effect)))
    assert found(recording, "dc-motor") == []


@pytest.mark.parametrize("rows", [1, -1, 2])
def test_a_mapping_moves_a_channel_by_rows(rows):
    t = 0.01 * np.arange(200)
    sent, read = np.sin(3.0 * t), np.cos(5.0 * t)
    values = {"t": t, "u": sent, "i": np.roll(read, rows)}
    log = Log(Path("log.csv"), "csv", tuple(Channel(n, v, None, "") for n, v in values.items()))
    signals = {
        "voltage_v": {"source": "u", "unit": "V"},
        "current_a": {"source": "i", "unit": "A", "rows": rows},
    }
    tables: dict[str, Any] = {"time": {"source": "t", "unit": "s"}, "signals": signals}
    (made,) = convert(log, mapping_of(tables, "map"), None, "map").recordings
    first = round(made.begins_s / 0.01)
    count = made.time.size
    assert 200 - 2 * abs(rows) <= count < 200
    np.testing.assert_allclose(made.columns["current_a"], read[first : first + count], atol=1e-9)
    np.testing.assert_allclose(made.columns["voltage_v"], sent[first : first + count], atol=1e-9)


def test_answer_and_check_state_the_order_with_its_cure():
    recording = logged(driven("dc-motor"), -1)
    rows = [f for f in pamid.check(recording, "dc-motor").findings if f.check == "rows"]
    assert len(rows) == 1 and rows[0].advice and "rows = -1" in rows[0].detail
    model = SimpleNamespace(
        assembly=SimpleNamespace(parameters=()), fit=SimpleNamespace(p=()), attached=()
    )
    evidence = SimpleNamespace(rig=rig_named("dc-motor"), recordings=[recording])
    d: Any = SimpleNamespace(
        answer=SimpleNamespace(model=model), verdict="explained", evidence=evidence
    )
    (note,) = _row_order(d)
    assert OF_THE_LOG in note and note.endswith("Then diagnose again.")
    d.verdict = "no-structural-gap"
    assert _row_order(d) == []
