"""Damage to files, drawn from a seeded random number generator: the same seed damages the same file
alike, anywhere.

Bytes are cut, doubled, flipped and overwritten; a table, a JSON tree and a TOML file are also
damaged where it hurts most: numbers at the edge of what a computer holds, values of another kind,
names that are nearly right.
"""

import copy
import json
import math
from collections.abc import Iterator
from random import Random
from typing import Any

_EDGES = (
    "nan inf -inf 1e999 -1e999 1e308 -1e308 1e300 1e155 1e-308 5e-324 1e-300 -0 0 -1 1 2 1e-6 1e6 "
    "1e15 9007199254740993 9223372036854775808 18446744073709551616"
)
_NO_NUMBERS = "0x10 1_000 1,5 0.1e --1 +1 1e ٣ −1"
#: numbers at the edge, as text: too large for a float, for its square, for an int64, for the digits
#: Python reads
EXTREMES = (
    *_EDGES.split(),
    *("1" * 400, "-" + "9" * 400, "9" * 5000),
    *_NO_NUMBERS.split(),
    "",
)
_NAMES = (
    "time_s angle_deg angle_rad angle_mdeg command comand pressure_1_kpa pressure_1_bar "
    "reference_deg _ _deg one-dof two-link one-dov one-dof:exponentiel coulomb-friction "
    "coulomb-fricton leak@pressure dead-time ../x.py ./x.py /dev/zero /dev/null . / ~ closed open "
    "clsoed"
)
_TRAPS = (
    "a/b \x1b[31m \u202e \x7f None null true <script>alert(1)</script> __import__('os') %s%n {} "
    "$HOME `id` ü \U0001f600"
)
WORDS = (*_NAMES.split(), "x" * 300, *_TRAPS.split())
_BYTES = (
    *(
        b" ",
        b",",
        b";",
        b"\t",
        b"\n",
        b"\r\n",
        b"\r",
        b"\x00",
        b"\xff",
        b"\xef\xbb\xbf",
        b"\xff\xfe",
    ),
    *(b'"', b'""', b"'", b"#", b"=", b"[", b"]", b"[[", b"{", b"}", b"\\", b"\\u0000", b"\\ud800"),
    *(
        b"\xed\xa0\x80",
        b"1979-05-27T07:32:00Z",
        b"../../etc/passwd",
        b"\x80\x04\x95",
        b"PK\x03\x04",
    ),
    *(b"[" * 2000, b'{"a":' * 2000),
)
TOKENS = (*(word.encode() for word in (*EXTREMES, *WORDS)), *_BYTES)
#: numbers where a binary format counts its bytes or its samples
_COUNTS = (0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**64 - 1)
#: numbers of a JSON tree at the edge
_FLOATS = (1e308, -1e308, 5e-324, -0.0, 0, -1, 1e155, math.inf, 0.5, 10**9)
_JSON_EDGES = (10**400, -(10**400), 10**19, 2**63, -(2**31), *_FLOATS)
#: values of a TOML file of other kinds
_TOML_VALUES = (
    *("1979-05-27T07:32:00Z", "07:32:00", "''", '"""x"""', "[" * 3000 + "]" * 3000),
    *("{a=" * 800 + "1" + "}" * 800, "0b1", "1e400", "[[[[]]]]"),
)


def broken_bytes(random: Random, data: bytes, most: int = 4) -> bytes:
    """The data with up to `most` places cut out, doubled, flipped, overwritten, or filled with
    something nasty."""
    for _ in range(random.randint(1, most)):
        at = random.randint(0, len(data))
        length = random.choice([0, 1, 2, 5, 40, 1000])
        kind = random.choice(["token", "token", "cut", "double", "end", "random", "flip", "number"])
        if kind == "token":
            data = data[:at] + random.choice(TOKENS) + data[at + length :]
        elif kind == "cut":
            data = data[:at] + data[at + length :]
        elif kind == "double":
            data = data[: at + length] + data[at:]
        elif kind == "end":
            data = data[:at] if random.random() < 0.5 else data[at:]
        elif kind == "flip" and at < len(data):
            data = data[:at] + bytes([data[at] ^ 1 << random.randrange(8)]) + data[at + 1 :]
        elif kind == "number":
            value = random.choice(_COUNTS)
            size = random.choice([size for size in (1, 2, 4, 8) if value < 256**size])
            written = value.to_bytes(size, random.choice(["little", "big"]))
            data = data[:at] + written + data[at + size :]
        else:
            data = data[:at] + random.randbytes(random.randint(0, 8)) + data[at + length :]
    return data


# ---- tables --------------------

Rows = list[list[str]]


def broken_table(random: Random, text: str, separator: str = ",") -> bytes:
    """A table of text, its header in the first line, with cells, columns, lines or bytes
    damaged."""
    rows = [line.split(separator) for line in text.splitlines()]
    for _ in range(random.randint(1, 3)):
        random.choice((_cell, _cell, _column, _column, _header, _header, _lines, _stamps))(
            random, rows
        )
    data = ("\n".join(separator.join(row) for row in rows) + "\n").encode()
    return broken_bytes(random, data, 2) if random.random() < 0.3 else data


def _cell(random: Random, rows: Rows) -> None:
    row = random.choice(rows)
    if row:
        row[random.randrange(len(row))] = random.choice(EXTREMES)


def _column(random: Random, rows: Rows) -> None:
    """Scale, shift or hold every value of a column, or double, move or remove the column."""
    at = random.randrange(len(rows[0]) or 1)
    kind = random.choice(["scale", "scale", "shift", "hold", "double", "drop", "shorten", "sign"])
    factor = random.choice([1e300, 1e-300, 1e155, 1e-155, 1e18, 1e6, 1e-6, 1e3, 0.0, 57.3])
    for k, row in enumerate(rows):
        if at >= len(row):
            continue
        if kind == "double":
            row.insert(random.choice([at, 0]) if k == 0 else at, row[at])
        elif kind == "drop":
            del row[at]
        elif k:
            row[at] = _other(row[at], kind, factor)


def _other(cell: str, kind: str, factor: float) -> str:
    try:
        value = float(cell)
    except ValueError:
        return cell
    return {
        "scale": f"{value * factor:.9g}",
        "shift": f"{value + factor:.9g}",
        "hold": f"{factor:g}",
        "shorten": f"{value:.1g}",
        "sign": f"{-value:.9g}",
    }[kind]


def _header(random: Random, rows: Rows) -> None:
    names = rows[0]
    kind = random.choice(["rename", "rename", "twice", "unit", "swap", "none"])
    if not names or kind == "none":
        rows[0] = []
    elif kind == "rename":
        names[random.randrange(len(names))] = random.choice(WORDS)
    elif kind == "twice":
        names[random.randrange(len(names))] = random.choice(names)
    elif kind == "swap":
        random.shuffle(names)
    else:
        at = random.randrange(len(names))
        names[at] = names[at].rpartition("_")[0] + random.choice(
            ["_rad", "_psi", "_bar", "_n", "_s", "_", ""]
        )


def _lines(random: Random, rows: Rows) -> None:
    kind = random.choice(["cut", "shuffle", "double", "blank", "few", "reverse"])
    at = random.randrange(len(rows))
    if kind == "cut":
        del rows[at : at + random.choice([1, 3, 40])]
    elif kind == "shuffle":
        random.shuffle(rows)
    elif kind == "double":
        rows.insert(at, list(rows[at]))
    elif kind == "blank":
        rows.insert(at, [])
    elif kind == "few":
        del rows[random.choice([1, 2, 3, 10]) :]
    else:
        rows[1:] = rows[:0:-1]
    if not rows:
        rows.append([])


def _stamps(random: Random, rows: Rows) -> None:
    """Make the clock faster or slower, offset it, or stop it."""
    factor = random.choice([1e-6, 1e-300, 1e3, 1e300, 1e-3])
    zero = random.choice([0.0, 0.0, 1e15, -1e9, 1.7e9])
    for row in rows[1:]:
        if row:
            try:
                row[0] = f"{float(row[0]) * factor + zero:.17g}"
            except ValueError:
                continue


# ---- JSON --------------------


def broken_json(random: Random, content: Any, most: int = 3) -> str:
    """JSON text of the object with up to `most` of its parts replaced, removed or renamed, at any
    depth."""
    content = copy.deepcopy(content)
    for _ in range(random.randint(1, most)):
        places = list(_places(content))
        if not places:
            break
        holder, key = random.choice(places)
        kind = random.choice(["replace", "replace", "extreme", "remove", "rename", "scale", "swap"])
        if kind == "remove":
            del holder[key]
        elif kind == "rename" and isinstance(holder, dict):
            holder[random.choice(WORDS)] = holder.pop(key)
        elif kind == "scale" and isinstance(holder[key], float):
            holder[key] *= random.choice([-1.0, 0.0, 1e-300, 1e300])
        elif kind == "swap":
            other, its = random.choice(places)
            other[its], holder[key] = (
                copy.deepcopy(holder[key]),
                copy.deepcopy(
                    other.get(its)
                    if isinstance(other, dict)
                    else other[its]
                    if its < len(other)
                    else None
                ),
            )
        elif kind == "extreme":
            holder[key] = random.choice(_JSON_EDGES)
        else:
            holder[key] = _value(random)
    text = json.dumps(content)
    return text.replace("Infinity", "1e999") if random.random() < 0.7 else text


def _value(random: Random, depth: int = 0) -> Any:
    kind = random.choice(
        ["none", "flag", "whole", "number", "word", "list", "object"] if depth < 2 else ["word"]
    )
    if kind == "list":
        return [_value(random, depth + 1) for _ in range(random.randint(0, 3))]
    if kind == "object":
        return {
            random.choice(WORDS): _value(random, depth + 1) for _ in range(random.randint(0, 3))
        }
    return {
        "none": None,
        "flag": random.random() < 0.5,
        "whole": random.choice([-1, 0, 1, 7, 10**6]),
        "number": random.choice([0.0, -1.5, 1e-9, 3.7e5]),
        "word": random.choice(WORDS),
    }[kind]


def _places(node: Any) -> Iterator[tuple[Any, Any]]:
    pairs = (
        node.items()
        if isinstance(node, dict)
        else enumerate(node)
        if isinstance(node, list)
        else ()
    )
    for key, value in pairs:
        yield node, key
        yield from _places(value)


# ---- TOML --------------------


def broken_toml(random: Random, text: str) -> bytes:
    """TOML with values, keys, titles, lines or bytes damaged."""
    lines = text.splitlines()
    for _ in range(random.randint(1, 3)):
        random.choice((*[_toml_value] * 3, _toml_key, _toml_line))(random, lines)
    data = ("\n".join(lines) + "\n").encode("utf-8", errors="surrogateescape")
    return broken_bytes(random, data, 2) if random.random() < 0.3 else data


def _toml_value(random: Random, lines: list[str]) -> None:
    entries = [k for k, line in enumerate(lines) if "=" in line]
    if entries:
        at = random.choice(entries)
        word = json.dumps(random.choice(WORDS), ensure_ascii=False)
        plain = [random.choice(EXTREMES), random.choice(EXTREMES), word, "true", "[]", "{}"]
        nested = ["[1, 2]", f"[{word}, 1]", f"{{a = {word}}}"]
        value = random.choice([*plain, *nested, *_TOML_VALUES])
        lines[at] = f"{lines[at].partition('=')[0]}= {value}"


def _toml_key(random: Random, lines: list[str]) -> None:
    at = random.randrange(len(lines) or 1)
    if at < len(lines):
        word = random.choice(
            [*WORDS, "a.b", "a" + ".b" * 1500, "recording", "known", "signals.x_deg", "time"]
        )
        head, sign, tail = lines[at].partition("=")
        lines[at] = (
            f"{word} ={tail}" if sign else f"[{word}]" if random.random() < 0.7 else f"[[{word}]]"
        )


def _toml_line(random: Random, lines: list[str]) -> None:
    at = random.randrange(len(lines) or 1)
    kind = random.choice(["cut", "double", "shuffle"])
    if kind == "cut":
        del lines[at : at + 1]
    elif kind == "double":
        lines[at:at] = lines[at : at + 1]
    else:
        random.shuffle(lines)
