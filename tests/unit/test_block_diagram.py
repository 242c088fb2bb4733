"""The rig as a block diagram: which port leads to which, where the blocks stand, what they say."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

import pytest
from synthetic_run import diagnosis_json

from pamid.model.port_flow import rig_map
from pamid.model.registry import rig_named, rigs
from pamid.report.block_diagram import (
    MOST_IN_COLUMN,
    BlockText,
    Box,
    columns_of,
    links_of,
    narrow_diagram,
    wide_diagram,
)
from pamid.report.rig_card import rig_svg
from pamid.report.rig_figure import anchor, bare_rig_drawing, panels_html, rig_drawing, rig_title
from pamid.report.rig_texts import block_texts
from pamid.report.style import figure_of
from pamid.schemas.diagnosis_file import DiagnosisFile
from pamid.schemas.model import read
from pamid.schemas.rig_map import RigMap

ROOT = Path(__file__).resolve().parents[2]
EACH_DIAGRAM = ("dc-motor", "two-masses", "damper-bench", "geared-motor", "cylinder-bench", "servo")


def map_of(name: str) -> RigMap:
    rig = rig_named(name)
    return rig_map(rig, rig.outputs)


def plain_texts(rig: RigMap) -> dict[str, BlockText]:
    groups = dict.fromkeys(one.group or one.port for one in rig.ports)
    return {group: BlockText(group, (("0 % of gap", ""),)) for group in groups}


def test_the_equations_say_what_leads_to_what() -> None:
    rig = map_of("one-dof")
    leads = {one.port: set(one.leads_to) for one in rig.ports}
    assert leads["command"] == {"valve"}
    assert leads["valve"] == {"pressure"}
    assert {"muscle", "pressure_sensor"} <= leads["relief"]
    assert leads["angle_sensor"] == set()
    assert "angle_sensor" in leads["arm"] and "angle_sensor" not in leads["joint"]


def test_a_row_of_blocks_from_the_command_to_the_sensor() -> None:
    rig = map_of("one-dof")
    columns = columns_of(rig)
    assert [group for groups in columns.values() for group in groups] == [
        "command",
        "valve",
        "pressure",
        "muscle",
        "joint",
        "structure",
        "sensor",
    ]
    drawn = {(a, b) for a, b, _ in links_of(rig, columns)}
    assert {("command", "valve"), ("muscle", "joint"), ("joint", "structure")} <= drawn
    assert ("command", "pressure") not in drawn  # the valve stands between
    assert ("muscle", "structure") not in drawn  # the joint stands between


def way(begin: str, drawn: set[tuple[str, str]]) -> set[str]:
    """Blocks to which arrows lead from one."""
    seen, waiting = set[str](), [begin]
    while waiting:
        here = waiting.pop()
        after = {b for a, b in drawn if a == here} - seen
        seen |= after
        waiting += after
    return seen


@pytest.mark.parametrize("name", [n for n in rigs() if n != "two-link"])
def test_a_way_of_arrows_leads_wherever_one_equation_feeds_another(name: str) -> None:
    """The fewest arrows, but no block without one, and no feedback that is not to be seen."""
    rig = map_of(name)
    group = {one.port: one.group or one.port for one in rig.ports}
    links = links_of(rig, columns_of(rig))
    drawn = {(a, b) for a, b, _ in links} | {(b, a) for a, b, both in links if both}
    for one in rig.ports:
        fed = {group[other] for other in one.leads_to} - {group[one.port]}
        assert fed <= way(group[one.port], drawn), one.port
    assert {name for link in drawn for name in link} == set(group.values())


def test_blocks_that_feed_each_other_are_joined_both_ways() -> None:
    """Heat passes from element to body and back; a shoulder turns its elbow, and the reverse."""
    heat = map_of("thermal-two-mass")
    assert ("element", "body", True) in links_of(heat, columns_of(heat))
    ports = [
        {"port": "torque", "kind": "command", "leads_to": ["shoulder"]},
        {"port": "shoulder", "kind": "motion", "leads_to": ["elbow", "encoder"]},
        {"port": "elbow", "kind": "motion", "leads_to": ["shoulder"]},
        {"port": "encoder", "kind": "reading", "leads_to": []},
    ]
    arm = read(RigMap, {"name": "arm", "inputs": [], "outputs": [], "ports": ports})
    assert ("shoulder", "elbow", True) in links_of(arm, columns_of(arm))
    texts = plain_texts(arm)
    for diagram in (wide_diagram(arm, texts, 920.0), narrow_diagram(arm, texts, 340.0)):
        assert [one.both for one in diagram.links].count(True) == 1


def test_a_sensor_that_was_not_recorded_has_no_block() -> None:
    rig = rig_named("thermal-two-mass")
    ports = {one.port for one in rig_map(rig, ("body_temperature_degc",)).ports}
    assert ports == {"heater", "element", "body", "body_sensor"}
    upper = rig_map(rig_named("cascaded-tanks"), ("upper_level_cm",))
    assert {one.port for one in upper.ports} == {"pump", "inlet", "pipe", "upper", "upper_gauge"}
    assert all(other != "lower" for one in upper.ports for other in one.leads_to)


def overlap(a: Box, b: Box) -> bool:
    return a.x < b.x + b.wide and b.x < a.x + a.wide and a.y < b.y + b.tall and b.y < a.y + a.tall


@pytest.mark.parametrize("name", ["one-dof", "two-link", *EACH_DIAGRAM])
def test_blocks_never_overlap_and_stay_inside(name: str) -> None:
    rig = map_of(name)
    for diagram in (
        wide_diagram(rig, plain_texts(rig), 920.0),
        narrow_diagram(rig, plain_texts(rig), 340.0),
    ):
        for a, b in itertools.combinations(diagram.boxes, 2):
            assert not overlap(a, b), (a.name, b.name)
        for box in diagram.boxes:
            assert box.x >= -0.1 and box.x + box.wide <= diagram.wide + 0.1
            assert box.y >= -0.1 and box.y + box.tall <= diagram.tall + 0.1
        shown = {member for box in diagram.boxes for member in box.members}
        assert shown == {one.group or one.port for one in rig.ports}


def test_blocks_of_one_column_are_joined_where_one_leads_to_the_other() -> None:
    """Two tanks: what runs out of the upper one runs into the lower one."""
    rig = map_of(str(ROOT / "data" / "rigs" / "tanks.py"))
    texts = plain_texts(rig)
    pairs = {(a, b) for a, b, _ in links_of(rig, columns_of(rig))}
    assert ("upper", "lower") in pairs and ("lower", "upper") not in pairs
    wide = wide_diagram(rig, texts, 920.0)
    boxes = {box.name: box for box in wide.boxes}
    upper, lower = boxes["upper"], boxes["lower"]
    assert upper.x == lower.x
    assert any(
        one.begin[0] == one.end[0] and upper.y + upper.tall < one.begin[1] < one.end[1] < lower.y
        for one in wide.links
    )
    narrow = narrow_diagram(rig, texts, 340.0)
    assert any(one.begin[1] == one.end[1] for one in narrow.links)


def test_a_long_column_is_taken_together_but_for_what_matters() -> None:
    ports = [
        {"port": f"joint_{k}", "group": "", "kind": "motion", "unit": "N m", "leads_to": []}
        for k in range(60)
    ]
    rig = read(RigMap, {"name": "r", "inputs": [], "outputs": [], "ports": ports})
    texts = plain_texts(rig)
    texts["joint_7"] = BlockText("joint_7", (("40 % of gap", ""),), 0.4, named=True)
    boxes = wide_diagram(rig, texts, 920.0).boxes
    assert [box.name for box in boxes] == ["joint_7", "motion others"]
    assert boxes[1].texts[0][0] == "59 others" and len(boxes[1].members) == 59
    assert len(boxes) <= MOST_IN_COLUMN


def diagnosis_of(verdict: str) -> DiagnosisFile:
    return read(DiagnosisFile, diagnosis_json(verdict))


def test_effects_are_pinned_where_they_act_and_tints_are_shares() -> None:
    found = diagnosis_of("partly-explained")
    assert found.rig is not None and found.where is not None
    texts = block_texts(found, found.rig)
    shares = {one.port: one.share for one in found.where.ports}
    assert texts["joint"].weight == shares["joint"]
    pins = [text for text, style in texts["joint"].lines if style == "pin"]
    assert pins[0] == "◆ Coulomb friction"
    assert any(text.startswith("? ") for text, _ in texts["muscle"].lines)
    assert not texts["valve"].named


def test_nothing_is_tinted_where_there_is_no_gap() -> None:
    found = diagnosis_of("no-structural-gap")
    assert found.rig is not None
    texts = block_texts(found, found.rig)
    assert all(one.weight == 0.0 and not one.lines for one in texts.values())


def test_every_block_leads_to_a_panel_that_is_there() -> None:
    found = diagnosis_of("explained")
    drawing, panels = rig_drawing(found), str(panels_html(found))
    assert drawing is not None and drawing.own is not None
    for svg in drawing.own:
        targets = re.findall(r'href="#([^"]+)"', svg)
        assert len(targets) == 5
        assert all(f'id="{one}"' in panels for one in targets)
    assert panels.count("port-panel shown") == 1
    assert f'class="port-panel shown" id="{anchor("joint")}"' in panels


def test_the_diagram_of_a_notebook_leads_nowhere_and_has_its_text() -> None:
    found = diagnosis_of("explained")
    svg = rig_svg(found)
    assert "href=" not in svg and "class=" not in svg and "<script" not in svg
    title = rig_title(found, found.rig)  # type: ignore[arg-type]
    assert f'aria-label="{title}"' in svg and 'role="img"' in svg
    assert ">◆ Coulomb<" in svg or ">◆ Coulomb friction<" in svg
    assert svg.count("<g>") == 5


def test_a_rig_by_itself_shows_its_units_and_no_share() -> None:
    drawing = bare_rig_drawing(map_of("one-dof"))
    figure = figure_of(drawing)
    texts = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert "joint" in texts and "[N m]" in texts and not [one for one in texts if "%" in one]
    assert drawing.own is None and drawing.title.startswith("The rig one-dof, from what is sent")


def test_a_run_of_an_earlier_version_has_no_diagram() -> None:
    content = diagnosis_json("explained")
    del content["rig"]
    found = read(DiagnosisFile, content)
    assert rig_drawing(found) is None and str(panels_html(found)) == "" == rig_svg(found)


def test_names_from_a_file_are_text() -> None:
    content = diagnosis_json("explained")
    content["rig"]["ports"][3] |= {"group": "<script>alert(1)</script>"}
    found = read(DiagnosisFile, content)
    drawing = rig_drawing(found)
    assert drawing is not None and drawing.own is not None
    assert "<script" not in "".join(drawing.own) + str(panels_html(found)) + rig_svg(found)


@pytest.mark.parametrize("name", ["geared-motor", "one-dof", "muscle-mass", "two-masses", "servo"])
def test_arrows_pass_no_block_that_they_do_not_join(name: str) -> None:
    """Points along an arrow between two columns lie in no block."""
    rig = map_of(name)
    diagram = wide_diagram(rig, plain_texts(rig), 920.0)
    for link in diagram.links:
        ways = list(itertools.pairwise([link.begin, *link.corners, link.end]))
        if not link.corners and link.begin[0] == link.end[0]:
            continue  # within a column
        for (x, y), (u, v) in ways:
            for k in range(21):
                p, q = x + 0.05 * k * (u - x), y + 0.05 * k * (v - y)
                for box in diagram.boxes:
                    inside = box.x < p < box.x + box.wide and box.y < q < box.y + box.tall
                    assert not inside, (link, box.name)
        assert all(0.0 <= q <= diagram.tall for _, q in link.corners)
