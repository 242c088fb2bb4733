"""The rig as a block diagram: its ports from the command to the sensors, tinted by their share of
the gap, the effects where they act. On the page every block leads to a panel with its evidence: the
effects that act there, the candidates tried, and indistinguishable ports."""

from __future__ import annotations

from typing import Any

from markupsafe import Markup
from matplotlib.artist import Artist
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch
from matplotlib.path import Path

from pamid.base.errors import join_words
from pamid.base.schemas.diagnosis_file import DiagnosisFile
from pamid.base.schemas.rig_map import RigMap
from pamid.base.share_words import chance_text
from pamid.diagnosis.verdict.verdict_words import chance_figure
from pamid.model.effect import KINDS
from pamid.report import formatting
from pamid.report.block_diagram import (
    LINE,
    PAD,
    BlockText,
    Diagram,
    columns_of,
    narrow_diagram,
    wide_diagram,
)
from pamid.report.captions import first_parameter, ports_text, sensor_label
from pamid.report.formatting import (
    channel_unit,
    effect_label,
    percent,
    port_label,
    sentence,
    with_unit_text,
)
from pamid.report.formula import formula_text
from pamid.report.markup import paragraphs, tag
from pamid.report.style import (
    NARROW_IN,
    WIDE_IN,
    Drawing,
    Look,
    colour,
    notebook_svg,
    page_svg,
    write,
)

DIAGRAM_WIDE, _DIAGRAM_NARROW = 920.0, 340.0
TINT = 0.5  # opacity of a block that holds the whole gap
_EDGES_IN = 0.083  # that matplotlib leaves above and below
BASE = 11.0  # from the top of a line to its letters' foot
PIN, DOUBT = "◆ ", "? "
_MOST_TRIED = 4
_ABOVE = 10.0  # the blocks, and what of them is a link, in the order in which they are drawn


def rig_drawing(diagnosis: DiagnosisFile | None, *, linked: bool = True) -> Drawing | None:
    """The diagram; None if the run does not say which ports its rig has, or of which kinds."""
    if diagnosis is None or diagnosis.rig is None or not columns_of(diagnosis.rig):
        return None
    rig = diagnosis.rig
    return _drawing(rig, _title(diagnosis, rig), block_texts(diagnosis, rig), linked=linked)


def bare_rig_drawing(rig: RigMap) -> Drawing:
    """The rig by itself, before anything was recorded: its ports with their units."""
    units: dict[str, list[str]] = {}
    for port in rig.ports:
        units.setdefault(port.group or port.port, []).append(formatting.unit_label(port.unit))
    texts = {
        group: BlockText(
            port_label(group), tuple((f"[{unit}]", "") for unit in dict.fromkeys(symbols) if unit)
        )
        for group, symbols in units.items()
    }
    return _drawing(rig, _title(None, rig), texts, linked=False)


def rig_svg(diagnosis: DiagnosisFile | None) -> str:
    """The diagram for a notebook, without links; "" if the run does not state its ports."""
    drawing = rig_drawing(diagnosis, linked=False)
    if drawing is None:
        return ""
    svg, style = notebook_svg(page_svg(drawing, narrow=False)), "max-width:56em;margin:.5em 0"
    return str(tag("div", Markup(svg), role="img", aria_label=drawing.title, style=style))


def _title(diagnosis: DiagnosisFile | None, rig: RigMap) -> str:
    """ "The rig one-dof and where the gap enters it: joint 60 %, muscle 20 %"."""
    name = formatting.clean(rig.name)
    if diagnosis is None or not _shares(diagnosis) or diagnosis.where is None:
        return f"The rig {name}, from what is sent to it to what is measured"
    where = diagnosis.where  # of shares that read alike the named port's comes first
    shares = sorted(where.ports, key=lambda item: (-round(item.share, 2), item.port != where.port))
    parts = [
        f"{port_label(share.port)} {percent(share.share)}"
        for share in shares[:3]
        if share.share >= 0.05
    ]
    return f"The rig {name} and where the gap enters it: {', '.join(parts) or 'nowhere alone'}"


# ---- drawing -------------------------------------------------------------------------------------


class _Anchor(Artist):
    """The beginning of a link of an SVG, or its end where it leads nowhere."""

    def __init__(self, zorder: float, place: str = "") -> None:
        super().__init__()
        self._place = place
        self.set_zorder(zorder)
        self.set_in_layout(False)

    def draw(self, renderer: Any) -> None:
        writer = getattr(renderer, "writer", None)
        if writer is not None and self._place:
            writer.start("a", attrib={"href": f"#{self._place}", "class": "block"})
        elif writer is not None:
            writer.end("a")


def _drawing(rig: RigMap, title: str, texts: dict[str, BlockText], *, linked: bool) -> Drawing:
    wide = wide_diagram(rig, texts, DIAGRAM_WIDE)
    narrow = narrow_diagram(rig, texts, _DIAGRAM_NARROW)

    def draw(figure: Figure, is_narrow: bool) -> None:
        _draw(figure, narrow if is_narrow else wide, linked)

    tall = WIDE_IN * wide.tall / wide.wide + _EDGES_IN
    narrow_tall = NARROW_IN * narrow.tall / narrow.wide + _EDGES_IN
    return Drawing("rig", title, draw, tall, narrow_tall, linked=linked)


def _draw(figure: Figure, diagram: Diagram, linked: bool) -> None:
    axes = figure.subplots()
    axes.set_axis_off()
    axes.set_aspect("equal")
    axes.set_xlim(-1.5, diagram.wide + 1.5)  # frames have a width, too
    axes.set_ylim(diagram.tall, 0.0)
    points = 72.0 * figure.get_figwidth() / diagram.wide  # per unit of the diagram
    for x, y, text in diagram.heads:
        write(axes, x, y, text, "muted", 10.0 * points, ha="center", va="baseline")
    for link in diagram.links:
        (x, y), (u, v) = link.begin, link.end
        path = Path([link.begin, *link.corners, link.end])
        if not link.corners and abs(x - u) >= 1.0 and abs(y - v) >= 1.0:
            bend = 0.5 * (u - x)
            curve = [Path.MOVETO, Path.CURVE4, Path.CURVE4, Path.CURVE4]
            path = Path([(x, y), (x + bend, y), (u - bend, v), (u, v)], curve)
        axes.add_patch(
            FancyArrowPatch(
                path=path,
                arrowstyle="<|-|>" if link.both else "-|>",
                mutation_scale=9.0 * points,
                linewidth=(3.0 if link.broad else 1.2) * points,
                edgecolor=colour("muted"),
                facecolor="none" if link.corners else colour("muted"),
            )
        )
    for k, box in enumerate(diagram.boxes):
        look: Look = {
            "facecolor": to_rgba(colour("with_cause"), TINT * min(1.0, box.weight)),
            "edgecolor": colour("with_cause" if box.named else "muted"),
            "linewidth": (2.0 if box.named else 1.0) * points,
        }
        corner, size = (box.x + 5.0, box.y + 5.0), (box.wide - 10.0, box.tall - 10.0)
        frame = FancyBboxPatch(corner, *size, boxstyle="round,pad=5", zorder=_ABOVE + k, **look)
        if linked:
            axes.add_artist(_Anchor(_ABOVE + k, anchor(box.members[0])))
        axes.add_patch(frame)
        for n, (text, style) in enumerate(box.texts):
            place = box.x + 0.5 * box.wide, box.y + PAD + LINE * n + BASE
            size_pt = (11.5 if style == "title" else 10.5) * points
            shape: Look = {"ha": "center", "va": "baseline", "zorder": _ABOVE + k}
            write(
                axes, *place, text, size=size_pt, fontweight="bold" if style else "normal", **shape
            )
        if linked:
            axes.add_artist(_Anchor(_ABOVE + k))


# ---- blocks and panels ---------------------------------------------------------------------------


def block_texts(diagnosis: DiagnosisFile, rig: RigMap) -> dict[str, BlockText]:
    """Group of ports -> text of its block: the share of the gap, causes with their first value and
    probability, and the remainder."""
    shares, rest = _shares(diagnosis), diagnosis.remainder
    unseen = set(diagnosis.where.unseen) if diagnosis.where is not None else set()
    either = "either " if diagnosis.verdict == "ambiguous" else ""
    blocks = {}
    for group in dict.fromkeys(port.group or port.port for port in rig.ports):
        share, lines, pins = shares.get(group), [], []
        if shares and group in unseen and not share:
            lines.append("not seen")
        elif shares:
            lines.append("share unknown" if share is None else f"{percent(share)} of gap")
        for cause in diagnosis.causes:
            if cause.port == group:
                pins.append(f"{PIN}{either}{effect_label(cause.effect.partition('@')[0])}")
                if (parameter := first_parameter(cause)) is not None:
                    pins.append(with_unit_text(parameter[1].value, channel_unit(parameter[0])))
                if cause.probability is not None:
                    pins.append(f"P {chance_figure(cause.probability)}")
        if rest is not None and rest.real and rest.port == group and not diagnosis.remark:
            left = f"{percent(rest.share)} left" if diagnosis.causes else "gap"
            pins.append(f"{DOUBT}{left}, unexplained")
        texts = (*((line, "") for line in lines), *((pin, "pin") for pin in pins))
        weight = max(0.0, share or 0.0)
        blocks[group] = BlockText(port_label(group), texts, weight, named=bool(pins))
    return blocks


def _shares(diagnosis: DiagnosisFile) -> dict[str, float]:
    """Shares of the gap by group; none without a gap."""
    if diagnosis.where is None or diagnosis.remark or diagnosis.verdict == "no-structural-gap":
        return {}
    return {port.port: port.share for port in diagnosis.where.ports}


def panels_html(diagnosis: DiagnosisFile | None) -> Markup:
    """Panels below a diagram: a panel per group of ports, that of the named port shown first."""
    rig = diagnosis.rig if diagnosis is not None else None
    if diagnosis is None or rig is None or not rig.ports:
        return Markup("")
    first = diagnosis.where.port if diagnosis.where is not None else ""
    panels = []
    for group, text in block_texts(diagnosis, rig).items():
        share = f": {text.lines[0][0]}".replace(" of gap", " of the gap") if text.lines else ""
        panels.append(
            tag(
                "div",
                tag("b", f"{text.title}{share}"),
                paragraphs(port_evidence_texts(diagnosis, rig, group)),
                class_="port-panel shown" if group == first else "port-panel",
                id=anchor(group),
                tabindex="-1",
            )
        )
    hint = (
        "Choose a block to see what is known of it. ◆ marks an effect where it acts, ? what is "
        "left without a cause."
    )
    return tag("div", tag("p", hint, class_="note no-print"), panels, class_="port-panels")


def anchor(group: str) -> str:
    """Place of a group's evidence on the page."""
    return "at-" + "".join(c if c.isascii() and c.isalnum() else "-" for c in group)


def port_evidence_texts(diagnosis: DiagnosisFile, rig: RigMap, group: str) -> list[str]:
    """Sentences about a group of ports."""
    ports = [port for port in rig.ports if (port.group or port.port) == group]
    named = [
        port_label(port.port) + (f" [{unit}]" if (unit := formatting.unit_label(port.unit)) else "")
        for port in ports
    ]
    kinds = "; ".join(dict.fromkeys(KINDS.get(port.kind, port.kind) for port in ports))
    texts = [f"Quantity at this port: {kinds} ({join_words(named)})."]
    where, rest = diagnosis.where, diagnosis.remainder
    if where is not None:
        order = [port.port for port in where.ports]
        others = sorted(
            where.inseparable_from(group),
            key=lambda port: order.index(port) if port in order else len(order),
        )
        if others:
            texts.append(
                "For an effect of unknown form these sensors cannot separate it from "
                f"{ports_text(others)}."
            )
        for sensor in [s for s in where.sensors if any(group in g for g in s.splits)][:1]:
            name = sensor_label(sensor.sensor)
            texts.append(f"Measuring {name} as well would separate them.")
        if group in where.unseen:
            texts.append("These sensors do not respond to this port.")
    for cause in diagnosis.causes:
        if cause.port != group:
            continue
        text = f"{effect_label(cause.effect)} acts here"
        if cause.probability is not None:
            text += f", with probability {chance_text(cause.probability)}"
        if cause.removes is not None:
            text += f": it removes {percent(cause.removes.share)} of the gap"
        values = [formatting.parameter_text(name, size) for name, size in cause.parameters.items()]
        texts.append(sentence(text + (f"; {join_words(values)}" if values else "")))
    if rest is not None and rest.real and rest.port == group and rest.formula:
        texts.append(
            f"The remainder here is similar to {formula_text(formatting.clean(rest.formula))}."
        )
    tried = [
        f"{effect_label(candidate.effect)} ({percent(candidate.shrinkage)})"
        for candidate in diagnosis.ranking
        if candidate.port == group and candidate.shrinkage is not None
    ]
    if not tried:
        return [*texts, "No candidate at this port was promising enough for a refit."]
    more = f" and {len(tried) - _MOST_TRIED} more" if len(tried) > _MOST_TRIED else ""
    texts.append(
        "Refitted here, with the share of the held-out error over all channels that each removes: "
        f"{', '.join(tried[:_MOST_TRIED])}{more}."
    )
    return texts
