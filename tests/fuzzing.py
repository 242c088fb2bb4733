"""Damage to files, drawn by hypothesis, and what a command may answer to it."""

from __future__ import annotations

import copy
import json
import math
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from hypothesis import strategies as st
from pamid_cli.frame import run

#: done, usage, a file is wrong, the data cannot answer, not converged, partly done: everything but a fault of pamid's
ALLOWED = {0, 2, 3, 4, 5, 6}
LONGEST_S = 60

TOKENS = (b"nan", b"inf", b"-inf", b"1e999", b"1e308", b"-0", b"0x10", b"1_000", b"", b" ", b",", b";", b"\t", b"\n",
          b"\r\n", b"\r", b"\x00", b"\xff", b"\xef\xbb\xbf", b"\xff\xfe", b'"', b'""', b"'", b"#", b"=", b"[", b"]",
          b"[[", b"{", b"}", b"\\", b"\\u0000", b"time_s", b"angle_deg", b"angle_rad", b"command", b"_", b"1" * 400,
          b"9" * 5000, "\u0661".encode(), "\u2212".encode(), b"true", b"null", b"1979-05-27T07:32:00Z", b"1,5", b"1.5",
          b"../../etc/passwd", b"/dev/zero", b"__import__('os')", b"\x80\x04\x95", b"PK\x03\x04")  # fmt: skip

SCALARS = st.one_of(st.none(), st.booleans(), st.integers(-(10**20), 10**20), st.floats(allow_nan=False,
                    allow_infinity=False), st.text(max_size=12), st.sampled_from(
                    ["one-dof", "angle_deg", "coulomb-friction", "../x.py", "/dev/zero", "", "nan"]))  # fmt: skip
VALUES = st.one_of(SCALARS, st.lists(SCALARS, max_size=3), st.dictionaries(st.text(max_size=6), SCALARS, max_size=3))


@st.composite
def broken_bytes(draw: st.DrawFn, data: bytes, most: int = 4) -> bytes:
    """The data with up to `most` places cut out, doubled, overwritten, or filled with something nasty."""
    for _ in range(draw(st.integers(1, most))):
        at = draw(st.integers(0, len(data)))
        length = draw(st.sampled_from([0, 1, 2, 5, 40, 1000]))
        kind = draw(st.sampled_from(["token", "cut", "double", "end", "random"]))
        if kind == "token":
            data = data[:at] + draw(st.sampled_from(TOKENS)) + data[at + length :]
        elif kind == "cut":
            data = data[:at] + data[at + length :]
        elif kind == "double":
            data = data[: at + length] + data[at:]
        elif kind == "end":
            data = data[:at]
        else:
            data = data[:at] + draw(st.binary(max_size=8)) + data[at + length :]
    return data


@st.composite
def broken_json(draw: st.DrawFn, content: Any, most: int = 3) -> Any:
    """The object with up to `most` of its parts replaced, removed or renamed, at any depth."""
    content = copy.deepcopy(content)
    for _ in range(draw(st.integers(1, most))):
        places = list(_places(content))
        if not places:
            return content
        holder, key = draw(st.sampled_from(places))
        kind = draw(st.sampled_from(["replace", "replace", "remove", "rename", "scale"]))
        if kind == "remove":
            del holder[key]
        elif kind == "rename" and isinstance(holder, dict):
            holder[draw(st.text(max_size=8))] = holder.pop(key)
        elif kind == "scale" and isinstance(holder[key], float):
            holder[key] *= draw(st.sampled_from([-1.0, 0.0, 1e-300, 1e300]))
        else:
            holder[key] = draw(VALUES)
    return content


def _places(node: Any) -> Iterator[tuple[Any, Any]]:
    pairs = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, value in pairs:
        yield node, key
        yield from _places(value)


def as_json(content: Any) -> str:
    """Strict where it can be: what a foreign tool would write."""
    def plain(node: Any) -> Any:
        if isinstance(node, dict):
            return {k: plain(v) for k, v in node.items()}
        if isinstance(node, list):
            return [plain(v) for v in node]
        return 1e308 if isinstance(node, float) and not math.isfinite(node) else node

    return json.dumps(plain(content))


def answer(capsys: pytest.CaptureFixture[str], *words: str | Path) -> dict[str, Any]:
    """What `pamid ... --json` says: one object with a schema, an exit code that is allowed, within a minute."""
    with time_limit(LONGEST_S, words):
        code = run([*map(str, words), "--json"])
    out = capsys.readouterr().out
    said = json.loads(out)
    assert isinstance(said, dict) and said["schema"].startswith("pamid."), out[:200]
    assert code in ALLOWED and said.get("code") != "unexpected", (words, code, said.get("message"))
    if code:
        assert said["message"], said
    return said


@contextmanager
def time_limit(seconds: int, what: object) -> Iterator[None]:
    def ring(_: int, frame: FrameType | None) -> None:
        raise AssertionError(f"{what}: still at work after {seconds} s, in {frame}")

    before = signal.signal(signal.SIGALRM, ring)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def leftovers(folder: Path) -> list[str]:
    """Files that were begun and not finished."""
    return [path.name for path in folder.rglob("*.tmp")]
