"""What `pamid check` and `pamid rigs` print of rigs with many ports: one screen, the rest with
--all and --json."""

from pathlib import Path
from typing import Any

import mechanisms
import pytest
from pamid_cli import frame
from posed_arms import FOUR_HINGES, arm_text

import pamid
from pamid.intake.checks.inspection_words import SCREEN, inspection_text

mechanisms.needs_mujoco()

LINES = 40  # of a terminal


def printed(capsys: pytest.CaptureFixture[str], *words: str | Path) -> list[str]:
    assert frame.run([*map(str, words)]) == 0
    return capsys.readouterr().out.splitlines()


def ranged() -> str:
    """Seven joints, each with a range."""
    return mechanisms.SEVEN.replace("<joint ", '<joint range="-1 1" limited="true" ')


def test_a_model_of_seven_joints_is_checked_on_one_screen(tmp_path, capsys):
    path = tmp_path / "seven.xml"
    path.write_text(ranged())
    short = printed(capsys, "check", path)
    whole = printed(capsys, "check", path, "--all")
    assert len(short) <= LINES and max(map(len, short[:-1])) <= 115
    assert len(whole) > 250
    assert sum(line.startswith("port ") for line in whole) > 25
    assert sum("is not enforced" in line for line in whole) == 7
    (one,) = [line for line in short if "is not enforced" in line]
    at = short.index(one)
    assert "remark, 7 times" in one
    assert "likewise 'j2', 'j3', 'j4' .." in " ".join(" ".join(short[at : at + 3]).split())
    assert any("--all" in line for line in short)
    assert short[-1] == whole[-1] and short[-1].startswith("Next: ")
    # equations of a model are pamid's: no file can spoil their slopes
    assert not any("sensitivities" in line for line in whole)


def test_an_undamped_arm_passes_its_check(tmp_path, capsys):
    """Errors of its state grow, so that differences of its runs are no slopes."""
    arm = mechanisms.written(tmp_path, arm_text(FOUR_HINGES), "arm.xml")
    whole = printed(capsys, "check", arm, "--all")
    assert not any(line.startswith("wrong") or "sensitivities" in line for line in whole)


def test_json_is_complete(tmp_path, cli):
    path = tmp_path / "seven.xml"
    path.write_text(ranged())
    found = cli("check", path)
    rig = pamid.check(path)
    assert {row["port"] for row in found["ports"]} == {r["port"] for r in rig.to_dict()["ports"]}
    assert len(found["ports"]) > 25 and all(row["passes"] for row in found["ports"])
    assert sum("is not enforced" in f["detail"] for f in found["findings"]) == 7


def test_a_rig_that_fits_the_screen_is_shown_whole(capsys):
    cart = Path(__file__).parents[2] / "data" / "rigs" / "cart.py"
    assert printed(capsys, "check", cart) == printed(capsys, "check", cart, "--all")
    motor = Path(__file__).parents[2] / "pamid" / "rigs" / "dc_motor.py"
    assert (
        len(printed(capsys, "check", motor))
        <= LINES
        < len(printed(capsys, "check", motor, "--all"))
    )


def finding(check: str, detail: str, **more: Any) -> dict[str, Any]:
    return {"check": check, "ok": False, "advice": True, "detail": detail, **more}


@pytest.mark.parametrize("ports", [1, 60])
@pytest.mark.parametrize("notes", [1, 60])
def test_no_number_of_ports_and_notes_exceeds_the_screen(ports, notes):
    words = [f"{'ab' * (k + 1)} differs" for k in range(notes)]
    said: dict[str, Any] = {
        "file": "rig.py",
        "ok": False,
        "findings": [
            *(finding("remark", text) for text in words),
            finding("finite", "it blows up", advice=False),
            {"check": "equations", "ok": True, "advice": False, "detail": "built"},
        ],
        "ports": [
            {
                "port": f"p{k}",
                "kind": "motion",
                "unit": "N",
                "signals": {},
                "passes": "a force",
                "sign": "along",
                "imposed": False,
                "effects": [f"effect-{k}-{i}" for i in range(40)],
                "unlocks": [],
            }
            for k in range(ports)
        ],
    }
    lines = inspection_text(said, everything=False).splitlines()
    assert len(lines) <= SCREEN
    assert lines[1] == "wrong  finite: it blows up"
    assert lines[-1].startswith("1 problem" if not notes else f"{notes} note")
    assert any(line.startswith("port ") for line in lines)
    assert "ok     equations: built" in lines


def test_a_long_story_of_a_rig_groups_ports_and_leaves_equations_out(tmp_path, capsys):
    path = tmp_path / "seven.xml"
    path.write_text(ranged())
    short, whole = printed(capsys, "rigs", path), printed(capsys, "rigs", path, "--all")
    assert len(short) < 160 < len(whole)
    assert short[-1].startswith("Equations (SI): ") and "--all" in short[-1]
    assert sum(": transmission [N m]" in line for line in whole) <= 1
    one_dof = printed(capsys, "rigs", "one-dof")
    assert one_dof == printed(capsys, "rigs", "one-dof", "--all")
