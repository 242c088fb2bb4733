"""Whole files for the fuzzing to damage: recordings, runs, a model, logs of every kind."""

import json
import shutil
from pathlib import Path

import numpy as np
from identified_runs import SEEN, fitted_run, put_network, random_network
from small_cart import record_cart
from synthetic_run import make_run, make_trial
from virtual_joint import record

from pamid.networks.elman import Elman
from pamid.networks.training_problem import TrainingOptions

LOG = "t [ms];Winkel [°];p1 [bar];u\r\n" + "".join(
    f"{3 * k},{k % 7};{np.sin(k / 20):.3f};{1 + np.cos(k / 30):.4f};{(k // 40) % 3 - 1}\r\n".replace(  # noqa: E501
        ".", ","
    )
    for k in range(120)
)
SIDECAR = """[recording]
rig = "one-dof"
loop = "closed"
sampling_period_s = 0.003

[known]
inertia_kg_m2 = 0.0896

[controller]
kp_per_deg = 0.1
kd_s_per_deg = 0.01
derivative_filter_s = 0.01
command_limit = 1.0
"""


def make_seeds(place: Path) -> Path:
    """Write the whole files into a folder and return it."""
    place.mkdir(parents=True, exist_ok=True)
    record_cart(place)
    lines = (place / "rec.csv").read_text().splitlines(keepends=True)
    (place / "cart.csv").write_text("".join(lines[:301]))
    record(place / "long.csv", 6.0)
    lines = (place / "long.csv").read_text().splitlines(keepends=True)
    (place / "rec.csv").write_text("".join(lines[:90]))
    (place / "fit.csv").write_text("".join(lines[:450]))
    for name in ("rec", "fit"):
        (place / f"{name}.toml").write_text(SIDECAR)
    fitted_run(place / "fitted", place / "long.csv")
    put_network(place / "fitted", random_network(Elman(len(SEEN), 2), SEEN, "angle_deg", 1.0))
    for verdict in ("explained", "partly-explained", "unknown-effect"):
        run = make_run(place / verdict, verdict)
        for name in ("residual.csv", "trace.csv", "missing.csv"):
            if (run / name).is_file():
                head, *rows = (run / name).read_text().splitlines(keepends=True)
                (run / name).write_text("".join([head, *rows[:: max(len(rows) // 150, 1)]]))
    make_trial(place / "trial")
    _checkpoint(place)
    _force_map(place / "map.csv")
    _excitation(place)
    _results(place)
    _raw_logs(place)
    return place


def _checkpoint(place: Path) -> None:
    """Where a training of the run stood after its first step."""
    from pamid.networks.correction.output_network import NetworkChoice, train_correction
    from pamid.networks.correction.residual_data import read_residual_data

    train_correction(
        read_residual_data(place / "explained"),
        wanted=NetworkChoice("elman", {"hidden": 2}),
        options=TrainingOptions(
            iterations=1, seed=0, threads=1, checkpoint=place / "checkpoint.npz"
        ),
    )


def _force_map(path: Path) -> None:
    rows = [
        f"{c:.3f},{p:.1f},{max(3.0 * p * (1 - 4 * c), 0.0):.4f}"
        for c in np.linspace(0, 0.25, 6)
        for p in np.linspace(0, 500, 7)
    ]
    path.write_text("\n".join(["contraction,pressure_kpa,force_n", *rows]) + "\n")


def _excitation(place: Path) -> None:
    from pamid.recording.recording import write_recording
    from pamid.simulation.excitation.aprbs import aprbs

    reference = aprbs(0.3, 0.003, 20.0, seed=1, hold_s=(0.05, 0.1))
    write_recording(
        place / "sent.csv", np.arange(len(reference)) * 0.003, {"reference_deg": reference}
    )
    (place / "sent.toml").write_text(SIDECAR)


def _results(place: Path) -> None:
    from pamid.base.parallel.packing import Question
    from pamid.base.parallel.result_store import Store

    result = {"x": np.arange(5.0), "y": [1, float("inf"), {"z": "text"}], "n": None}
    Store(place / "jobs").put("ab" * 32, "a job", Question().packed(result))


def _raw_logs(place: Path) -> None:
    """One log of every kind, as small as the writers allow."""
    import warnings

    import test_ingest_formats as written

    (place / "log.csv").write_bytes(LOG.encode("cp1252"))
    head = (
        "LabVIEW Measurement\nWriter_Version\t2\nReader_Version\t2\nSeparator\tTab\n"
        "Decimal_Separator\t.\nMulti_Headings\tYes\nX_Columns\tOne\nTime_Pref\tRelative\n"
        "***End_of_Header***\n\nChannels\t2\nSamples\t60\t60\nY_Unit_Label\tdeg\tbar\n"
        "X_Dimension\tTime\tTime\nX0\t0.0\t0.0\nDelta_X\t0.003\t0.003\n***End_of_Header***\n"
        "X_Value\tangle\tp1\tComment\n"
    )
    lvm = [f"{0.003 * k:.6f}\t{np.sin(k / 9):.6f}\t{1 + np.cos(k / 7):.6f}" for k in range(60)]
    (place / "log.lvm").write_text(head + "\n".join(lvm) + "\n")
    data = [
        {"t": 0.003 * k, "angle": round(float(np.sin(k / 9)), 6), "f": [float(k % 7), None]}
        for k in range(60)
    ]
    (place / "log.json").write_text(json.dumps({"robot": "arm", "data": data}))
    stamps = "".join(f" {0.003 * k}\n" for k in range(60))
    angles = " ".join(f"{np.sin(k / 9):.6f}" for k in range(60))
    (place / "octave.mat").write_text(
        "# Created by Octave 8.4.0\n"
        f"# name: t\n# type: matrix\n# rows: 60\n# columns: 1\n{stamps}\n\n"
        f"# name: angle\n# type: matrix\n# rows: 1\n# columns: 60\n {angles}\n\n\n"
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        written.write_mat(place / "v5.mat")
        from scipy.io import savemat

        savemat(place / "v4.mat", {"ans": np.vstack([written.TIME, written.ANGLE])}, format="4")
        written.write_hdf5(place / "log.h5")
        written.write_tdms(place / "log.tdms")
        written.write_mdf(place / "log.mf4")
        written.write_ros(place / "log.bag", "bag")
        written.ros_2(place / "log.mcap")
        folder = written.write_ros(place / "bag2", "sqlite3")
        shutil.copy(next(folder.glob("*.db3")), place / "log.db3")
        import pyarrow
        import pyarrow.parquet

        table = pyarrow.table({"t": written.TIME, "angle": written.ANGLE})
        pyarrow.parquet.write_table(table, place / "log.parquet")
