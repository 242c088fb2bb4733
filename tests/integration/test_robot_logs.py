"""Logs of robots against the model of the robot, end to end: MuJoCo moves an arm of two joints, its
JointState bag and its LeRobot data set are ingested for the model file, checked and fitted."""

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import mechanisms
import numpy as np
import pytest
from conftest import Cli

from pamid.base.arrays import Array
from pamid.base.errors import FileError
from pamid.intake.logs.log_reader import read_log
from pamid.recording.recording import read_recording

mujoco: Any = mechanisms.needs_mujoco()
pytest.importorskip("rosbags", reason="pip install 'pamid[ros]'")
pytest.importorskip("pyarrow", reason="pip install 'pamid[parquet]'")

State = tuple[float, list[str], Any, Any, Any]

JOINTS = ["shoulder", "elbow"]
HEAVIER = mechanisms.TWO.replace('mass="1.2"', 'mass="1.35"')
START_NS = 1_700_000_000_000_000_000


def moved(period_s: float, samples: int, seed: int = 0) -> tuple[Array, Array, Array, Array]:
    """Commands, positions, velocities and torques (samples, 2) of the arm with a heavier upper
    link."""
    model = mujoco.MjModel.from_xml_string(HEAVIER)
    data, random = mujoco.MjData(model), np.random.default_rng(seed)
    u = np.repeat(random.uniform(-0.4, 0.4, (samples // 40 + 1, 2)), 40, axis=0)[:samples]
    q, v = np.empty((samples, 2)), np.empty((samples, 2))
    for k in range(samples):
        q[k], v[k], data.ctrl[:] = data.qpos, data.qvel, u[k]
        mujoco.mj_step(model, data, round(period_s / model.opt.timestep))
    return u, q, v, u * model.actuator_gear[:, 0]


def bag(path: Path, samples: int, states: dict[str, Callable[[int], Iterable[State]]]) -> Path:
    """A ROS 2 bag (MCAP) of JointState; every state is (s, names, position, velocity, effort)."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store, kind = get_typestore(Stores.ROS2_HUMBLE), "sensor_msgs/msg/JointState"
    joint, header = store.types[kind], store.types["std_msgs/msg/Header"]
    stamp = store.types["builtin_interfaces/msg/Time"]
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topics = {name: writer.add_connection(name, kind, typestore=store) for name in states}
        for k in range(samples):
            for name, made in states.items():
                for seconds, names, *values in made(k):
                    ns = START_NS + round(1e9 * seconds)
                    head = header(stamp(ns // 10**9, ns % 10**9), "base")
                    message = joint(head, names, *(np.array(v, dtype=np.float64) for v in values))
                    writer.write(topics[name], ns + 2_000_000, store.serialize_cdr(message, kind))
    return path


def data_set(root: Path, episodes: list[tuple[Array, Array]], fps: float, **info: Any) -> Path:
    """A LeRobot data set (v2.1) of (action, observation.state) per episode."""
    import pyarrow
    import pyarrow.parquet

    (root / "meta").mkdir(parents=True)
    (root / "data/chunk-000").mkdir(parents=True)
    named = {
        "observation.state": {
            "dtype": "float32",
            "shape": [2],
            "names": [f"{j}.pos" for j in JOINTS],
        },
        "action": {"dtype": "float32", "shape": [2], "names": {"motors": JOINTS}},
        "observation.images.top": {"dtype": "video", "names": ["height", "width", "channels"]},
    }
    about = {"codebase_version": "v2.1", "fps": fps, "features": {**named, **info}}
    (root / "meta/info.json").write_text(json.dumps(about))

    def vectors(values: Array) -> Any:
        flat = pyarrow.array(values.astype(np.float32).ravel())
        return pyarrow.FixedSizeListArray.from_arrays(flat, values.shape[1])

    for number, (action, state) in enumerate(episodes):
        count = np.arange(len(action))
        table = {
            "observation.state": vectors(state),
            "action": vectors(action),
            "timestamp": pyarrow.array((count / fps).astype(np.float32)),
            "frame_index": count,
            "episode_index": np.full(len(count), number),
            "task_index": np.zeros(len(count), np.int64),
        }
        file = root / f"data/chunk-000/episode_{number:06d}.parquet"
        pyarrow.parquet.write_table(pyarrow.table(table), file)
    return root


@pytest.fixture
def arm(tmp_path) -> Path:
    path = tmp_path / "arm.xml"
    path.write_text(mechanisms.TWO)
    return path


def ingested(cli: Cli, log: Path, arm: Path, *more: str) -> tuple[dict[str, Any], list[Path]]:
    """What a guess and the mapping that it writes make of a log."""
    mapping = log.with_suffix(".map")
    guessed = cli("ingest", "--guess", log, "--rig", arm, *more, "--output", mapping)
    assert guessed["open"] == []
    made = cli("ingest", log, "--mapping", mapping, "--rig", arm, "--output",
                 log.with_suffix(".csv"))  # fmt: skip
    accounts = made.get("recordings") or [made]
    return guessed, [Path(one["recording"]["path"]) for one in accounts]


def fitted(cli: Cli, arm: Path, *recordings: Path) -> dict[str, Any]:
    run = arm.parent / "run"
    return dict(cli("fit", *recordings, "--rig", arm, "--output", run)["parameters"])


def test_a_joint_state_bag_becomes_a_fit(tmp_path, arm, cli):
    u, q, v, torque = moved(0.005, 3000)
    q = q + np.random.default_rng(1).normal(0.0, 2e-4, q.shape)

    def state(k):
        order = [0, 1] if k % 3 else [1, 0]  # of the joints is the sender's business
        speed = v[k][order] if k % 2 else []
        return [(0.005 * k, [JOINTS[j] for j in order], q[k][order], speed, torque[k][order])]

    guessed, (recording,) = ingested(
        cli, bag(tmp_path / "log", 3000, {"/joint_states": state}), arm
    )
    assert guessed["notes"] == []
    made = read_recording(recording)
    np.testing.assert_allclose(made.columns["shoulder_angle_rad"], q[:, 0], atol=1e-6)
    np.testing.assert_allclose(made.columns["m2_command"], u[:, 1], atol=1e-6)
    assert cli("check", recording, "--rig", arm)["ok"]
    mass = fitted(cli, arm, recording)["upper_mass_kg"]
    assert abs(mass["value"] - 1.35) < 0.01 and mass["low"] <= 1.351 and mass["high"] >= 1.349


def test_a_lerobot_data_set_becomes_a_fit(tmp_path, arm, cli):
    runs = [moved(0.02, 400, seed)[:2] for seed in range(3)]
    log = data_set(tmp_path / "set", runs, 50.0)
    guessed, recordings = ingested(cli, log, arm, "--angles", "rad")
    assert guessed["notes"] == [] and len(recordings) == 3
    for (u, q), path in zip(runs, recordings, strict=True):
        made = read_recording(path)
        np.testing.assert_allclose(made.columns["elbow_angle_rad"], q[:, 1], atol=1e-6)
        np.testing.assert_allclose(made.columns["m1_command"], u[:, 0], atol=1e-6)
        assert made.sampling_period_s == 0.02
    assert cli("check", recordings[0], "--rig", arm)["ok"]
    mass = fitted(cli, arm, *recordings)["upper_mass_kg"]
    assert abs(mass["value"] - 1.35) < 0.01
    # one episode by itself, named as its data set names it
    alone = read_log(log / "data/chunk-000/episode_000001.parquet")
    assert alone.kind == "lerobot"
    np.testing.assert_allclose(alone.channel("action/elbow").values, runs[1][0][:, 1], atol=1e-6)


@pytest.mark.parametrize(
    ("names", "positions", "said"),
    [
        ([], [], "there are no signals"),
        (["shoulder", "shoulder"], [0.1, 0.2], "name a joint twice"),
        (["shoulder", "elbow"], [0.1, 0.2, 0.3], "different numbers of values and names"),
    ],
)
def test_damaged_joint_states_are_refused(tmp_path, names, positions, said):
    def state(k):
        return [(0.01 * k, names, positions, [], [])]

    with pytest.raises(FileError, match=said):
        read_log(bag(tmp_path / "log", 60, {"/joint_states": state}))
