"""The moving rig: poses from a run, the GIF, the player on the page; catalogued rigs, a user's, and
none."""

import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from pamid_cli.frame import run as run_command
from PIL import Image
from report_pages import scripts_of
from synthetic_run import fit_json, make_run, run_json

from pamid.base.errors import DataError
from pamid.report.animation import ANIMATION_HZ, gif_of
from pamid.report.channel_errors import errors_of
from pamid.report.load import RunData, load_run
from pamid.report.motion import MEASURED, motion_of, rig_of_run
from pamid.report.page import asset, html_of
from pamid.report.run_page import run_page

STEP_S = 1.0 / ANIMATION_HZ
LINK_1_M, LINK_2_M = 0.4, 0.3
CART = '''
import numpy as np
from pathlib import Path
from pamid import Parameter, Port, Rig, State

Path(__file__).with_suffix(".ran").touch()


class Cart(Rig):
    """A cart, drawn as a box on wheels; the width is fitted here."""

    inputs = {"force_n": "N"}
    outputs = {"position_m": "m"}
    ports = {"force": Port("motion", "N", signals=("velocity", "position"))}
    states = (State("position", "m"), State("velocity", "m/s"))
    parameters = (Parameter("width", 20.0, 1.0, 100.0, "cm"),)

    def pose(self, y, p):
        x = y["position_m"]
        corners = np.array([[-0.5, 0.0], [-0.5, 0.4], [0.5, 0.4], [0.5, 0.0]]) * p.width
        rail = np.array([[-1.0, 0.0], [1.0, 0.0]])
        return {"box": corners + np.stack([x, 0.0 * x], axis=1)[:, None],
                "rail": np.repeat(rail[None], len(x), axis=0)}
'''


def bare_run(
    folder: Path, rig: str, columns: dict[str, Any], parameters: dict[str, float] | None = None
) -> Path:
    """A fitted run of any rig: 40 s at 10 ms, the last 30 % held out, windows of 2 s of which the
    first 0.3 s is not scored; `columns` are functions of time."""
    folder.mkdir(parents=True)
    time = 0.01 * np.arange(4000)
    since = time % 2.0
    table = {
        "time_s": time,
        "recording": 0 * time,
        "part": 1.0 * (time >= 28.0),
        "window": np.where(since < 0.3, -1, time // 2.0),
    }
    table |= {
        name: values(time) if callable(values) else values for name, values in columns.items()
    }
    known = {name: {"value": value, "unit": "cm"} for name, value in (parameters or {}).items()}
    fit = {
        **fit_json(),
        "rig": rig,
        "channels": [],
        "mae": {},
        "closed_loop": {},
        "parameters": known,
    }
    for name, content in (("run", run_json()), ("fit", fit)):
        (folder / f"{name}.json").write_text(json.dumps(content), encoding="utf-8")
    np.savetxt(
        folder / "residual.csv",
        np.stack(list(table.values()), axis=1),
        delimiter=",",
        fmt="%.9g",
        header=",".join(table),
        comments="",
    )
    return folder


def swing(amplitude: float, rate: float, gap: float = 0.0) -> Callable[[np.ndarray], np.ndarray]:
    return lambda time: amplitude * np.sin(rate * time) + gap * (1.0 + 0.1 * np.cos(rate * time))


def two_link_run(folder: Path) -> Path:
    return bare_run(
        folder,
        "two-link",
        {
            "angle_1_deg": swing(20, 1.1),
            "angle_1_data_sheet_deg": swing(20, 1.1, 3.0),
            "angle_1_refitted_deg": swing(20, 1.1, 0.5),
            "angle_2_deg": swing(30, 1.7),
            "angle_2_data_sheet_deg": swing(30, 1.7, -2.0),
            "angle_2_refitted_deg": swing(30, 1.7, 0.25),
        },
    )


def cart_run(folder: Path) -> Path:
    return bare_run(
        folder,
        "cart",
        {
            "position_m": swing(0.5, 1.1),
            "position_data_sheet_m": swing(0.5, 1.1, 0.02),
            "position_refitted_m": swing(0.5, 1.1, 0.001),
        },
        {"width_cm": 30.0},
    )


@pytest.fixture(scope="module")
def joint(tmp_path_factory) -> RunData:
    """A fit of the one-dof rig."""
    return load_run(
        make_run(tmp_path_factory.mktemp("fit") / "RUN", without=("diagnosis.json", "network.json"))
    )


@pytest.fixture(scope="module")
def links(tmp_path_factory) -> RunData:
    return load_run(two_link_run(tmp_path_factory.mktemp("links") / "RUN"))


def page_of(run: RunData) -> str:
    return html_of(run_page(run, errors_of(run), {}))


def test_poses_are_those_of_the_angles_at_their_times(links):
    motion = motion_of(links, rig_of_run(links), STEP_S)
    assert list(motion.lines) == [MEASURED, "data_sheet", "refitted"]
    assert motion.time[0] >= 28.0 and motion.time[-1] - motion.time[0] <= 12.0
    for kind, gap_1, gap_2 in (
        (MEASURED, 0.0, 0.0),
        ("data_sheet", 3.0, -2.0),
        ("refitted", 0.5, 0.25),
    ):
        first = np.deg2rad(swing(20, 1.1, gap_1)(motion.time))
        both = first + np.deg2rad(swing(30, 1.7, gap_2)(motion.time))
        elbow = LINK_1_M * np.stack([np.sin(first), -np.cos(first)], axis=1)  # hanging down at 0
        tip = elbow + LINK_2_M * np.stack([np.sin(both), -np.cos(both)], axis=1)
        (arm,) = motion.lines[kind]
        np.testing.assert_allclose(np.abs(arm[:, 1] - elbow).max(), 0.0, atol=2e-4)
        np.testing.assert_allclose(np.abs(motion.tip(kind) - tip).max(), 0.0, atol=2e-4)
    assert motion.pivots.tolist() == [[0.0, 0.0]]


def test_a_diagnosis_shows_the_cause_over_the_refitted_model(tmp_path):
    run = load_run(make_run(tmp_path / "RUN"))
    motion = motion_of(run, rig_of_run(run), STEP_S)
    assert list(motion.lines) == [MEASURED, "refitted", "cause"]
    assert motion.title.startswith("The model with Coulomb friction follows the angle to ")
    page = page_of(run)
    assert (
        "with Coulomb friction follows the angle" in page
        and "best cause" in page
        and "before refitted" in page
    )


def test_the_gif_plays_in_real_time_and_is_small(links):
    motion = motion_of(links, rig_of_run(links), STEP_S, 30.0, 36.0)
    done: list[int] = []
    gif = gif_of(motion, 480, lambda k, of: done.append(k))
    assert done[-1] == motion.time.size == 151
    assert len(gif) < 1_500_000
    with Image.open(io.BytesIO(gif)) as picture:
        assert (picture.format, picture.n_frames, picture.width) == ("GIF", 151, 480)
        assert picture.info["duration"] == 40 and picture.info["loop"] == 0
        frames = []
        for k in (0, 75):
            picture.seek(k)
            frames.append(np.asarray(picture.convert("RGB")).astype(int))
    assert (np.abs(frames[0] - frames[1]).max(axis=2) > 100).sum() > 500  # the arm is elsewhere
    for frame in frames:
        assert (frame[:, 2] == 255).mean() > 0.9  # on white
        assert (np.abs(frame - [0x00, 0x72, 0xB2]).max(axis=2) < 8).sum() > 200
        assert (np.abs(frame - [0x1B, 0x1F, 0x24]).max(axis=2) < 8).sum() > 800


def test_the_same_motion_gives_the_same_gif(joint):
    motion = motion_of(joint, rig_of_run(joint), STEP_S, 30.0, 30.4)
    first = gif_of(motion, 320)
    with matplotlib.rc_context({"font.size": 20.0, "axes.grid": True, "figure.dpi": 50}):
        assert gif_of(motion, 320) == first
    with pytest.raises(DataError, match="too many"):
        gif_of(motion_of(joint, rig_of_run(joint), 0.001, 30.0, 33.0))


@pytest.mark.parametrize("break_it", ["rig", "residual", "channel"])
def test_no_player_without_rig_residual_or_channel(break_it, tmp_path):
    folder = cart_run(tmp_path / "RUN") if break_it == "rig" else two_link_run(tmp_path / "RUN")
    if break_it == "residual":
        (folder / "residual.csv").unlink()
    if break_it == "channel":
        text = (folder / "residual.csv").read_text(encoding="utf-8")
        (folder / "residual.csv").write_text(
            text.replace("angle_2_deg", "elbow_deg", 1), encoding="utf-8"
        )
    page = page_of(load_run(folder))
    assert asset("player.js") not in scripts_of(page) and 'class="motion"' not in page


def test_a_rig_file_is_run_only_when_it_is_named(tmp_path, capsys, undrawn):
    folder, file = cart_run(tmp_path / "RUN"), tmp_path / "cart.py"
    file.write_text(CART, encoding="utf-8")
    fit = json.loads((folder / "fit.json").read_text(encoding="utf-8"))
    (folder / "fit.json").write_text(json.dumps({**fit, "rig": str(file)}), encoding="utf-8")
    assert run_command(["animate", str(folder)]) == 3
    assert "add --rig FILE" in capsys.readouterr().err
    assert 'class="motion"' not in page_of(load_run(folder))
    assert not file.with_suffix(".ran").exists()
    (folder / "fit.json").write_text(json.dumps(fit), encoding="utf-8")
    out = tmp_path / "new" / "cart.gif"
    words = f"animate {folder} --rig {file} --output {out} --json --from 30 --to 31 --size 300"
    assert run_command(words.split()) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["schema"], told["frames"], told["width_px"]) == ("pamid.animate/1", 26, 300)
    assert told["mean_gap"]["position_m"]["data_sheet"] == pytest.approx(0.02, rel=0.1)
    assert told["bytes"] == out.stat().st_size
    assert [path.name for path in out.parent.iterdir()] == ["cart.gif"]
    assert run_command(["report", str(folder), "--rig", str(file)]) == 0
    assert 'class="motion"' in (folder / "report.html").read_text(encoding="utf-8")
    capsys.readouterr()
    assert run_command(["report", str(folder), "--rig", "one-dof"]) == 3
    assert "is 'one-dof'" in capsys.readouterr().err
    assert run_command(["report", "--compare", str(folder), str(folder), "--rig", str(file)]) == 2
