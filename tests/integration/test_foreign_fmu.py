"""FMUs in C that pamid did not write: both kinds, both versions, states saved or replayed,
and everything that may go wrong with a binary."""

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from foreign_fmus import TRUE, changed, compiler, slider
from scipy.integrate import solve_ivp

import pamid
from pamid.base.arrays import Array
from pamid.base.errors import PamidError
from pamid.engine.program import WindowStarts
from pamid.engine.sampled_inputs import SampledInputs
from pamid.model.assembly import Assembly
from pamid.model.attachment import attachments
from pamid.model.registry import effects, rig_named
from pamid.recording.recording import write_recording
from pamid.rigs.simulators import fmu_process
from pamid.rigs.simulators.fmu_file import FmuFile, read_fmu
from pamid.rigs.simulators.fmu_rig import FmuRig

pytest.importorskip("fmpy", reason="the extra [fmu] is not installed")
if compiler() is None:
    pytest.skip("no C compiler builds the FMU", allow_module_level=True)


PERIOD, SAMPLES = 0.01, 150
U = np.repeat(np.random.default_rng(0).uniform(-14.0, 14.0, SAMPLES // 15), 15)[:, None]
MET = 0.13  # m: beyond the stop, which lies at 0.12


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("sliders")


@pytest.fixture(scope="module")
def both(folder) -> dict[tuple[int, str], FmuFile]:
    made = {}
    for version in (2, 3):
        for kind in ("CoSimulation", "ModelExchange"):
            path = slider(folder, version, kinds=(kind,), name=f"{kind}{version}")
            made[version, kind] = read_fmu(path)
    return made


def _run(rig: FmuRig, parts: int = 1, u: Array = U) -> tuple[Array, Array]:
    """Outputs, and their derivatives by the parameters."""
    a = Assembly(rig)
    p = a.values()
    memory = a.program.memory(a.start(p), len(p), period_s=PERIOD)
    rows = []
    for at in np.array_split(np.arange(len(u)), parts):
        y, by, bad = a.program.run(
            memory,
            SampledInputs(u[at], PERIOD, at[0] * PERIOD),
            p,
            columns=np.arange(len(p), dtype=np.int64),
        )
        assert bad < 0
        rows.append((y, by[:, :, : len(p)]))
    return np.concatenate([y for y, _ in rows]), np.concatenate([by for _, by in rows])


def _truth(u: Array = U, sampled: bool = False, friction_n: float = 0.0) -> Array:
    """Positions and speeds of the slider; friction: what it lacks, regular below 2 mm/s."""
    p = TRUE

    def rates(_: float, x: Array, force: float) -> list[float]:
        f = (
            force
            - friction_n * np.tanh(x[1] / 0.002)
            - p["stiffness_n_per_m"] * x[0]
            - p["damping_n_s_per_m"] * x[1]
        )
        if x[0] > p["stop_m"]:
            f -= p["stop_stiffness_n_per_m"] * (x[0] - p["stop_m"]) + 20.0 * x[1]
        return [x[1], f / p["mass_kg"]]

    x, rows, held = np.zeros(2), [], 0.0
    close = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-12}
    for k, row in enumerate(u[:, 0]):
        rows.append(x)
        held = held if sampled and k % 5 else row
        x = solve_ivp(rates, (0.0, PERIOD), x, args=(held,), **close).y[:, -1]
    return np.array(rows)


@pytest.fixture(scope="module")
def truth() -> Array:
    found = _truth()
    assert found[:, 0].max() > MET  # there are events
    return found


@pytest.mark.parametrize("version", [2, 3])
def test_model_exchange_is_integrated_through_its_events(both, truth, version):
    file = both[version, "ModelExchange"]
    assert file.exchange and file.seen and file.saves and file.indicators == 1
    y, told = _run(FmuRig(file))
    assert np.abs(y - truth).max() <= 1e-4
    again, also = _run(FmuRig(file), parts=3)
    assert np.array_equal(again, y) and np.allclose(also, told, rtol=1e-12, atol=0.0)
    # one instance a process: stepped one exchange after the other, which leads to the same
    single, by_exchanges = _run(FmuRig(replace(file, alone=True)))
    assert np.allclose(single, y, rtol=1e-12, atol=0.0)
    assert np.abs(told - by_exchanges).max() <= 1e-4 * np.abs(told).max()
    kept, by = _run(FmuRig(replace(file, seen=False)))
    assert np.abs(kept - y).max() <= 1e-7
    assert np.abs(by - told).max() <= 1e-2 * np.abs(told).max()
    replayed = _run(FmuRig(replace(file, seen=False, saves=False)), parts=3)[0]
    assert np.abs(replayed - kept).max() <= 1e-7


def test_slopes_of_an_exchange_are_those_of_the_equations(both):
    """Away from the stop the slider is linear: one step is the exponential of its matrix."""
    from scipy.linalg import expm

    for version in (2, 3):
        rig = FmuRig(both[version, "ModelExchange"])
        a = Assembly(rig)
        p, program, n = a.values(), a.program, len(rig.states)
        memory = program.memory(np.array([0.01, -0.2]), n, period_s=PERIOD)
        np.fill_diagonal(memory.S[:n], 1.0)
        none = np.full(len(p), -1, np.int64)
        program.run(memory, SampledInputs(np.array([[3.0]]), PERIOD), p, columns=none)
        A = np.array([[0.0, 1.0, 0.0], [-40.0, -1.5, 0.5], [0.0, 0.0, 0.0]])
        step = expm(PERIOD * A)
        assert np.abs(memory.x - step[:2] @ (0.01, -0.2, 3.0)).max() <= 1e-9
        assert np.abs(memory.S[:n, :n] - step[:2, :2]).max() <= 1e-8


def test_windows_in_a_row_send_a_program_once(both):
    rig = FmuRig(both[2, "ModelExchange"])
    a = Assembly(rig)
    p, u, n = a.values(), np.ones((20, 1)), len(rig.states)
    edges = np.array([(0, 10), (10, 20)], np.int64)
    windows = WindowStarts(edges, np.tile(a.start(p), (2, 1)), 0)
    memory = a.program.memory(a.start(p), n, period_s=PERIOD)
    ends = [w.end for w in a.program.run_windows(memory, SampledInputs(u, PERIOD), p, windows)]
    assert np.array_equal(ends[0], ends[1])  # from the same start, with the same input
    assert dict(rig._process.programs) == {a.program: 1}


@pytest.mark.parametrize("version", [2, 3])
def test_co_simulation_saves_its_state_or_is_replayed(both, truth, version):
    file = both[version, "CoSimulation"]
    y, by = _run(FmuRig(file))
    assert np.abs(y - truth).max() <= 2e-2  # its own solver meets the stop up to 0.5 ms late
    replayed, also = _run(FmuRig(replace(file, saves=False)), parts=3)
    assert np.array_equal(replayed, y) and np.array_equal(also, by)


@pytest.mark.parametrize(("version", "saves"), [(2, True), (3, False)])
def test_time_events_and_what_they_change_are_kept(folder, version, saves):
    path = slider(folder, version, kinds=("ModelExchange",), sampled=True, name=f"held{version}")
    file = read_fmu(path)
    assert not file.seen and any("are not seen" in text for text in file.remarks)
    u = np.sin(0.7 * np.arange(60.0))[:, None] * 5.0
    y, _ = _run(FmuRig(replace(file, saves=saves)), parts=2, u=u)
    assert np.abs(y - _truth(u, sampled=True)).max() <= 1e-4
    blind = FmuRig(replace(file, seen=True))
    with pytest.raises(PamidError, match=r"depend explicitly on time.*seen = false"):
        _run(blind, u=u)


def test_of_both_kinds_one_is_chosen_and_said(folder):
    path = slider(folder, 2, name="two")
    assert not (plain := read_fmu(path)).exchange
    assert "used for co-simulation: it saves its state" in plain.remarks[0]
    assert 'kind = "model-exchange" in two.fmu.toml' in plain.remarks[0]
    forgets = read_fmu(slider(folder, 2, saves=False, name="forgets"))
    assert forgets.exchange and "co-simulation it saves no state" in forgets.remarks[0]


# ---- the table beside it -------------------------------------------------------------------------

PORT = '[ports.force_n]\nposition = "position_m"\nvelocity = "speed_m_per_s"\n'


@pytest.fixture
def beside(tmp_path) -> Iterator[tuple[Path, Path]]:
    path = slider(tmp_path, 3)
    yield path, tmp_path / "slider.fmu.toml"


def test_a_table_declares_the_port_of_a_force(beside):
    path, table = beside
    assert any("[ports.force_n]" in text for text in rig_named(str(path)).remarks)
    table.write_text(f'kind = "model-exchange"\nfree = ["mass_kg"]\n{PORT}')
    rig = rig_named(str(path))
    assert isinstance(rig, FmuRig) and rig.file.exchange
    assert not any("[ports.force_n]" in text for text in rig.remarks)
    assert [q.name for q in rig.parameters if q.fitted] == ["mass_kg"]
    port = rig.ports["at_force_n"]
    assert (port.kind, port.signals) == ("motion", {"position": "m", "velocity": "m/s"})
    assert any(
        a.ports == ("at_force_n",) for a in attachments(rig, [effects()["coulomb-friction"]])
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (PORT.replace("force_n", "forse_n"), "'forse_n', but the FMU has no such input.*force_n"),
        (PORT.replace("position_m", "postion_m"), "'postion_m', but .* no such output.*position_m"),
        (PORT.replace('"speed_m_per_s"', '"position_m2"'), "'position_m2', but .* no such output"),
        ('[ports.force_n]\nposition = "position_m"\n', "lacks velocity"),
        ('[ports.force_n]\nplace = "position_m"\n', "has 'place'"),
        (
            '[ports.force_n]\nposition = "speed_m_per_s"\nvelocity = "position_m"\n',
            "'position_m' .m. is not the velocity of 'speed_m_per_s'",
        ),
        ('free = ["mas_kg"]\n', "'mas_kg', but the FMU has no such parameter.*mass_kg"),
        ('kind = "model-exchang"\n', "kind = 'model-exchang' is not a kind.*model-exchange"),
        ("knd = 1\n", "'knd' is not a setting.*kind"),
        ('seen = "no"\n', "seen = 'no' is not valid"),
        ("ports = 3\n", "ports = 3 is not valid"),
        ("[ports\n", "is not TOML"),
    ],
)
def test_a_table_that_is_wrong_says_where(beside, text, words):
    path, table = beside
    table.write_text(text)
    with pytest.raises(PamidError) as caught:
        rig_named(str(path))
    assert re.search(words, f"{caught.value} {caught.value.hint}", re.DOTALL), caught.value
    assert "slider.fmu.toml" in str(caught.value)


# ---- what is wrong with it -----------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["CoSimulation", "ModelExchange"])
@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("CRASH", r"crashed \(signal 11\)"),
        ("REFUSE", r"fmi2(DoStep|GetDerivatives) returned fmi2Error, at 0.5\d* s"),
        ("NONSENSE", r"its (output 'speed_m_per_s' is nan|derivatives are not finite)"),
        ("HANG", r"it did not answer within [.\d]+ s, and was ended"),
    ],
)
def test_what_goes_wrong_inside_is_a_sentence(tmp_path, kind, fault, words, monkeypatch):
    file = read_fmu(slider(tmp_path, 2, kinds=(kind,), fault=fault))
    rig = FmuRig(replace(file, seen=False))
    a = Assembly(rig)
    p = a.values()
    process = rig._process
    if fault == "HANG":  # compiled before patience ends
        memory = a.program.memory(a.start(p), 0, period_s=PERIOD)
        a.program.run(memory, SampledInputs(U[:1], PERIOD), p)
        monkeypatch.setattr(fmu_process, "PATIENCE_S", 2.0)
    memory = a.program.memory(a.start(p), 0, period_s=PERIOD)
    with pytest.raises(PamidError, match=f"slider.fmu: the FMU failed: .*{words}"):
        a.program.run(memory, SampledInputs(U, PERIOD), p)
    if fault in ("CRASH", "HANG"):
        assert process.child.poll() is not None  # the process is gone


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda name, data: (name.replace("linux64", "win64").replace(".so", ".dll"), data),
            "has a binary for win64, not for this one",
        ),
        (
            lambda name, data: None if name.startswith("binaries") else (name, data),
            "a binary for no machine that is known here",
        ),
        (
            lambda name, data: None if name.endswith(".xml") else (name, data),
            "cannot be read as an FMU: .*modelDescription.xml",
        ),
        (
            lambda name, data: (name.replace("slider.", "another."), data),
            "the FMU failed: .*slider",
        ),
        (
            lambda name, data: (name, b"no library" if name.startswith("binaries") else data),
            "the FMU failed: .*Failed to load shared library",
        ),
        (
            lambda name, data: (
                name,
                data.replace(b"{slider}", b"{other}") if name.endswith(".xml") else data,
            ),
            "the FMU failed: .*nstantiate",
        ),
    ],
)
def test_a_file_that_cannot_go_says_why(tmp_path, change, words):
    path = changed(slider(tmp_path, 2), tmp_path, change)
    with pytest.raises(PamidError, match=words):
        _run(FmuRig(read_fmu(path)))


# ---- from the log to the cause -------------------------------------------------------------------


@pytest.mark.slow
def test_what_the_fmu_lacks_is_named(tmp_path):
    path = slider(tmp_path, 2, kinds=("ModelExchange",), name="slider")
    path.with_name("slider.fmu.toml").write_text(
        '[ports.force_n]\nposition = "position_m"\nvelocity = "speed_m_per_s"\n'
    )
    random, planted = np.random.default_rng(3), 2.0
    u = np.repeat(random.uniform(-14.0, 14.0, 40), 40)[:, None]
    found = _truth(u, friction_n=planted)
    found += random.standard_normal(found.shape) * (2e-4, 5e-3)
    columns = {"force_n": u[:, 0], "position_m": found[:, 0], "speed_m_per_s": found[:, 1]}
    write_recording(tmp_path / "log.csv", PERIOD * np.arange(len(u)), columns)
    run = pamid.diagnose(tmp_path / "log.csv", rig=path, jobs=1, progress=False)
    # regular below 2 mm/s it is nobody's formula: which member of the family fits is open
    assert [(c.family, c.port) for c in run.causes] == [("friction", "at_force_n")]
    assert run.causes[0].parameters["force_n"].value == pytest.approx(planted, rel=0.05)
