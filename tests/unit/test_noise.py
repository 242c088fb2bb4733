"""The step and the noise of a channel, read back from channels whose step and noise are known."""

from pathlib import Path

import numpy as np
import pytest

from pamid.base.arrays import Array
from pamid.model.registry import rig_named
from pamid.recording.noise import noise_level, plateaus, quantisation_step, sensor_noise
from pamid.recording.recording import read_recording
from pamid.simulation.data_split import split_recordings
from pamid.simulation.tracks import stated_noise

CART = str(Path(__file__).resolve().parents[2] / "data" / "rigs" / "cart.py")

PERIOD_S, SAMPLES = 0.003, 5000
TIME = np.arange(SAMPLES) * PERIOD_S
ROUNDING = 1.0 / np.sqrt(12.0)
RANGE = 100.0
MOTIONS = {
    "slow": 30.0 * np.sin(0.3 * TIME + 0.3) + 5.0 * np.sin(0.8 * TIME),
    "fast": 35.0 * np.sin(19.0 * TIME) + 10.0 * np.sin(46.0 * TIME + 1.0),
    "holds": 30.0 * np.tanh(8.0 * np.sin(1.3 * TIME)) + 4.0 * np.tanh(5.0 * np.sin(2.9 * TIME)),
}
#: step, and what the file holds of a value
CHANNELS = {
    "8 bits": (RANGE / 2**8, lambda y, step: digits(np.floor(y / step) * step + 0.5 * step)),
    "10 bits": (RANGE / 2**10, lambda y, step: digits(np.floor(y / step) * step + 0.5 * step)),
    "12 bits": (RANGE / 2**12, lambda y, step: digits(np.floor(y / step) * step + 0.5 * step)),
    "12 bits, three decimals": (
        RANGE / 2**12,
        lambda y, step: np.round(np.round(y / step) * step, 3),
    ),
    "12 bits, single precision": (
        RANGE / 2**12,
        lambda y, step: np.float32(np.round(y / step) * step).astype(float),
    ),
    "encoder of 2048": (360.0 / 2048, lambda y, step: digits(np.round(y / step) * step)),
    "encoder of 4096, an offset": (
        360.0 / 4096,
        lambda y, step: digits(np.round(y / step) * step + 1.23456789),
    ),
    "encoder of 4096, two decimals": (
        360.0 / 4096,
        lambda y, step: np.round(np.round(y / step) * step, 2),
    ),
    "two decimals": (0.01, lambda y, step: np.round(y, 2)),
}


def digits(y: Array, count: int = 9) -> Array:
    """As a file with so many significant digits has it."""
    return np.array((f"%.{count}g " * y.size % tuple(y.tolist())).split(), dtype=float)


@pytest.mark.parametrize("channel", CHANNELS)
@pytest.mark.parametrize("motion", MOTIONS)
def test_the_step_is_found_and_the_noise_is_never_below_it(motion, channel):
    """Noise-free, a tenth of a step of noise, a third, one, three: what a reading is off by, in any
    unit."""
    step, written = CHANNELS[channel]
    random = np.random.default_rng(7)
    for share in (0.0, 0.1, 0.35, 1.0, 3.0):
        y = written(MOTIONS[motion] + share * step * random.standard_normal(SAMPLES), step)
        off = np.hypot(share, ROUNDING) * step
        assert quantisation_step(y) == pytest.approx(step, rel=0.01)
        found = noise_level(y[:, None])[0]
        assert 0.8 * off < found < 1.25 * off, share
        for unit in (np.pi / 180.0, 1e3, -1e-6):
            assert noise_level(unit * y[:, None])[0] == pytest.approx(abs(unit) * found, rel=1e-9)


@pytest.mark.parametrize("motion", MOTIONS)
def test_white_noise_is_found_where_nothing_is_quantised(motion):
    y = MOTIONS[motion] + 0.05 * np.random.default_rng(3).standard_normal(SAMPLES)
    assert quantisation_step(digits(y)) == 0.0
    assert noise_level(digits(y)[:, None])[0] == pytest.approx(0.05, rel=0.1)


#: rad per sample: a swing of 70 Hz that is sampled at 610 Hz is at 0.72
@pytest.mark.parametrize("pace", [0.0, 0.01, 0.2, 0.72])
@pytest.mark.parametrize("share", [0.0, 2.0])
@pytest.mark.parametrize("samples", [1000, 20000])
def test_a_tone_is_no_noise(pace, share, samples):
    """White noise alone, beside a slow and a fast swing, in a converter of twice its size."""
    random = np.random.default_rng(11)
    noise, swing = 0.01, 50.0 * np.sin(pace * np.arange(samples) + 0.4)
    y = swing + noise * random.standard_normal(samples)
    off = noise
    if share:
        y = np.round(y / (share * noise)) * share * noise
        off = noise * np.hypot(1.0, share * ROUNDING)
    assert noise_level(y[:, None])[0] == pytest.approx(off, rel=0.2)
    assert sensor_noise([y[:, None]], np.array([1.0])).used[0] == pytest.approx(off, rel=0.2)


def test_what_the_rig_states_is_the_least_where_neither_noise_nor_steps_show():
    random = np.random.default_rng(5)
    smooth = MOTIONS["slow"][:, None]
    filtered = (
        smooth
        + np.convolve(random.standard_normal(SAMPLES + 99), 0.01 * np.hanning(100), "valid")[
            :, None
        ]
    )
    better = smooth + 0.01 * random.standard_normal(SAMPLES)[:, None]
    stated = np.array([0.05])
    assert (
        sensor_noise([smooth], stated).used[0] == sensor_noise([filtered], stated).used[0] == 0.05
    )
    assert (
        sensor_noise([better], stated).used[0]
        == noise_level(better)[0]
        == pytest.approx(0.01, rel=0.1)
    )
    for step in (0.5, 0.01):
        assert sensor_noise([np.round(smooth / step) * step], stated).used[0] == pytest.approx(
            step * ROUNDING, rel=0.05
        )
    rig = rig_named("one-dof")
    assert stated_noise(rig, ("angle_deg", "force_1_n")) == pytest.approx([np.radians(0.05), 3.0])
    assert not stated_noise(rig_named(CART), ("position_m",)).any()


def clinging(values: Array, step: float, seed: int) -> Array:
    """A gauge that stands until the quantity is half a step to one and a half steps away."""
    random, shown, reading = np.random.default_rng(seed), values[0], np.empty_like(values)
    reach = step
    for k, value in enumerate(values):
        if abs(value - shown) > reach:
            shown, reach = value, step * random.uniform(0.5, 1.5)
        reading[k] = shown
    return reading


@pytest.mark.parametrize("step", [0.2, 0.3, 0.6])
@pytest.mark.parametrize("averaged", [1, 6])
def test_a_gauge_that_clings_lags_by_as_much_as_it_leaps(step, averaged):
    """A tank drains; the logger averages so many readings."""
    level = 22.5 * (1.0 - 0.9 * np.linspace(0.0, 1.0, 840 * averaged)) ** 2
    reading, true = (
        x.reshape(-1, averaged).mean(axis=1) for x in (clinging(level, step, 3), level)
    )
    off = float(np.sqrt(np.mean((reading - true) ** 2)))
    noise = sensor_noise([reading[:, None]], np.zeros(1))
    assert noise.used[0] == pytest.approx(off, rel=0.25)
    assert not noise.contradicts[0]
    # whoever states the error of the gauge is believed
    assert sensor_noise([reading[:, None]], np.array([2.0 * off])).used[0] == 2.0 * off


@pytest.mark.parametrize("share", [0.2, 0.45, 0.7])
def test_a_channel_at_its_limit_shows_the_noise_it_has_elsewhere(share):
    """Clipped again and again, and at rest where the sensor was switched off."""
    y = MOTIONS["slow"] + 0.05 * np.random.default_rng(3).standard_normal(SAMPLES)
    clipped = np.minimum(y, np.quantile(y, 1.0 - share))
    assert noise_level(clipped[:, None])[0] == pytest.approx(0.05, rel=0.1)
    off = np.where(np.arange(SAMPLES) < share * SAMPLES, 0.0, y)
    assert noise_level(off[:, None])[0] == pytest.approx(0.05, rel=0.1)


REAL = Path(__file__).resolve().parents[3] / "shared" / "data" / "real"


@pytest.mark.skipif(not REAL.is_dir(), reason="the recordings of real machines are not here")
@pytest.mark.parametrize(
    ("folder", "channel", "least", "most"),
    [
        # a gauge in steps of 3 mm: 0.9 mm if it rounds, 1.7 mm if it clings
        ("tank_drain", "level_cm", 0.9e-3, 1.8e-3),
        # a camera with a stated error of 0.5 deg
        ("tendon", "angle_deg", np.radians(0.499), np.radians(0.501)),
    ],
)
def test_floors_of_real_gauges(folder, channel, least, most):
    rig = rig_named(str(REAL / folder / "rig.py"))
    for path in sorted((REAL / folder).glob("*.csv")):
        whole = read_recording(path)
        for stop in (len(whole), round(0.6 * len(whole))):
            (noise,) = split_recordings(rig, [whole.slice(0, stop)], []).noise
            assert least < noise < most, channel


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("recorded", [0.0, 0.01])
@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_plateaus_are_seen_through_the_noise_behind_them(motion, recorded, unit):
    """What rounds before noise is added leaves plateaus, whatever step the recorder has."""
    step, noise = 4.0, np.random.default_rng(5).normal(size=SAMPLES)
    y = step * np.round(MOTIONS[motion] / step) + 0.05 * step * noise
    y = recorded * np.round(y / recorded) if recorded else y
    assert plateaus(unit * y)[0] == pytest.approx(unit * step, rel=3e-3)


@pytest.mark.parametrize("unit", [1.0, 1000.0])
def test_noise_of_a_feedback_in_the_input_is_not_the_sensor_s(unit):
    """A current answers a voltage that carries an encoder's noise within two samples."""
    random = np.random.default_rng(3)
    voltage = 3.0 * np.sin(np.arange(4000) / 90.0) + 0.4 * random.standard_normal(4000)
    current = 0.2 * voltage + 0.15 * np.roll(voltage, 1) + 0.02 * random.standard_normal(4000)
    read, sent = unit * current[1:, None], voltage[1:, None]
    assert noise_level(read)[0] > 0.03 * unit
    noise = sensor_noise([read], np.array([0.02 * unit]), [sent])
    assert noise.used[0] == pytest.approx(0.02 * unit, rel=0.1)
    assert not noise.contradicts[0]
    # a sensor that is fed back has the noise that its rig states, although the input shows it
    angle = np.sin(np.arange(4000) / 90.0)[:, None] + 0.02 * random.standard_normal((4000, 1))
    fed_back = sensor_noise([unit * angle], np.array([0.02 * unit]), [-3.0 * angle])
    assert fed_back.used[0] == pytest.approx(0.02 * unit, rel=0.1)
    # an input of steps explains no noise
    steps = np.repeat(random.uniform(-3.0, 3.0, 40), 100)[1:, None]
    plain = 0.02 * random.standard_normal((3999, 1))
    assert sensor_noise([plain], np.zeros(1), [steps]).used[0] == pytest.approx(0.02, rel=0.1)
