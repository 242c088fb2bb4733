"""The rig as a block diagram: which port leads to which, where the blocks stand, what they say."""

import itertools
import re

import pytest
from synthetic_run import diagnosis_json

from pamid.base.schemas.diagnosis_file import DiagnosisFile
from pamid.base.schemas.model import read
from pamid.base.schemas.rig_map import RigMap
from pamid.model.port_flow import rig_map
from pamid.model.registry import rig_named, rigs
from pamid.report.block_diagram import (
    BlockText,
    Box,
    columns_of,
    links_of,
    narrow_diagram,
    wide_diagram,
)
from pamid.report.rig_figure import anchor, block_texts, panels_html, rig_drawing, rig_svg
from pamid.report.style import page_svg

EACH_DIAGRAM = ("dc-motor", "two-masses", "damper-bench", "geared-motor", "cylinder-bench", "servo")


def map_of(name: str) -> RigMap:
    rig = rig_named(name)
    return rig_map(rig, rig.outputs)


def plain_texts(rig: RigMap) -> dict[str, BlockText]:
    groups = dict.fromkeys(one.group or one.port for one in rig.ports)
    return {group: BlockText(group, (("0 % of gap", ""),)) for group in groups}


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
def test_a_way_of_arrows_leads_wherever_one_equation_feeds_another(name):
    """The fewest arrows, but no block without one, and no feedback that is not to be seen."""
    rig = map_of(name)
    group = {one.port: one.group or one.port for one in rig.ports}
    links = links_of(rig, columns_of(rig))
    drawn = {(a, b) for a, b, _ in links} | {(b, a) for a, b, both in links if both}
    for one in rig.ports:
        fed = {group[other] for other in one.leads_to} - {group[one.port]}
        assert fed <= way(group[one.port], drawn), one.port
    assert {name for link in drawn for name in link} == set(group.values())


def test_a_sensor_that_was_not_recorded_has_no_block():
    rig = rig_named("thermal-two-mass")
    ports = {one.port for one in rig_map(rig, ("body_temperature_degc",)).ports}
    assert ports == {"heater", "element", "body", "body_sensor"}
    upper = rig_map(rig_named("cascaded-tanks"), ("upper_level_cm",))
    assert {one.port for one in upper.ports} == {"pump", "inlet", "pipe", "upper", "upper_gauge"}
    assert all(other != "lower" for one in upper.ports for other in one.leads_to)


def overlap(a: Box, b: Box) -> bool:
    return a.x < b.x + b.wide and b.x < a.x + a.wide and a.y < b.y + b.tall and b.y < a.y + a.tall


@pytest.mark.parametrize("name", ["one-dof", "two-link", *EACH_DIAGRAM])
def test_blocks_never_overlap_and_stay_inside(name):
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


def diagnosis_of(verdict: str) -> DiagnosisFile:
    return read(DiagnosisFile, diagnosis_json(verdict))


def test_effects_are_pinned_where_they_act_and_tints_are_shares():
    found = diagnosis_of("partly-explained")
    assert found.rig is not None and found.where is not None
    texts = block_texts(found, found.rig)
    shares = {one.port: one.share for one in found.where.ports}
    assert texts["joint"].weight == shares["joint"]
    pins = [text for text, style in texts["joint"].lines if style == "pin"]
    assert pins[0] == "◆ Coulomb friction"
    assert any(text.startswith("? ") for text, _ in texts["muscle"].lines)
    assert not texts["valve"].named


def test_every_block_leads_to_a_panel_that_is_there():
    found = diagnosis_of("explained")
    drawing, panels = rig_drawing(found), str(panels_html(found))
    assert drawing is not None
    for svg in (page_svg(drawing), page_svg(drawing, narrow=False)):
        targets = re.findall(r'href="#([^"]+)"', svg)
        assert len(targets) == 5
        assert all(f'id="{one}"' in panels for one in targets)
    assert panels.count("port-panel shown") == 1
    assert f'class="port-panel shown" id="{anchor("joint")}"' in panels


def test_a_run_of_an_earlier_version_has_no_diagram():
    content = diagnosis_json("explained")
    del content["rig"]
    found = read(DiagnosisFile, content)
    assert rig_drawing(found) is None and str(panels_html(found)) == "" == rig_svg(found)


def test_names_from_a_file_are_text():
    content = diagnosis_json("explained")
    content["rig"]["ports"][3] |= {"group": "<script>alert(1)</script>"}
    found = read(DiagnosisFile, content)
    drawing = rig_drawing(found)
    assert drawing is not None
    assert "<script" not in page_svg(drawing) + str(panels_html(found)) + rig_svg(found)


@pytest.mark.parametrize("name", ["geared-motor", "one-dof", "muscle-mass", "two-masses", "servo"])
def test_arrows_pass_no_block_that_they_do_not_join(name):
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
