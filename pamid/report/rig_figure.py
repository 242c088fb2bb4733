"""The rig as a block diagram: its ports from the command to the sensors, tinted by their share of
the gap, the effects where they act. One layout is drawn twice: for the page, where a block leads to
its evidence, and with matplotlib for PNG, PDF and notebooks."""

from __future__ import annotations

from dataclasses import replace

from markupsafe import Markup
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch
from matplotlib.path import Path

from pamid.report import formatting
from pamid.report.block_diagram import (
    LINE,
    PAD,
    BlockText,
    Box,
    Diagram,
    Link,
    narrow_diagram,
    wide_diagram,
)
from pamid.report.formatting import percent
from pamid.report.markup import paragraphs, tag
from pamid.report.rig_texts import block_texts, port_evidence_texts
from pamid.report.style import NARROW_IN, WIDE_IN, Drawing, colour
from pamid.schemas.diagnosis_file import DiagnosisFile
from pamid.schemas.rig_map import RigMap

DIAGRAM_WIDE, _DIAGRAM_NARROW = 920.0, 340.0
TINT = 0.5  # opacity of a block that holds the whole gap
BASE = 11.0  # from the top of a line to its letters' foot


def rig_drawing(diagnosis: DiagnosisFile | None) -> Drawing | None:
    """The diagram; None if the run does not say which ports its rig has."""
    if diagnosis is None or diagnosis.rig is None or not diagnosis.rig.ports:
        return None
    rig, texts = diagnosis.rig, block_texts(diagnosis, diagnosis.rig)
    wide, narrow = (
        wide_diagram(rig, texts, DIAGRAM_WIDE),
        narrow_diagram(rig, texts, _DIAGRAM_NARROW),
    )

    svgs = (_svg(wide, "wide"), _svg(narrow, "narrow"))
    return replace(_drawing(rig_title(diagnosis, rig), wide, narrow), own=svgs)


def bare_rig_drawing(rig: RigMap) -> Drawing:
    """The rig by itself, before anything was recorded: its ports with their units."""
    units: dict[str, list[str]] = {}
    for port in rig.ports:
        units.setdefault(port.group or port.port, []).append(formatting.unit_label(port.unit))
    texts = {
        group: BlockText(
            formatting.port_label(group),
            tuple((f"[{unit}]", "") for unit in dict.fromkeys(symbols) if unit),
        )
        for group, symbols in units.items()
    }
    return _drawing(
        _plain_title(rig),
        wide_diagram(rig, texts, DIAGRAM_WIDE),
        narrow_diagram(rig, texts, _DIAGRAM_NARROW),
    )


def _drawing(title: str, wide: Diagram, narrow: Diagram) -> Drawing:
    def draw(figure: Figure, is_narrow: bool) -> None:
        _drawn(figure, narrow if is_narrow else wide)

    return Drawing(
        "rig",
        title,
        draw,
        WIDE_IN * wide.tall / wide.wide,
        NARROW_IN * narrow.tall / narrow.wide,
    )


def _plain_title(rig: RigMap) -> str:
    return f"The rig {formatting.clean(rig.name)}, from what is sent to it to what is measured"


def rig_title(diagnosis: DiagnosisFile, rig: RigMap) -> str:
    """ "The rig one-dof and where the gap enters it: joint 60 %, muscle 20 %"."""
    name = formatting.clean(rig.name)
    if diagnosis.where is None or diagnosis.remark or diagnosis.verdict == "no-structural-gap":
        return _plain_title(rig)
    where = diagnosis.where  # of shares that read alike the named port's comes first
    shares = sorted(where.ports, key=lambda item: (-round(item.share, 2), item.port != where.port))
    parts = [
        f"{formatting.port_label(share.port)} {percent(share.share)}"
        for share in shares[:3]
        if share.share >= 0.05
    ]
    return f"The rig {name} and where the gap enters it: {', '.join(parts) or 'nowhere alone'}"


def panels_html(diagnosis: DiagnosisFile) -> Markup:
    """Panels below a diagram: one per group of ports, that of the named port shown first."""
    rig = diagnosis.rig
    if rig is None or not rig.ports:
        return Markup("")
    texts = block_texts(diagnosis, rig)
    first = diagnosis.where.port if diagnosis.where is not None else ""
    panels = []
    for group, text in texts.items():
        share = ": " + text.lines[0][0] if text.lines else ""
        panels.append(
            tag(
                "div",
                tag("b", f"{text.title}{share.replace(' of gap', ' of the gap')}"),
                paragraphs(port_evidence_texts(diagnosis, rig, group)),
                class_="port-panel shown" if group == first else "port-panel",
                id=anchor(group),
                tabindex="-1",
            )
        )
    hint = tag(
        "p",
        "Choose a block to see what is known of it. ◆ marks an effect where it acts, ? what is "
        "left without a cause.",
        class_="note no-print",
    )
    return tag("div", hint, panels, class_="port-panels")


def anchor(group: str) -> str:
    """Place of a group's evidence on the page."""
    return "at-" + "".join(c if c.isascii() and c.isalnum() else "-" for c in group)


# ---- for the page --------------------------------------------------------------------------------


def arrow_head(name: str, **look: str) -> Markup:
    """The marker at the end of a link; look: attributes of its shape."""
    return tag(
        "marker",
        tag("path", d="M0 0L8 4L0 8z", **look),
        id=name,
        viewBox="0 0 8 8",
        refX="7",
        refY="4",
        markerWidth="7",
        markerHeight="7",
        orient="auto-start-reverse",
    )


def _svg(diagram: Diagram, salt: str) -> str:
    head = f"arrow-{salt}"
    heads = [
        tag("text", text, x=f"{x:.0f}", y=f"{y:.0f}", class_="stage-name", text_anchor="middle")
        for x, y, text in diagram.heads
    ]
    return str(
        tag(
            "svg",
            tag("defs", arrow_head(head)),
            heads,
            [_arrow(link, head) for link in diagram.links],
            [_block(box) for box in diagram.boxes],
            viewBox=f"0 0 {diagram.wide:.0f} {diagram.tall:.0f}",
            class_="rig-map",
        )
    )


def _arrow(link: Link, head: str) -> Markup:
    more = {"marker_start": f"url(#{head})"} if link.both else {}
    return tag(
        "path",
        d=link_path(link),
        class_="link broad" if link.broad else "link",
        marker_end=f"url(#{head})",
        **more,
    )


def link_path(link: Link) -> str:
    (x, y), (u, v) = link.begin, link.end
    if link.corners:
        turns = "".join(f"L{p:.1f} {q:.1f}" for p, q in link.corners)
        return f"M{x:.1f} {y:.1f}{turns}L{u:.1f} {v:.1f}"
    if abs(x - u) < 1.0 or abs(y - v) < 1.0:
        return f"M{x:.1f} {y:.1f}L{u:.1f} {v:.1f}"
    bend = 0.5 * (u - x)
    return f"M{x:.1f} {y:.1f}C{x + bend:.1f} {y:.1f} {u - bend:.1f} {v:.1f} {u:.1f} {v:.1f}"


def _block(box: Box) -> Markup:
    middle = f"{box.x + 0.5 * box.wide:.1f}"
    lines = [
        tag(
            "text",
            text,
            x=middle,
            y=f"{box.y + PAD + LINE * k + BASE:.1f}",
            class_=style or "share",
            text_anchor="middle",
        )
        for k, (text, style) in enumerate(box.texts)
    ]
    place = {
        "x": f"{box.x:.1f}",
        "y": f"{box.y:.1f}",
        "width": f"{box.wide:.1f}",
        "height": f"{box.tall:.1f}",
        "rx": "6",
    }
    tint = tag("rect", class_="tint", fill_opacity=f"{TINT * min(1.0, box.weight):.2f}", **place)
    frame = tag("rect", class_="frame named" if box.named else "frame", **place)
    return tag(
        "a",
        tag("rect", class_="ground", **place),
        tint,
        frame,
        [(line, " ") for line in lines],  # what is read aloud is what is seen, word by word
        href=f"#{anchor(box.members[0])}",
        class_="block",
    )


# ---- with matplotlib -----------------------------------------------------------------------------


def _drawn(figure: Figure, diagram: Diagram) -> None:
    axes = figure.subplots()
    axes.set_axis_off()
    axes.set_aspect("equal")
    axes.set_xlim(-1.5, diagram.wide + 1.5)  # frames have a width of their own
    axes.set_ylim(diagram.tall, 0.0)
    points = 72.0 * figure.get_figwidth() / diagram.wide  # per unit of the diagram
    for x, y, text in diagram.heads:
        axes.text(x, y, text, ha="center", fontsize=10.0 * points, color=colour("muted"))
    for link in diagram.links:
        axes.add_patch(
            FancyArrowPatch(
                path=Path([link.begin, *link.corners, link.end]),
                arrowstyle="<|-|>" if link.both else "-|>",
                mutation_scale=9.0 * points,
                linewidth=(3.0 if link.broad else 1.2) * points,
                edgecolor=colour("muted"),
                facecolor="none" if link.corners else colour("muted"),
            )
        )
    for box in diagram.boxes:
        axes.add_patch(
            FancyBboxPatch(
                (box.x + 5.0, box.y + 5.0),
                box.wide - 10.0,
                box.tall - 10.0,
                boxstyle="round,pad=5",
                facecolor=_blended(TINT * min(1.0, box.weight)),
                edgecolor=colour("with_cause" if box.named else "muted"),
                linewidth=(2.0 if box.named else 1.0) * points,
            )
        )
        for k, (text, style) in enumerate(box.texts):
            axes.text(
                box.x + 0.5 * box.wide,
                box.y + PAD + LINE * k + BASE,
                text,
                ha="center",
                fontsize=(11.5 if style == "title" else 10.5) * points,
                fontweight="bold" if style else "normal",
                color=colour("ink"),
            )


def _blended(share: float) -> str:
    """The tint on paper, opaque."""
    tint, paper = to_rgb(colour("with_cause")), to_rgb(colour("paper"))
    red, green, blue = (share * a + (1.0 - share) * b for a, b in zip(tint, paper, strict=True))
    return str(to_hex((red, green, blue)))
