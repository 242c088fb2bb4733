"""Rig file derived from a rig of the catalogue.

The source gets the recording's columns in their units, its imports from `pamid`, and priors as wide
as a guess. The recording supplies names, and these become code. Only plain words are accepted
(`require_plain`), and any other quoted text is written as a Python literal.
"""

from __future__ import annotations

import ast
import keyword
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pamid.api.authoring.column_match import Match, Pair
from pamid.api.authoring.pruned_source import SourceText, declared, pruned_source
from pamid.base.arrays import Array
from pamid.base.errors import FileError
from pamid.base.metrics import motion
from pamid.base.units import (
    NONE,
    quotient,
    si_symbol,
    size_to_si,
    split_column,
    suffix_of,
    to_si,
    unit_label,
)
from pamid.intake.checks.conformance import ExcitedRig
from pamid.model.rig import Rig
from pamid.recording.noise import noise_level
from pamid.recording.recording import Recording

_FACE = ("Loop", "Parameter", "Port", "Rig", "RoughMap", "State")
#: units of columns that no equation uses
_SEEN_AS = {
    "percent": "the equations see a fraction, 0.6 for 60 %",
    "degC": "the equations see kelvin",
    "degF": "the equations see kelvin",
}
GUESS = 3.0  # plausible factor between the template's values and another machine's
SCALE = 1e4  # bounds of a gain: this multiple and this part of the ratio of the ranges
_PLAIN_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


def require_plain(name: str, what: str) -> str:
    """Return a name that may stand in a program. FileError for anything but a plain Python word."""
    if not _PLAIN_NAME.fullmatch(name) or keyword.iskeyword(name):
        raise FileError(
            f"{what} {name!r} is not a valid name in a rig file.",
            "Rename the column with letters, digits and underscores, beginning with a letter.",
            code="name",
        )
    return name


def class_name(stem: str) -> str:
    """Class name, "my_rig" -> "MyRig". FileError if the file's name does not give a class name."""
    name = "".join(word[:1].upper() + word[1:] for word in re.split(r"[^A-Za-z0-9]+", stem))
    return require_plain(name, "The name of the output,")


@dataclass(frozen=True)
class _Gain:
    """Factor between a recorded signal and the quantity in the equations."""

    name: str
    value: float
    symbol: str


class RigSource:
    """Source of a rig for a recording, derived from a template rig."""

    def __init__(self, match: Match, recording: Recording, name: str, why: str) -> None:
        self.match, self.recording, self.name, self.reason = match, recording, name, why
        self.rig: Rig = match.rig()
        self.by_wanted = {pair.wanted: pair for pair in match.pairs}
        recorded = [column for column in self.rig.outputs if column in self.by_wanted]
        source, self.unobserved = pruned_source(self.rig, recorded)
        self.source = SourceText(source)
        self.tree = self.source.tree
        used = {n.attr for n in ast.walk(self.tree) if isinstance(n, ast.Attribute)}
        self.columns = [column for column in self.rig.inputs if column in used] + recorded
        for pair in match.pairs:
            require_plain(pair.recorded, "The column")
        plain = {pair.wanted for pair in match.pairs if not pair.scaled}
        self.loops = bool(self.rig.loops) and all(
            {q.reference, q.command, q.reading} <= plain for q in self.rig.loops
        )

    def text(self) -> str:
        """Complete text of the file."""
        kind = self.source.kind
        (named,) = re.finditer(rf"class {kind.name}\(", self.source.text)
        self.source.edits.append((named.start() + 6, named.end() - 1, self.name))
        settled = self._settled()
        for node in kind.body:
            if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
                self._assignment(node, node.targets[0].id, settled)
            elif isinstance(node, ast.FunctionDef):
                self._function(node)
        text = re.sub(r"  # type: ignore\[[^\]]*\]", "", self.source.edited())
        tree = ast.parse(text)
        imports = [n for n in tree.body if isinstance(n, ast.Import | ast.ImportFrom)]
        body = "".join(text.splitlines(keepends=True)[imports[-1].end_lineno :])
        # a removed line leaves its indent
        body = re.sub(r"[ \t]+$", "", body.lstrip("\n"), flags=re.MULTILINE)
        title = f"{self.name}: a rig that `pamid new-rig` wrote after {self.rig.name}"
        sent, read = (", ".join(self.match.columns_by_role(role)) for role in ("input", "output"))
        mine = re.sub(r"[^A-Za-z0-9 ._/-]", "?", self.reason)
        docstring = (
            f'"""{title}, with the columns of {mine}.\n\n'
            f"Assumed inputs: {sent}; outputs: {read}.\n"
            "Check the values marked GUESS: they belong to another machine and have wide priors.\n"
            f"The following text describes {self.rig.name}.\n\n"
            f'{ast.get_docstring(self.tree) or ""}\n"""\n\n'
        )
        return docstring + self._imports(imports, body) + body

    # ---- what changes ---------------------------------------------------------------------------

    def _settled(self) -> dict[str, str]:
        """Class attributes that are replaced."""
        rig, names = self.rig, {c: self._found(c) for c in self.columns}
        noise = {}  # measured, in the unit of the column
        for column in rig.outputs:
            if column in names:
                values = self._values(self.by_wanted[column])
                noise[names[column]] = _short(float(noise_level(values[:, None])[0]), 1)
        swings = self._swings()
        scaled = {pair.wanted for pair in self.match.pairs if pair.scaled}
        tables = {
            "inputs": {names[c]: self._unit(c) for c in rig.inputs if c in names},
            "outputs": {names[c]: self._unit(c) for c in rig.outputs if c in names},
            "optional": {
                names[c]: v for c, v in rig.optional.items() if c in names and c not in scaled
            },
            "noise": {c: v for c, v in noise.items() if v > 0.0},
            "excited": {c: half for c, (_, half) in swings.items()},
            "centre": {c: centre for c, (centre, _) in swings.items() if centre},
            "ramped": tuple(names[c] for c in rig.ramped if c in names),
            "period_s": _short(self.recording.sampling_period_s),
        }
        slower = self.recording.sampling_period_s / rig.period_s
        tables["hold_s"] = tuple(_short(slower * hold) for hold in rig.hold_s)
        return {name: _literal(value) for name, value in tables.items()}

    def _assignment(self, node: ast.Assign, name: str, settled: Mapping[str, str]) -> None:
        source = self.source
        if name in ("loops", "controller") and not self.loops:
            source.replace(node, "")
        elif name == "loops":
            for text in (n for n in ast.walk(node) if isinstance(n, ast.Constant)):
                if text.value in self.by_wanted:
                    source.replace(text, _literal(self._found(str(text.value))))
        elif name == "controller":
            source.replace(node.value, _literal(self._controller()))
        elif name in settled:
            extra = ""
            if name == "period_s":
                written = {
                    n.targets[0].id
                    for n in ast.walk(self.tree)
                    if isinstance(n, ast.Assign) and isinstance(n.targets[0], ast.Name)
                }
                extra = "".join(
                    f"\n    {other} = {settled[other]}"
                    for other in ("excited", "centre", "hold_s")
                    if other not in written and settled[other] != "{}"
                )
            if settled[name] in ("{}", "()"):
                source.replace(node, "")
            else:
                source.replace(node.value, settled[name] + extra)
            if name == "outputs":
                source.insert(source.span(node)[1], self._left_over())
        elif name == "background" and any(pair.scaled for pair in self.match.pairs):
            # a map that is off by 2 % would be traded for the scale, which is unknown
            remark = "# background: state by how much the maps may be off when the scales are known"
            source.replace(node, remark)
        elif name == "parameters":
            self._parameters(node)

    def _parameters(self, node: ast.Assign) -> None:
        """Edits that turn the template's data-sheet values into guesses with wide priors."""
        assert isinstance(node.value, ast.Tuple)
        for sourced in node.value.elts:
            call = declared(sourced)
            assert isinstance(sourced, ast.Call)
            if sourced is not call:
                (source,) = sourced.args
                origin = f"GUESS, from {self.rig.name}: {ast.literal_eval(source)}"
                self.source.replace(source, _literal(origin))
            for word in call.keywords:
                if word.arg in ("spread", "factor"):
                    spread = float(ast.literal_eval(word.value))
                    wider = max(spread, GUESS) if word.arg == "factor" else GUESS * spread
                    self.source.replace(word.value, _literal(wider))
        end = self.source.span(node.value)[1] - 1
        for gain in filter(None, map(self._gain, self.match.pairs)):
            low, high = _short(gain.value / SCALE), _short(gain.value * SCALE)
            self.source.insert(
                end,
                f'    Parameter.positive("{gain.name}", {gain.value!r}, {low!r}, {high!r}, '
                f'"{gain.symbol}", factor={GUESS!r}).with_source("GUESS: read the scale of it"),'
                "\n    ",
            )

    def _function(self, function: ast.FunctionDef) -> None:
        for node in ast.walk(function):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                pair = self.by_wanted.get(node.attr) if node.value.id == "u" else None
                if pair is not None:
                    gain = self._gain(pair)
                    read = f"u.{pair.recorded}"
                    text = f"(p.{gain.name} * {read})" if gain else read
                    self.source.replace(node, text)
            elif isinstance(node, ast.Dict):
                for key, value in zip(node.keys, node.values, strict=True):
                    name = str(key.value) if isinstance(key, ast.Constant) else ""
                    pair = self.by_wanted.get(name)
                    if key is None or pair is None or pair.role != "output":
                        continue
                    self.source.replace(key, _literal(pair.recorded))
                    gain = self._gain(pair)
                    if gain:
                        first, last = self.source.span(value)
                        self.source.insert(first, f"p.{gain.name} * (")
                        self.source.insert(last, ")")

    # ---- columns --------------------------------------------------------------------------------

    def _found(self, column: str) -> str:
        return self.by_wanted[column].recorded if column in self.by_wanted else column

    def _unit(self, column: str) -> str:
        """SI symbol of a column in the equations."""
        pair, rig_unit = self.by_wanted.get(column), {**self.rig.inputs, **self.rig.outputs}[column]
        if pair is None or not pair.scaled:
            return rig_unit
        return si_symbol(split_column(pair.recorded)[1])

    def _values(self, pair: Pair) -> Array:
        return self.recording.columns[pair.recorded]

    def _swings(self) -> dict[str, tuple[float, float]]:
        """Centre and half range per recorded command, in its unit.

        Only columns that the template excites count. A room temperature is an input, but not a
        command.
        """
        swings = {}
        for pair in self.match.pairs:
            if pair.wanted not in self.rig.excited or (pair.role == "reference" and not self.loops):
                continue
            low, high = np.quantile(self._values(pair), (0.01, 0.99))
            half, centre = _short(0.5 * float(high - low)), 0.5 * float(high + low)
            if half > 0.0:
                swings[pair.recorded] = (_short(centre) if abs(centre) > 0.2 * half else 0.0, half)
        return swings

    def _controller(self) -> dict[str, float]:
        """Controller of the template, in the unit of the recorded reading."""
        (loop, *_), gains = self.rig.loops, dict[str, float]()
        old, new = (split_column(c)[1] for c in (loop.reading, self._found(loop.reading)))
        for key, value in self.rig.controller.items():
            gain = key.endswith(f"_per_{suffix_of(old)}")
            name = key.removesuffix(suffix_of(old)) + suffix_of(new) if gain else key
            gains[name] = (
                _short(value * size_to_si(1.0, new) / size_to_si(1.0, old), 4) if gain else value
            )
        most = float(np.abs(self._values(self.by_wanted[loop.command])).max())
        if most > gains["command_limit"]:
            gains["command_limit"] = _short(1.01 * most, 3)
        return gains

    def _gain(self, pair: Pair) -> _Gain | None:
        """Gain between a column and the template's quantity, from the ranges of both."""
        if not pair.scaled:
            return None
        stem, recorded = split_column(pair.recorded)
        symbol = si_symbol(recorded)
        rig_unit = {**self.rig.inputs, **self.rig.outputs}[pair.wanted]
        span = motion(to_si(self._values(pair), recorded)) or 1.0
        # of the template's column (SI) under its usual excitation
        trial = ExcitedRig(self.rig)
        if pair.wanted in self.rig.inputs:
            moved = trial.u[:, list(self.rig.inputs).index(pair.wanted)]
        else:
            y = trial.run(trial.assembly.values())
            moved = y[:, list(self.rig.outputs).index(pair.wanted)]
        usual = float(np.ptp(moved)) or 1.0
        above, below = (rig_unit, symbol) if pair.role == "input" else (symbol, rig_unit)
        ratio = usual / span if pair.role == "input" else span / usual
        unit_text = quotient(above or NONE, below or NONE)
        return _Gain(f"{stem}_gain", _short(ratio), unit_label(unit_text))

    # ---- words ----------------------------------------------------------------------------------

    def _left_over(self) -> str:
        """Comments on unrecorded columns of the rig and on unused columns of the recording."""
        lines = [f"    # {name}: not recorded, and done without" for name in self.match.unrecorded]
        lines += [
            f"    # state {name}: left out, for no recorded column depends on it"
            for name in self.unobserved
        ]
        lines += [
            f"    # {column}: {_SEEN_AS[symbol]}"
            for column in map(self._found, self.columns)
            if (symbol := split_column(column)[1]) in _SEEN_AS
        ]
        for name in self.match.unused:
            values = self.recording.columns[name]
            lines.append(
                f"    # {ascii(name)}: {values.min():.4g} .. {values.max():.4g}, not used: "
                "an input, an output, or of no interest?"
            )
        return "".join(f"\n{line}" for line in lines)

    def _imports(self, nodes: list[ast.Import | ast.ImportFrom], body: str) -> str:
        """Imports of the body, those of pamid from its public interface."""
        words = set(re.findall(r"\b[A-Za-z_]+\b", re.sub(r'"[^"\n]*"', "", body)))
        blocks: dict[str, list[str]] = {"__future__": ["from __future__ import annotations"]}
        for node in nodes:
            module = node.module or "" if isinstance(node, ast.ImportFrom) else ""
            used = [alias.name for alias in node.names if alias.name in words]
            if module.startswith("pamid.engine.symbolic"):
                blocks["equations"] = [f"from pamid.equations import {', '.join(used)}"]
            elif not module.startswith("pamid.") and module != "__future__":
                blocks.setdefault("library", []).append(ast.unparse(node))
        face = [name for name in _FACE if name in words]
        mine = [f"from pamid import {', '.join(face)}", *blocks.pop("equations", [])]
        return "\n\n".join("\n".join(lines) for lines in (*blocks.values(), mine)) + "\n\n\n"


def _short(value: float, digits: int = 2) -> float:
    return float(f"{value:.{digits}g}")


def _literal(value: Any) -> str:
    """Value as a Python literal in double quotes."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_literal(k)}: {_literal(v)}" for k, v in value.items()) + "}"
    if isinstance(value, tuple):
        inside = ", ".join(map(_literal, value))
        return f"({inside},)" if len(value) == 1 else f"({inside})"
    if isinstance(value, str):
        return '"' + repr(value)[1:-1].replace('"', '\\"') + '"'
    if isinstance(value, float):  # 0.15 and not 0.15000000000000002
        return repr(_short(value, 12))
    return repr(value)
