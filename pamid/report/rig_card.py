"""Diagram of a rig for a notebook: one SVG with its style, which adopts the text colour of its
surroundings and has no links."""

from __future__ import annotations

from markupsafe import Markup

from pamid.report.block_diagram import LINE, PAD, Box, Diagram, Link, wide_diagram
from pamid.report.markup import tag
from pamid.report.rig_figure import BASE, DIAGRAM_WIDE, TINT, arrow_head, link_path, rig_title
from pamid.report.rig_texts import block_texts
from pamid.report.style import colour
from pamid.schemas.diagnosis_file import DiagnosisFile

_ARROW = "pamid-arrow"
_SVG_STYLE = "max-width:56em;width:100%;height:auto;display:block;margin:.5em 0"


def rig_svg(diagnosis: DiagnosisFile | None) -> str:
    """The diagram as HTML; "" if the run does not say which ports its rig has."""
    if diagnosis is None or diagnosis.rig is None or not diagnosis.rig.ports:
        return ""
    rig = diagnosis.rig
    diagram = wide_diagram(rig, block_texts(diagnosis, rig), DIAGRAM_WIDE)
    heads = [
        tag("text", text, x=f"{x:.0f}", y=f"{y:.0f}", font_size="10", fill_opacity="0.8")
        for x, y, text in diagram.heads
    ]
    return str(_drawn(diagram, rig_title(diagnosis, rig), heads))


def _drawn(diagram: Diagram, title: str, heads: list[Markup]) -> Markup:
    return tag(
        "svg",
        tag("defs", arrow_head(_ARROW, fill="currentColor")),
        heads,
        [_link(link) for link in diagram.links],
        [_block(box) for box in diagram.boxes],
        viewBox=f"-2 0 {diagram.wide + 4.0:.0f} {diagram.tall:.0f}",
        role="img",
        aria_label=title,
        style=_SVG_STYLE,
        font_family="sans-serif",
        text_anchor="middle",
        fill="currentColor",
    )


def _link(link: Link) -> Markup:
    more = {"marker_start": f"url(#{_ARROW})"} if link.both else {}
    return tag(
        "path",
        d=link_path(link),
        fill="none",
        stroke="currentColor",
        stroke_opacity="0.7",
        stroke_width="3" if link.broad else "1.2",
        marker_end=f"url(#{_ARROW})",
        **more,
    )


def _block(box: Box) -> Markup:
    frame = tag(
        "rect",
        x=f"{box.x:.1f}",
        y=f"{box.y:.1f}",
        width=f"{box.wide:.1f}",
        height=f"{box.tall:.1f}",
        rx="6",
        fill=colour("with_cause"),
        fill_opacity=f"{TINT * min(1.0, box.weight):.2f}",
        stroke=colour("with_cause") if box.named else "currentColor",
        stroke_width="2.5" if box.named else "1",
    )
    lines = [
        tag(
            "text",
            text,
            x=f"{box.x + 0.5 * box.wide:.1f}",
            y=f"{box.y + PAD + LINE * k + BASE:.1f}",
            font_size="11.5" if style == "title" else "10.5",
            font_weight="bold" if style else "normal",
        )
        for k, (text, style) in enumerate(box.texts)
    ]
    return tag("g", frame, lines)
