"""What `pamid check` says of recordings and rigs that somebody wrote from the documents alone."""

from pathlib import Path

import numpy as np
import pytest

import pamid
from pamid import Gain
from pamid.base.errors import FileError
from pamid.intake.checks.conformance import rig_findings
from pamid.intake.checks.recording_quality import examine
from pamid.model.port_guide import driving_words
from pamid.model.registry import rig_named
from pamid.recording.recording import Recording, match_column, recording_of

RIG = '''
from pamid import Parameter, Port, Rig, State


class Wheel(Rig):
    """A wheel that two torques turn."""

    inputs = {"drive_n_m": "N m", "brake_n_m": "N m"}
    outputs = {"speed_rad_per_s": "rad/s"}
    ports = {"axle": Port("motion", "N m", {"velocity": "rad/s", "load": "N m"})}
    states = (State("speed", "rad/s"),)
    parameters = (Parameter("inertia_kg_m2", 0.1, low=0.01, high=1.0, source="drawing"),)

    def rates(self, x, u, p, port):
        torque = port("axle", u.drive_n_m - u.brake_n_m, velocity=x.speed, load=abs(u.brake_n_m))
        return {"speed": torque / p.inertia_kg_m2}

    def measure(self, x, u, p, port):
        return {"speed_rad_per_s": x.speed}
'''


@pytest.fixture
def rig(tmp_path) -> Path:
    path = tmp_path / "wheel.py"
    path.write_text(RIG)
    return path


def test_a_rate_written_as_a_product_is_told_how_to_be_named(tmp_path, rig):
    time = 0.01 * np.arange(400)
    made = recording_of(time, {"speed_rad_s": np.sin(time), "angle_deg": np.cos(time)})
    said = pamid.check(made).summary()
    assert "'rad s'" in said and "name it 'speed_rad_per_s'" in said
    assert said.count("name it") == 1
    with pytest.raises(FileError, match="rename it 'speed_rad_per_s'"):
        match_column(list(made.columns), "speed_rad_per_s")


BENCH = """
from pamid import Parameter, Port, Rig
from pamid.equations import rate_of


class Bench(Rig):
    \'\'\'A damper whose rod is moved, its force read.\'\'\'

    inputs = {"position_mm": "m"}
    outputs = {"force_n": "N"}
    ports = {"rod": Port("motion", "N", {"position": "m", "velocity": "m/s"})}
    states = ()
    parameters = (Parameter("damping_n_s_per_m", 900.0, 0.0, 1e4, source="data sheet"),)

    def measure(self, x, u, p, port):
        speed = rate_of(u.position_mm)
        along = WAY * p.damping_n_s_per_m * speed
        along = port("rod", along, position=u.position_mm, velocity=speed)
        return {"force_n": WAY * along}
"""


@pytest.mark.parametrize(("way", "notes"), [("-1.0", 0), ("1.0", 1)])
def test_a_port_whose_damping_drives_is_pointed_at(way, notes, tmp_path):
    path = tmp_path / "bench.py"
    path.write_text(BENCH.replace("WAY", way))
    said = pamid.check(path).summary()
    assert said.count("'rod' increases with the velocity (slope 900)") == notes
    assert "nothing is wrong" in said
    time = 0.01 * np.arange(600)
    made = recording_of(
        time, {"position_mm": 10.0 * np.sin(4.0 * time), "force_n": 36.0 * np.cos(4.0 * time)}
    )
    assert pamid.check(made, rig=path).summary().count("increases with the velocity") == notes
    assert len(driving_words(rig_named(str(path)))) == notes  # as in the notes of a diagnosis


BLIND = """
from pamid import Parameter, Port, Rig, State


class Spindle(Rig):
    \'\'\'A spindle behind a motor, its speed read.\'\'\'

    inputs = {"drive_v": "V"}
    outputs = {"speed_rad_per_s": "rad/s"}
    ports = {"axle": Port("motion", "V", {"velocity": "rad/s"})}
    states = (State("speed", "rad/s"),)
    parameters = (
        Parameter("gain", 8.0, 1.0, 50.0, "rad/V/s", source="data sheet"),
        Parameter("lag_s", 0.3, low=0.01, high=3.0, source="data sheet"),
    )

    def rates(self, x, u, p, port):
        pull = port("axle", u.drive_v - x.speed / p.gain, velocity=x.speed)
        return {"speed": p.gain * pull / p.lag_s}

    def measure(self, x, u, p, port):
        return {"speed_rad_per_s": x.speed}
"""


@pytest.mark.parametrize(
    ("way", "highest", "asked", "turned"),
    [
        ("size", 3.0, True, False),
        ("minus size", 3.0, True, False),
        ("as it is", 3.0, False, False),
        # driven backwards most of the time, what it shows runs against the model, and would go with
        # it were the drive turned
        ("size", 1.5, True, False),
        ("minus", 1.5, False, True),
    ],
)
def test_a_sensor_that_never_crosses_zero_is_asked_about(way, highest, asked, turned, tmp_path):
    """And is not taken for a wrong sign."""
    path = tmp_path / "spindle.py"
    path.write_text(BLIND)
    rng = np.random.default_rng(3)
    drive = np.repeat(rng.uniform(-3.0, highest, 40), 80)
    speed = np.zeros(drive.size)
    for k in range(drive.size - 1):
        speed[k + 1] = speed[k] + 0.01 / 0.27 * (9.0 * drive[k] - speed[k])
    size = np.abs(speed)
    read = {"size": size, "minus size": -size, "as it is": speed, "minus": -speed}[way]
    read = read + 0.05 * rng.standard_normal(drive.size)
    made = recording_of(0.01 * np.arange(drive.size), {"drive_v": drive, "speed_rad_per_s": read})
    said = pamid.check(made, rig=path).summary()
    assert ("measures only the magnitude" in said) == asked and ("opposite sign" in said) == turned


def test_the_rig_on_the_page_is_one(tmp_path):
    page = (Path(__file__).resolve().parents[2] / "data" / "rigs" / "README.md").read_text()
    code = page.partition("```python\nfrom pamid import")[2].partition("```")[0]
    path = tmp_path / "lift.py"
    path.write_text("from pamid import" + code)
    said = pamid.check(path)
    assert said.to_dict()["ok"], said.summary()
    assert [f for f in said.to_dict()["findings"] if f["advice"] and not f["ok"]] == []
    assert Gain("all", tolerance=0.02).parameters[0].spread == 0.02


FAST = '''
from pamid import Parameter, Port, Rig, State


class Filter(Rig):
    """A filter of some kHz."""

    inputs = {"drive_v": "V"}
    outputs = {"output_v": "V"}
    ports = {"scope": Port("reading", "V")}
    states = (State("shown", "V"), State("slope", "V/s"))
    parameters = (Parameter("corner", 3e4, low=1e4, high=1e5, unit="1/s", source="parts"),)

    def rates(self, x, u, p, port):
        pull = p.corner * p.corner * (u.drive_v - x.shown)
        return {"shown": x.slope, "slope": pull - 0.6 * p.corner * x.slope}

    def measure(self, x, u, p, port):
        return {"output_v": port("scope", x.shown)}
'''


@pytest.mark.parametrize("stated", [False, True])
def test_a_machine_that_is_faster_than_its_clock_is_told_of_it(tmp_path, stated):
    """Without a period a rig is tried at 3 ms, at which it may run away for that alone."""
    period = "    period_s = 2e-5\n" if stated else ""
    (tmp_path / "filter.py").write_text(FAST.replace("    states =", f"{period}    states ="))
    found = rig_findings(rig_named(str(tmp_path / "filter.py")))
    bad = [f.detail for f in found if f.check == "finite" and not f.ok]
    assert bool(bad) == (not stated)
    assert any("states no period_s" in one for one in bad) == (not stated)


def test_a_winch_that_is_let_rest_is_neither_clipped_nor_frozen():
    """While nothing is sent its encoder stands still at either end; rows that were filled while it
    was driven are told."""
    sent = np.tile(np.repeat([0.7, 0.0, -0.7, 0.0], [12, 30, 12, 25]), 12)
    noise = np.random.default_rng(1).uniform(-1.0, 1.0, sent.size)
    counts = np.round(np.cumsum(sent * (2000.0 + 150.0 * noise)))
    time = 0.1 * np.arange(sent.size)

    def told(counts):
        columns = {"encoder": counts, "command": sent}
        winch = Recording("winch", Path("winch.csv"), "", time, columns, 0.1, "open")
        return {i.kind for i in examine(winch)} & {"dropped", "frozen", "clipped"}

    assert told(counts) == set()
    filled = counts.copy()
    for start in (3, 82, 161, 240):
        filled[start : start + 4] = filled[start]
    assert told(filled) == {"dropped"}
