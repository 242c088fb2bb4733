"""Where the blocks of a rig's diagram stand: columns in the order in which a signal passes, from
the command to the sensors, and the arrows between them.

Blocks are groups of ports, the names under which shares of the gap are reported. Wherever the value
of a block enters the equation of another block, a way of arrows leads from the first to the second:
directly, or through blocks between them.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from pamid.base.schemas.rig_map import RigMap

#: kinds of ports in the order in which a signal passes, and what stands above their column
STAGES = {
    "command": "command",
    "flow": "flow",
    "rate": "store",
    "actuator-force": "drive",
    "motion": "motion",
    "transmission": "transmission",
    "reading": "sensor",
}
MOST_IN_COLUMN = 6
MOST_LINKS = 14  # between all columns; more become a broad arrow per pair of columns
LINE, PAD, HEAD_ROOM, GAP_Y, GAP_X = 15.0, 8.0, 22.0, 12.0, 26.0
_EM, _EM_BOLD = 6.9, 7.6  # width of a letter in the diagram's units, upright and bold
_MOST_WIDE, _LEAST_WIDE = 190.0, 92.0
#: of an arrow that passes below: from a block to its first turn, and between two such arrows
STUB, NEXT_LINE, STUBS = 8.0, 5.0, 3
LOWER = 0.75  # of a block's height: where it leaves and enters
CLEARANCE, WAY_POINTS = 3.0, 40  # of an arrow to a box; points at which that is looked for
_FEW = 5  # columns that leave room for long arrows


@dataclass(frozen=True)
class BlockText:
    """Text in a block. lines: (text, style), style "" or "pin"; weight: share of the gap that tints
    it; members: the groups in it, several where they stand together."""

    title: str
    lines: tuple[tuple[str, str], ...]
    weight: float = 0.0
    members: tuple[str, ...] = ()
    named: bool = False


@dataclass(frozen=True)
class Box:
    """A block in its place; x, y: upper left corner; texts: (text, style) line by line, style
    "title", "" or "pin"."""

    name: str
    x: float
    y: float
    wide: float
    tall: float
    texts: tuple[tuple[str, str], ...]
    weight: float
    named: bool
    members: tuple[str, ...]


@dataclass(frozen=True)
class Link:
    """An arrow between two points. both: with a head at either end; broad: for many arrows;
    corners: points at which it turns below a block in its way."""

    begin: tuple[float, float]
    end: tuple[float, float]
    both: bool = False
    broad: bool = False
    corners: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class Diagram:
    """heads: (x of the middle, y, text) above columns."""

    wide: float
    tall: float
    boxes: tuple[Box, ...]
    links: tuple[Link, ...]
    heads: tuple[tuple[float, float, str], ...] = ()


def columns_of(rig: RigMap) -> dict[str, list[str]]:
    """Kind -> groups of ports in its column, in the rig's order. A group of several kinds is in the
    last of their columns; it is with the sensors only if all its ports are readings."""
    order = list(STAGES)
    kinds: dict[str, list[str]] = {}
    for port in rig.ports:
        kinds.setdefault(port.group or port.port, []).append(port.kind)
    columns: dict[str, list[str]] = {kind: [] for kind in order}
    for group, group_kinds in kinds.items():
        known = [kind for kind in group_kinds if kind in order]
        acting = [kind for kind in known if kind != "reading"]
        if known:
            columns[max(acting or known, key=order.index)].append(group)
    return {kind: groups for kind, groups in columns.items() if groups}


def links_of(rig: RigMap, columns: dict[str, list[str]]) -> list[tuple[str, str, bool]]:
    """(from, to, both ways) between groups: the fewest arrows by which every block that feeds
    another block leads to it.

    Arrows along the signal and within a column come first; those that feed back are added, the
    shortest first, where no way leads back yet.
    """
    group = {port.port: port.group or port.port for port in rig.ports}
    stage = {name: k for k, groups in enumerate(columns.values()) for name in groups}
    every = {
        (group[port.port], group[other])
        for port in rig.ports
        for other in port.leads_to
        if other in group and group[port.port] != group[other]
    }
    every = {(a, b) for a, b in every if a in stage and b in stage}
    forward = {(a, b) for a, b in every if stage[a] < stage[b]}
    level = {(a, b) for a, b in every if stage[a] == stage[b]}
    directed = {(a, b) for a, b in level if (b, a) not in level}
    ahead, reached = forward | directed, {b for _, b in forward | directed}
    back = {(a, b) for a, b in every if stage[a] > stage[b] and b not in reached}
    direct = {(a, b) for a, b in ahead if not _leads(a, b, ahead - {(a, b)})}
    drawn = back | (level - directed)
    mutual = sorted(back & {(b, a) for a, b in direct})
    for a, b in direct:
        # A force may reach a moving part through further blocks (a muscle, its chain, the joint):
        # an arrow to the part, and a double arrow between the part and these blocks.
        ends = (d for c, d in mutual if c == b and stage[a] < stage[d] < stage[b])
        drawn.add((a, next(ends, b)))
    rank = {name: k for k, name in enumerate(stage)}
    for a, b in sorted(every - ahead - level, key=lambda ab: (rank[ab[0]] - rank[ab[1]], ab)):
        if not _leads(a, b, drawn):
            drawn.add((a, b))
    links = [
        (a, b, (b, a) in drawn)
        for a, b in drawn
        if (b, a) not in drawn or (stage[a], rank[a]) < (stage[b], rank[b])
    ]
    return sorted(links, key=lambda item: (rank[item[0]], rank[item[1]]))


def _leads(begin: str, end: str, links: set[tuple[str, str]]) -> bool:
    """Whether a way of arrows leads between two groups."""
    reached = {begin}
    while after := {b for a, b in links if a in reached} - reached:
        reached |= after
    return end in reached


def merged_columns(
    columns: dict[str, list[str]], texts: dict[str, BlockText]
) -> tuple[dict[str, list[str]], dict[str, BlockText]]:
    """Columns in which blocks without effects are joined, above `MOST_IN_COLUMN`."""
    texts, merged = dict(texts), {}
    for kind, groups in columns.items():
        quiet = [g for g in groups if texts[g].weight < 0.005 and not texts[g].named]
        if len(groups) <= MOST_IN_COLUMN or len(quiet) < 3:
            merged[kind] = groups
            continue
        name = f"{kind} others"
        share = sum(texts[g].weight for g in quiet)
        called = "ports" if len(quiet) == len(groups) else "others"
        texts[name] = BlockText(
            f"{len(quiet)} {called}", texts[quiet[0]].lines[:1], share, tuple(quiet)
        )
        merged[kind] = [g for g in groups if g not in quiet] + [name]
    return merged, texts


def wide_diagram(rig: RigMap, texts: dict[str, BlockText], wide: float) -> Diagram:
    """Columns next to each other."""
    columns, texts = merged_columns(columns_of(rig), texts)
    count = max(1, len(columns))
    gap = GAP_X if count > _FEW else 2.0 * GAP_X
    each = min(_MOST_WIDE, max(_LEAST_WIDE, (wide - gap * (count - 1)) / count))
    left = 0.5 * (wide - each * count - gap * (count - 1))
    stacks = {kind: [_box(g, texts[g], each) for g in groups] for kind, groups in columns.items()}
    heights = {
        kind: sum(box.tall for box in boxes) + GAP_Y * (len(boxes) - 1)
        for kind, boxes in stacks.items()
    }
    tall = max(heights.values(), default=0.0)
    placed: dict[str, Box] = {}
    heads = []
    for k, (kind, boxes) in enumerate(stacks.items()):
        x, y = left + k * (each + gap), HEAD_ROOM + 0.5 * (tall - heights[kind])
        heads.append((x + 0.5 * each, 12.0, STAGES[kind]))
        for box in boxes:
            placed[box.name] = replace(box, x=x, y=y)
            y += box.tall + GAP_Y
    links = list(_wide_links(rig, columns, placed, HEAD_ROOM + 0.5 * tall))
    bottom = max([HEAD_ROOM + tall, *(y + 4.0 for link in links for _, y in link.corners)])
    return Diagram(wide, bottom + 4.0, tuple(placed.values()), tuple(links), tuple(heads))


def narrow_diagram(rig: RigMap, texts: dict[str, BlockText], wide: float) -> Diagram:
    """Columns below each other, with two blocks per row and an arrow between columns."""
    columns, texts = merged_columns(columns_of(rig), texts)
    placed: list[Box] = []
    links: list[Link] = []
    led = {(a, b): both for a, b, both in links_of(rig, columns_of(rig))}
    y = 0.0
    for k, groups in enumerate(columns.values()):
        if k:
            links.append(Link((0.5 * wide, y + 2.0), (0.5 * wide, y + GAP_X - 3.0)))
            y += GAP_X
        each = wide if len(groups) == 1 else 0.5 * (wide - GAP_Y)
        for start in range(0, len(groups), 2):
            row = [_box(g, texts[g], each) for g in groups[start : start + 2]]
            high = max(box.tall for box in row)
            stood = [replace(b, x=j * (each + GAP_Y), y=y, tall=high) for j, b in enumerate(row)]
            for a, b in pairwise(stood):
                middle, right, left = a.y + 0.5 * a.tall, a.x + a.wide, b.x
                if (a.name, b.name) in led:
                    both = led[a.name, b.name]
                    links.append(Link((right + 1.0, middle), (left - 2.0, middle), both))
                elif (b.name, a.name) in led:
                    both = led[b.name, a.name]
                    links.append(Link((left - 1.0, middle), (right + 2.0, middle), both))
            placed += stood
            y += high + GAP_Y
        y -= GAP_Y
    return Diagram(wide, y + 2.0, tuple(placed), tuple(links))


def _box(name: str, text: BlockText, wide: float) -> Box:
    lines = []
    for words, style in ((text.title, "title"), *text.lines):
        most = max(6, int((wide - 2.0 * PAD) / (_EM_BOLD if style else _EM)))
        lines += [(line, style) for line in textwrap.wrap(words, most) or [""]]
    tall, members = 2.0 * PAD + LINE * len(lines), text.members or (name,)
    return Box(name, 0.0, 0.0, wide, tall, tuple(lines), text.weight, text.named, members)


def _wide_links(
    rig: RigMap, columns: dict[str, list[str]], placed: dict[str, Box], middle: float
) -> Iterable[Link]:
    holder = {member: box for box in placed.values() for member in box.members}
    directions: dict[tuple[str, str], bool] = {}
    for a, b, both in links_of(rig, columns_of(rig)):
        ends = holder[a].name, holder[b].name
        if ends[0] != ends[1]:
            directions[ends] = directions.get(ends, False) or both
    if len(directions) > MOST_LINKS:
        return [
            Link((a.x + a.wide + 3.0, middle), (b.x - 3.0, middle), broad=True)
            for a, b in pairwise(placed[column[0]] for column in columns.values())
        ]
    links: list[Link] = []
    for (start, end), both in directions.items():
        aside = sum(bool(link.corners) for link in links)
        links.append(_link(placed[start], placed[end], both, list(placed.values()), aside))
    return links


def _link(a: Box, b: Box, both: bool, boxes: Sequence[Box], aside: int) -> Link:
    """Arrow from side to side, below a block in its way; within a column straight to the next
    block, past others on their left. aside: arrows that already pass below, each on a separate
    line."""
    if a.x == b.x:
        high, low = (a, b) if a.y < b.y else (b, a)
        if any(box.x == a.x and high.y < box.y < low.y for box in boxes):
            begin, end = (a.x - 1.0, a.y + LOWER * a.tall), (b.x - 2.0, b.y + (1 - LOWER) * b.tall)
            left = max(0.5, a.x - 2.0 * STUB)
            return Link(begin, end, both, corners=((left, begin[1]), (left, end[1])))
        middle = a.x + 0.5 * a.wide
        if a.y < b.y:
            return Link((middle, a.y + a.tall + 1.0), (middle, b.y - 2.0), both)
        return Link((middle, a.y - 1.0), (middle, b.y + b.tall + 2.0), both)
    way = 1.0 if a.x < b.x else -1.0
    begin = (a.x + a.wide + 1.0 if way > 0.0 else a.x - 1.0, a.y + 0.5 * a.tall)
    end = (b.x - 2.0 if way > 0.0 else b.x + b.wide + 2.0, b.y + 0.5 * b.tall)
    if not any(_crosses(begin, end, box) for box in boxes if box not in (a, b)):
        return Link(begin, end, both)
    # in the lower half of the sides, which the straight arrows leave free
    begin, end = (begin[0], a.y + LOWER * a.tall), (end[0], b.y + LOWER * b.tall)
    left, right = min(a.x, b.x), max(a.x, b.x)
    below = max(box.y + box.tall for box in boxes if left <= box.x <= right)
    below += GAP_Y + NEXT_LINE * aside
    out = way * (STUB + NEXT_LINE * (aside % STUBS))
    first, last = begin[0] + out, end[0] - out
    turns = ((first, begin[1]), (first, below), (last, below), (last, end[1]))
    return Link(begin, end, both, corners=turns)


def _crosses(begin: tuple[float, float], end: tuple[float, float], box: Box) -> bool:
    """Does an arrow, straight or with level ends, come within some units of a box?"""
    for k in range(1, WAY_POINTS):
        part = k / WAY_POINTS
        x = begin[0] + part * (end[0] - begin[0])
        if box.x - CLEARANCE < x < box.x + box.wide + CLEARANCE:
            for share in (part, part * part * (3.0 - 2.0 * part)):
                y = begin[1] + share * (end[1] - begin[1])
                if box.y - CLEARANCE < y < box.y + box.tall + CLEARANCE:
                    return True
    return False
