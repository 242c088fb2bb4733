"""An excitation takes start, centre and amplitudes from the rig and stays within its ranges."""

from pathlib import Path

import pytest
from pamid_cli import frame

from pamid.recording.recording import Recording, read_recording

MACHINE = '''"""A boiler: heater, the temperature of the room, a flow."""
from pamid import Parameter, Port, Rig, State


class Boiler(Rig):
    """A heated block in a room, cooled by water."""

    inputs = {"heater_percent": "", "room_degf": "K", "flow_ml_per_min": "m3/s"}
    outputs = {"block_degc": "K"}
    ports = {"block": Port("rate", "K/s")}
    states = (State("temperature", "K", 293.15),)
    parameters = (Parameter("capacity", 400.0, 100.0, 1000.0, "J/K", source="weighed"),)
    period_s = 2.0
    hold_s = (40.0, 240.0)
    STATED

    def rates(self, x, u, p, port):
        loss = (0.8 + 4.2e6 * u.flow_ml_per_min) * (x.temperature - u.room_degf)
        return {"temperature": port("block", (100.0 * u.heater_percent - loss) / p.capacity)}

    def measure(self, x, u, p, port):
        return {"block_degc": x.temperature}
'''
HEATER = 'excited = {"heater_percent": 30.0}'
ROOM = 'centre = {"heater_percent": 30.0, "room_degf": 72.0}'


def excite(
    capsys: pytest.CaptureFixture[str], stated: str, *words: str, code: int = 0
) -> tuple[str, Recording | None]:
    """What the command prints for a rig that states this, and the excitation."""
    Path("boiler.py").write_text(MACHINE.replace("STATED", stated.replace("; ", "\n    ")))
    capsys.readouterr()
    line = ["generate-aprbs", "--rig", "boiler.py", "--duration", "3000", "--output", "u.csv"]
    assert frame.run([*line, "--overwrite", *words]) == code
    said = capsys.readouterr()
    return (said.err, None) if code else (said.out, read_recording(Path("u.csv")))


def reach(sent: Recording | None, column: str) -> tuple[float, float]:
    assert sent is not None
    values = sent.columns[column]
    return float(values.min()), float(values.max())


def test_what_is_not_excited_stays_where_the_rig_states(here, capsys):
    said, sent = excite(capsys, f"{HEATER}; {ROOM}")
    assert reach(sent, "room_degf") == (72.0, 72.0)
    assert reach(sent, "flow_ml_per_min") == (0.0, 0.0)
    low, high = reach(sent, "heater_percent")
    assert low == 0.0 and 55.0 < high <= 60.0
    assert "room_degf is not excited: it stays at 72." in said
    assert "flow_ml_per_min is not excited: it stays at 0." in said


def test_a_swing_is_moved_into_the_range_or_refused(here, capsys):
    """A heater does not cool: about 0 it would be sent below its range."""
    stated = (
        f'{HEATER}; centre = {{"room_degf": 72.0}}; ranges = {{"heater_percent": (0.0, 100.0)}}'
    )
    said, sent = excite(capsys, stated)
    assert reach(sent, "heater_percent")[0] >= 0.0
    assert "heater_percent: centre moved from 0 to 30 to stay within 0 .. 100." in said
    for words in (("--amplitude", "60"), ("--amplitude", "20", "--offset", "10")):
        said, _ = excite(capsys, stated, *words, code=2)
        assert "heater_percent lies within 0 .. 100" in said


def test_an_excited_column_is_never_sent_outside_a_range_without_zero(here, capsys):
    stated = f'{HEATER}; {ROOM}; ranges = {{"heater_percent": (10.0, 90.0)}}'
    _, sent = excite(capsys, stated, "--amplitude", "20")
    low, high = reach(sent, "heater_percent")
    assert low >= 10.0 and high <= 50.0
