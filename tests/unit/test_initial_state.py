"""Windows begin in the state that their readings show, and are as short as growing errors allow."""

from functools import cache

import mechanisms
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pamid.base.arrays import Array
from pamid.base.errors import ConvergenceError
from pamid.engine.program import Stepping
from pamid.engine.symbolic.vocabulary import cos, sin
from pamid.estimation.grey_box import fit_model
from pamid.model.assembly import Assembly
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.rig import Port, Rig
from pamid.recording.recording import Recording, recording_of
from pamid.simulation.data_split import FIT_WINDOW, split_recordings
from pamid.simulation.error_growth import GROWTH_LIMIT, growth_time_s
from pamid.simulation.free_runs import free_run
from pamid.simulation.initial_state import WindowStart
from pamid.simulation.rig_data import data_of
from pamid.simulation.tracks import track_of
from pamid.simulation.windows import Runner, Window

PERIOD_S, SAMPLES, NOISE, RATE = 0.01, 400, 1e-4, 6.0
FAR = np.array([2.0, 0.5, 14.0, -18.0])  # a state far from the rig's start
SWING = 4.0  # rad/s2 of the torque
FLOWN_NOISE = 1e-3  # m, and of a quaternion


class LinkedPendulums(Rig):
    """Two inverted pendulums, read through a linkage: neither output is a state."""

    inputs = {"torque": ""}
    outputs = {"sum": "", "slider": ""}
    ports = {"hinge": Port("motion", "", ("velocity",))}
    states = (State("a"), State("b"), State("a_rate"), State("b_rate"))
    parameters = (Parameter("steepness", RATE**2, 1.0, 100.0, spread=0.1, source="length"),)
    period_s = PERIOD_S

    def rates(self, x, u, p, port):
        torque = port("hinge", u.torque, velocity=x.a_rate)
        pull = 9.0 * sin(x.a - x.b)
        return {
            "a": x.a_rate,
            "b": x.b_rate,
            "a_rate": p.steepness * sin(x.a) + torque - pull,
            "b_rate": p.steepness * sin(x.b) + pull,
        }

    def measure(self, x, u, p, port):
        return {"sum": x.a + x.b, "slider": x.a + 0.3 * cos(x.b)}


class Unstable(Rig):
    """A state that grows by itself at a rate; what is sent holds it back."""

    inputs = {"push": ""}
    outputs = {"read": ""}
    ports = {"drive": Port("command", "", ())}
    states = (State("place"),)
    parameters = (Parameter("rate", 3.0, -50.0, 100.0, spread=0.1, source="bench"),)
    period_s = PERIOD_S

    def rates(self, x, u, p, port):
        return {"place": p.rate * x.place + port("drive", u.push)}

    def measure(self, x, u, p, port):
        return {"read": x.place}


@cache
def swung() -> tuple[Recording, Assembly, Array]:
    """A recording of the pendulums from `FAR` on, their model, and its noiseless outputs."""
    model = Assembly(LinkedPendulums())
    random = np.random.default_rng(1)
    torque = SWING * np.repeat(random.uniform(-1.0, 1.0, SAMPLES // 20), 20)
    true = free_run(
        model, torque[:, None], model.values(), PERIOD_S, start=FAR, stepping=Stepping(2)
    ).outputs
    read = true + NOISE * random.standard_normal(true.shape)
    columns = {"torque": torque, "sum": read[:, 0], "slider": read[:, 1]}
    return recording_of(PERIOD_S * np.arange(SAMPLES), columns, name="swung"), model, true


def test_start_is_found_far_from_the_rest_through_a_known_map():
    """From the rig's start no derivative over the whole window leads to the state that was read."""
    recording, model, true = swung()
    track = track_of(model, data_of(model.rig, recording), ("sum", "slider"))
    runner = Runner(model, track, Stepping(2))
    memory = runner.memory(track.p)
    window = Window(0, 120)
    x, usable = WindowStart.of(
        runner, memory, window, track.p, np.full(2, 1.0 / NOISE), memory.x.copy()
    ).estimate()
    assert usable
    assert x == pytest.approx(FAR, abs=0.01)
    runner.enter(memory, x)
    Y, _, _ = runner.run(memory, window, track.p, False)
    assert np.abs(Y - true[:120]).max() < 5.0 * NOISE


FLYER = """<mujoco model="flyer">
  <option timestep="0.001" integrator="RK4"/>
  <worldbody><body name="flyer">
    <freejoint name="fly"/>
    <inertial pos="0.01 0 0.02" mass="1.2" diaginertia="0.02 0.03 0.025"/>
    <site name="left" pos="0.1 0.1 0"/><site name="right" pos="-0.1 -0.1 0"/>
  </body></worldbody>
  <actuator>
    <motor name="left" site="left" gear="0 0 1 0 0 0.1"/>
    <motor name="right" site="right" gear="0 0 1 0 0 -0.1"/>
  </actuator>
  <sensor>
    <framepos name="place" objtype="xbody" objname="flyer"/>
    <framequat name="attitude" objtype="xbody" objname="flyer"/>
  </sensor>
</mujoco>
"""


def flown(rig: Rig, sign: float, random: np.random.Generator) -> Recording:
    """A flight of MuJoCo's own from any yaw and roll, whose quaternion is read with this sign."""
    mujoco = mechanisms.needs_mujoco()
    machine = mujoco.MjModel.from_xml_string(FLYER)
    data, states = mujoco.MjData(machine), []
    # far from where its nose points straight up or down
    angles = random.uniform([-np.pi, -0.8, -np.pi], [np.pi, 0.8, np.pi])
    data.qpos[:3] = random.uniform(-3.0, 3.0, 3)
    data.qpos[3:] = Rotation.from_euler("ZYX", angles).as_quat(scalar_first=True)
    data.qvel[:] = random.uniform(-1.0, 1.0, 6)
    sent = np.full((50, 2), [6.0, 6.2])
    for row in sent:
        states.append(data.qpos * [1.0, 1.0, 1.0, sign, sign, sign, sign])
        data.ctrl[:] = row
        mujoco.mj_step(machine, data, round(PERIOD_S / machine.opt.timestep))
    read = np.array(states) + FLOWN_NOISE * random.standard_normal((len(sent), 7))
    columns = dict(zip([*rig.inputs, *rig.outputs], np.hstack([sent, read]).T, strict=True))
    return recording_of(PERIOD_S * np.arange(len(sent)), columns, name="flown")


def test_a_base_that_flies_begins_in_the_attitude_that_was_read(tmp_path):
    """The rig starts level; a quaternion of either sign is the same attitude."""
    mechanisms.needs_mujoco()
    model = Assembly(mechanisms.rig_from(FLYER, tmp_path))
    assert list(model.rig.outputs)[2:4] == ["place_z_m", "attitude_qw"]
    random, weight = np.random.default_rng(11), np.full(7, 1.0 / FLOWN_NOISE)
    for sign in 10 * (1.0, -1.0):
        recording = flown(model.rig, sign, random)
        track = track_of(model, data_of(model.rig, recording), tuple(model.rig.outputs))
        runner, window = Runner(model, track, Stepping(2)), Window(0, len(track.y))
        memory = runner.memory(track.p)
        x, usable = WindowStart.of(
            runner, memory, window, track.p, weight, memory.x.copy()
        ).estimate()
        runner.enter(memory, x)
        Y, _, _ = runner.run(memory, window, track.p, False)
        left = np.sqrt(np.mean((Y - track.y) ** 2))
        assert usable and left < 1.2 * FLOWN_NOISE


def held_back(rate: float, period_s: float = PERIOD_S, noise: float = NOISE) -> Recording:
    """A recording of a state of this rate, held by a controller while it is disturbed."""
    random, samples = np.random.default_rng(2), 600
    a = np.exp(rate * period_s)
    b = (a - 1.0) / rate
    place, read, push = 0.0, np.zeros(samples), np.zeros(samples)
    for k in range(samples):
        read[k] = place + noise * random.standard_normal()
        push[k] = -(a - 0.7) / b * place + rate * np.sign(np.sin(0.05 * k))
        place = a * place + b * push[k]
    return recording_of(period_s * np.arange(samples), {"push": push, "read": read}, name="held")


@pytest.mark.parametrize("rate", [-20.0, -1.0, 15.0, 30.0])
def test_growth_time_is_that_of_the_exponential(rate):
    """exp(rate t)/exp(rate t/2) reaches the limit at 2 ln(limit)/rate; what decays, never."""
    model = Assembly(Unstable())
    track = track_of(model, data_of(model.rig, held_back(rate)), ("read",))
    track.p[model.index_of("rate")] = rate
    expected = 2.0 * np.log(GROWTH_LIMIT) / rate if rate > 0.0 else np.inf
    found = growth_time_s(model, [track], np.array([NOISE]), 1.0)
    assert found == pytest.approx(min(expected, 1.0), abs=2.0 * PERIOD_S)


def test_windows_of_a_model_whose_errors_grow_are_shorter():
    """The same recording, as a model that decays and as one that grows would explain it."""
    recording = held_back(30.0)
    splits = []
    for rate in (-1.0, 30.0):
        rig = Unstable()
        rig.parameters = (Parameter("rate", rate, -50.0, 100.0, spread=0.1, source="bench"),)
        splits.append(split_recordings(rig, [recording], []))
    decaying, growing = splits
    assert growing.correlation_s == decaying.correlation_s == decaying.timescale_s
    limit = 2.0 * np.log(GROWTH_LIMIT) / 30.0
    assert FIT_WINDOW * growing.timescale_s == pytest.approx(limit, abs=2.0 * PERIOD_S)
    assert FIT_WINDOW * decaying.timescale_s > 1.5 * limit


def test_a_floor_beyond_all_that_moved_is_refused():
    """Errors grow 1e9-fold within the shortest window, so that no comparison could be decided."""
    rig = Unstable()
    rig.parameters = (Parameter("rate", 50.0, 1.0, 100.0, spread=0.1, source="bench"),)
    evidence = split_recordings(rig, [held_back(50.0, 0.01, 0.05)], [])
    with pytest.raises(ConvergenceError, match="moves by only .* cannot predict") as raised:
        fit_model(evidence)
    assert (raised.value.exit_code, raised.value.code) == (5, "unpredictable")
    assert "sample it faster" in raised.value.hint
