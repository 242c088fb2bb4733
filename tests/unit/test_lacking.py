"""A channel is used wherever it was recorded: what one recording lacks is not taken away from the
others."""

import json
from pathlib import Path

import numpy as np
import pytest
from pamid_cli.frame import run
from virtual_recordings import virtual_recording

from pamid.estimation.fit_files import fit_json, residual_table
from pamid.estimation.grey_box import GreyBox, fit_model
from pamid.estimation.intervals import estimates
from pamid.model.registry import effects, rig_named
from pamid.networks.correction.residual_data import read_residual_data
from pamid.recording.recording import Recording, read_recording, write_recording
from pamid.simulation.data_split import split_recordings

SPRUNG = '''"""A mass on a spring behind a load cell."""
from pamid import Parameter, Port, Rig, State

class Sprung(Rig):
    """A mass on a spring; the load cell shows the spring's force, scaled."""
    inputs = {"push_n": "N"}
    outputs = {"position_m": "m", "cell_n": "N"}
    ports = {"push": Port("motion", "N", ("velocity", "position")), "gauge": Port("reading", "m"),
             "cell": Port("reading", "N")}
    states = (State("position", "m"), State("velocity", "m/s"))
    parameters = (Parameter("mass_kg", 1.0, low=0.1, high=10.0, source="scale"),
                  Parameter("stiffness_n_per_m", 80.0, low=10.0, high=500.0, source="data sheet"),
                  Parameter("damping", 4.0, 0.1, 50.0, "N s/m", source="data sheet"),
                  Parameter("gain", 1.0, 0.2, 5.0, source="data sheet"))
    noise = {"position_m": 0.001, "cell_n": 0.1}
    def rates(self, x, u, p, port):
        force = port("push", u.push_n, velocity=x.velocity, position=x.position)
        return {"position": x.velocity,
                "velocity": (force - p.stiffness_n_per_m * x.position - p.damping * x.velocity) / p.mass_kg}
    def measure(self, x, u, p, port):
        return {"position_m": port("gauge", x.position),
                "cell_n": port("cell", p.gain * p.stiffness_n_per_m * x.position)}
'''  # noqa: E501


@pytest.fixture(scope="module")
def rig(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("lacking") / "sprung.py"
    path.write_text(SPRUNG)
    return path


def recorded(
    rig: Path, name: str, seed: int, *columns: str, planted: tuple[str, ...] = (), steps: int = 30
) -> Recording:
    """The same machine each time, another push and noise; columns: of the sensors, all where none
    is named."""
    random, path = np.random.default_rng(seed), rig.parent / f"{name}.csv"
    sent = {"push_n": np.repeat(random.uniform(-8.0, 8.0, steps), 40)}
    true = {"gain": 1.3, "mass_kg": 1.2}
    made = virtual_recording(str(rig), sent, 0.01, *planted, true=true, seed=seed)
    kept = [k for k in made.columns if k == "push_n" or not columns or k in columns]
    write_recording(path, made.time, {k: made.columns[k] for k in kept})
    return read_recording(path)


@pytest.fixture(scope="module")
def both(rig) -> tuple[Recording, Recording]:
    return recorded(rig, "all", 1), recorded(rig, "less", 2, "position_m")


def fitted(rig: Path, *recordings: Recording) -> GreyBox:
    return fit_model(split_recordings(rig_named(str(rig)), list(recordings), []))


def widths(g: GreyBox) -> dict[str, float]:
    return {b.full_name: (e.high or 0.0) - (e.low or 0.0) for b, e in estimates(g.fit).items()}


def test_force_in_one_recording_only_still_tells_its_parameter(rig, both):
    alone, together = fitted(rig, both[0]), fitted(rig, *both)
    assert together.evidence.channels == ("position_m", "cell_n")
    one, two = widths(alone), widths(together)
    assert two["gain"] < 1.1 * one["gain"], "as tight as from the recording that has the force"
    assert two["mass_kg"] < 0.85 * one["mass_kg"], "and the other one adds what it knows"
    gain = next(e for b, e in estimates(together.fit).items() if b.name == "gain")
    assert gain.low < 1.3 < gain.high and gain.word == "settled"


def test_what_is_missing_is_told_and_nothing_else_is_made_up(rig, both):
    g = fitted(rig, *both)
    found = fit_json(g, 0)
    assert {r["name"]: r["lacks"] for r in found["recordings"]} == {"all": [], "less": ["cell_n"]}
    alone = [r for r in g.held_out if r.seen.all()]
    assert len(alone) == 1 and len(g.held_out) == 2
    errors = found["mae"]["cell_n"]
    assert errors["refitted"] == pytest.approx(
        float(np.abs(alone[0].residual[alone[0].scored]).mean(axis=0)[1])
    )
    assert errors["refitted"] == pytest.approx(errors["noise_floor"], rel=0.3)
    header, rows = residual_table(g)
    cell, recording = rows[:, header.index("cell_n")], rows[:, header.index("recording")]
    names = [r["name"] for r in found["recordings"]]
    assert np.isnan(cell[recording == names.index("less")]).all()
    assert np.isfinite(cell[recording == names.index("all")]).all()
    assert np.isfinite(rows[:, header.index("cell_refitted_n")]).all()


@pytest.mark.slow
def test_the_commands_go_all_the_way(rig, tmp_path, capsys):
    """Diagnosis, report page and a network on a channel that one recording lacks."""
    friction = ("coulomb-friction:force_n=2.0",)
    made = [
        recorded(rig, "long", 1, planted=friction, steps=16),
        recorded(rig, "short", 2, "position_m", planted=friction, steps=14),
    ]
    few = ("coulomb-friction", "dead-time")
    without = [word for name in effects() if name not in few for word in ("--without", name)]
    words = ["--rig", str(rig), "--jobs", "1", "--json", "--output", str(tmp_path / "run")]
    code = run(["diagnose", *(str(r.path) for r in made), *without, *words])
    shown = capsys.readouterr()
    said = json.loads(shown.out)
    assert code in (0, 5, 6) and not said["failed_jobs"] and "short.csv lacks cell_n" in shown.err
    assert said["verdict"] == "explained" and said["causes"][0]["effect"] == "coulomb-friction"
    assert set(said["how_far"]) == {"position_m", "cell_n"}
    assert all(np.isfinite(v) for one in said["how_far"].values() for v in one.values())
    assert run(["report", str(tmp_path / "run")]) == 0
    left = read_residual_data(tmp_path / "run", "cell_n")
    assert all(np.isfinite(left.target[s.rows]).all() for s in left.stretches) and left.stretches
