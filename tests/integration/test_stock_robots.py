"""The table of stock robots: what a row says of a file."""

from types import ModuleType

import mechanisms
import pytest
from scripts import load_script

pytest.importorskip("mujoco", reason="pip install 'pamid[mujoco]'")

CLOSED = mechanisms.TWO.replace(
    "</worldbody>",
    '</worldbody><equality><connect body1="forearm" body2="world" anchor="0 0 -0.3"/></equality>',
)


@pytest.fixture(scope="module")
def stock() -> ModuleType:
    return load_script("stock_robots.py")


@pytest.mark.parametrize(
    ("text", "cells"),
    [
        (mechanisms.TWO, ("yes", "equations", "2", "")),
        (CLOSED, ("yes", "stepped", "2", "equality 'equality_0'")),
        ("<mujoco><joint/></mujoco>", ("no", "", "", "robot.xml: MuJoCo cannot read it")),
    ],
    ids=["equations", "stepped", "wrong"],
)
def test_a_row_says_what_becomes_of_a_file(stock, tmp_path, text, cells):
    (tmp_path / "robot.xml").write_text(text)
    row = stock.stock_row("Arm", tmp_path / "robot.xml")
    shown = [cell.strip() for cell in str(row).strip("|").split("|")]
    assert shown[0] == "Arm" and shown[1:4] == list(cells[:3]) and shown[4].startswith(cells[3])
    assert len(shown) == stock.HEAD.count("|") - 1
    assert (row.read, row.compiled) == (cells[0] == "yes", cells[1] == "equations")


def test_a_file_that_is_not_there_is_a_row(stock, tmp_path):
    rows = stock.table_of(tmp_path, {"Arm": "arm/robot.xml"}, check=False)
    assert "no such file: arm/robot.xml" in str(rows[0])
    assert stock.summary(rows) == "0 of 1 read, 0 of 1 as equations"
    assert len(stock.ELEVEN) == 11
