"""Source of a shipped rig, reduced to the recorded outputs.

Unrecorded outputs are removed, with the states that no recorded output depends on, and with
everything that only these need. The edits act on the text, so that a rig keeps its layout and its
comments. Removing a state removes its dependants: signals of ports, then unused locals, methods,
ports, parameters and module-level names.
"""

from __future__ import annotations

import ast
import inspect
import sys
from collections.abc import Callable, Collection, Iterator, Sequence

import numpy as np

from pamid.model.determined_signals import unobserved_states
from pamid.model.rig import Rig
from pamid.model.trace import trace


def pruned_source(rig: Rig, recorded: Collection[str]) -> tuple[str, tuple[str, ...]]:
    """Return the source of a rig with some of its outputs, and the names of the removed states.

    recorded: recorded outputs of the rig, not empty.
    """
    traced = trace(rig, lambda port, place: [], {})
    hidden = unobserved_states(traced, recorded)
    states = tuple(s.name for s in rig.states if s.name in hidden)
    text = inspect.getsource(sys.modules[type(rig).__module__])
    if set(rig.outputs) <= set(recorded) and not states:
        return text, ()
    text = _Equations(text, rig, set(recorded), hidden).without()
    while (shorter := _Unused(text).without()) != text:
        text = shorter
    return text, states


class SourceText:
    """Source text of a rig with its syntax tree; edits spans of it."""

    def __init__(self, text: str) -> None:
        self.text, self.tree = text, ast.parse(text)
        assert text.isascii(), "places in the tree are counted in bytes"
        lengths = [len(line) for line in text.splitlines(keepends=True)]
        self.begins = np.concatenate([[0], np.cumsum(lengths)])
        self.kind = next(n for n in self.tree.body if isinstance(n, ast.ClassDef))
        self.edits: list[tuple[int, int, str]] = []

    def edited(self) -> str:
        """Text after the edits. What is to be replaced within another edit is dropped."""
        outer = [
            e
            for e in set(self.edits)
            if e[0] == e[1]
            or not any(o[0] <= e[0] and e[1] <= o[1] and o[:2] != e[:2] for o in self.edits)
        ]
        text = self.text
        for first, last, new in sorted(outer, reverse=True):
            text = text[:first] + new + text[last:]
        return text

    def span(self, node: ast.AST) -> tuple[int, int]:
        assert isinstance(node, ast.expr | ast.stmt | ast.keyword)
        assert node.end_lineno is not None and node.end_col_offset is not None
        first = int(self.begins[node.lineno - 1]) + node.col_offset
        return first, int(self.begins[node.end_lineno - 1]) + node.end_col_offset

    def source(self, node: ast.AST) -> str:
        first, last = self.span(node)
        return self.text[first:last]

    def replace(self, node: ast.AST, new: str) -> None:
        self.edits.append((*self.span(node), new))

    def insert(self, at: int, new: str) -> None:
        self.edits.append((at, at, new))

    def thin(self, parts: Sequence[tuple[int, int]], stays: Sequence[bool]) -> None:
        """Remove the discarded items of a list, with their commas."""
        for k, (first, last) in enumerate(parts):
            if stays[k]:
                continue
            if k + 1 < len(parts):
                self.edits.append((first, parts[k + 1][0], ""))
            else:
                before = max((j for j in range(k) if stays[j]), default=None)
                self.edits.append((first if before is None else parts[before][1], last, ""))

    def thin_dict(self, node: ast.Dict, stays: Callable[[str], bool]) -> None:
        """Keep the entries with these keys, and those whose key is not a constant."""
        entries = list(zip(node.keys, node.values, strict=True))
        self.thin(
            [(self.span(k or v)[0], self.span(v)[1]) for k, v in entries],
            [not isinstance(k, ast.Constant) or stays(str(k.value)) for k, _ in entries],
        )

    def thin_tuple(self, node: ast.Tuple, stays: Callable[[str], bool]) -> None:
        """Keep the calls whose first argument is among these names."""
        stays_here = [stays(_first_word(call)) for call in node.elts]
        if sum(stays_here) == 1:
            (only,) = (call for call, stay in zip(node.elts, stays_here, strict=True) if stay)
            self.replace(node, f"({self.source(only)},)")
        else:
            self.thin([self.span(call) for call in node.elts], stays_here)

    def drop(self, node: ast.stmt) -> None:
        """Remove a statement or a function, with its lines and the comment right above it."""
        assert node.end_lineno is not None
        lines, first = self.text.splitlines(), node.lineno - 1
        while first and lines[first - 1].lstrip().startswith("#"):
            first -= 1
        last = node.end_lineno
        if isinstance(node, ast.FunctionDef):
            while last < len(lines) and not lines[last].strip():
                last += 1
        self.edits.append((int(self.begins[first]), int(self.begins[last]), ""))

    def assigned(self, name: str) -> ast.expr | None:
        """Value of an attribute of the class."""
        for node in self.kind.body:
            if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == name:
                return node.value
        return None

    def functions(self) -> list[ast.FunctionDef]:
        return [node for node in self.kind.body if isinstance(node, ast.FunctionDef)]


class _Equations(SourceText):
    """Removes outputs and states from the equations."""

    def __init__(self, text: str, rig: Rig, recorded: set[str], hidden: Collection[str]) -> None:
        super().__init__(text)
        self.rig, self.recorded, self.hidden = rig, recorded, set(hidden)
        self.lost: dict[str, set[str]] = {}  # port -> signals that it no longer has

    def without(self) -> str:
        for function in self.functions():
            self._function(function)
        states = self.assigned("states")
        if isinstance(states, ast.Tuple):
            self.thin_tuple(states, lambda name: name not in self.hidden)
        self._ports()
        self._background()
        return self.edited()

    def _function(self, function: ast.FunctionDef) -> None:
        gone = self.hidden if function.name == "rates" else set(self.rig.outputs) - self.recorded
        hidden_locals: set[str] = set()
        for line in function.body:
            if isinstance(line, ast.Assign) and self._hidden(line.value, hidden_locals, True):
                names = [n for n in ast.walk(line.targets[0]) if isinstance(n, ast.Name)]
                hidden_locals |= {n.id for n in names}
        for node in ast.walk(function):
            if function.name in ("rates", "measure") and isinstance(node, ast.Return):
                assert isinstance(node.value, ast.Dict)
                self.thin_dict(node.value, lambda key: key not in gone)
            if isinstance(node, ast.Call) and _port_of(node):
                stays = [not self._hidden(k.value, hidden_locals, False) for k in node.keywords]
                parts = [*node.args, *node.keywords]
                self.thin([self.span(part) for part in parts], [True] * len(node.args) + stays)
                lost = {
                    str(k.arg) for k, stay in zip(node.keywords, stays, strict=True) if not stay
                }
                self.lost.setdefault(_port_of(node), set()).update(lost)

    def _hidden(self, value: ast.AST, hidden_locals: set[str], plain: bool) -> bool:
        """True if a value depends on a removed state.

        plain: not if the dependence is by a signal of a port alone, because that signal is removed.
        """
        nodes = _without_signals(value) if plain else ast.walk(value)
        return any(
            (_read(node, "x") in self.hidden)
            or (isinstance(node, ast.Name) and node.id in hidden_locals)
            for node in nodes
        )

    def _ports(self) -> None:
        ports = self.assigned("ports")
        assert isinstance(ports, ast.Dict)
        for key, value in zip(ports.keys, ports.values, strict=True):
            name = str(getattr(key, "value", ""))
            if lost := self.lost.get(name):
                offered = self.rig.ports[name].signals
                assert isinstance(offered, dict) and isinstance(value, ast.Call)
                words = ", ".join(f'"{s}": "{u}"' for s, u in offered.items() if s not in lost)
                self.replace(value.args[2], f"{{{words}}}")

    def _background(self) -> None:
        """Reduce the background: a map along a lost signal becomes a map along the value itself.

        A map of a lost signal is removed.
        """
        background = self.assigned("background")
        for call in ast.walk(background) if background is not None else ():
            if not (isinstance(call, ast.Call) and getattr(call.func, "id", "") == "RoughMap"):
                continue
            assert isinstance(background, ast.Dict)
            entries = zip(background.keys, background.values, strict=True)
            (port,) = (str(getattr(k, "value", "")) for k, v in entries if call in ast.walk(v))
            lost = self.lost.get(port, set())
            over = call.args[1:] + [k.value for k in call.keywords if k.arg == "over"]
            of = [k.value for k in call.keywords if k.arg == "of"]
            assert not any(getattr(v, "value", "") in lost for v in of)
            if any(getattr(v, "value", "") in lost for v in over):
                parts = [*call.args, *call.keywords]
                stays = [
                    getattr(part, "value", part) not in over and part not in over for part in parts
                ]
                self.thin([self.span(part) for part in parts], stays)


class _Unused(SourceText):
    """Removes unused definitions."""

    def without(self) -> str:
        for function in self.functions():
            loaded = {
                n.id
                for n in ast.walk(function)
                if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Load)
            }
            for node in function.body:
                if isinstance(node, ast.Assign):
                    names = {n.id for n in ast.walk(node.targets[0]) if isinstance(n, ast.Name)}
                    if not names & loaded:
                        self.drop(node)
        called = {_read(node, "self") for node in ast.walk(self.kind)}
        for function in self.functions():
            if not hasattr(Rig, function.name) and function.name not in called:
                self.drop(function)
        used = {name for f in self.functions() for n in ast.walk(f) if (name := _port_of(n))}
        for table in ("ports", "background"):
            value = self.assigned(table)
            if isinstance(value, ast.Dict):
                self.thin_dict(value, lambda name: name in used)
        read = {name for f in self.functions() for n in ast.walk(f) if (name := _read(n, "p"))}
        parameters = self.assigned("parameters")
        if isinstance(parameters, ast.Tuple):
            self.thin_tuple(parameters, lambda name: name in read)
        self._names()
        return self.edited()

    def _names(self) -> None:
        """Constants and functions of the file."""
        loaded = {
            n.id
            for n in ast.walk(self.tree)
            if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Load)
        }
        for node in self.tree.body:
            if isinstance(node, ast.FunctionDef):
                name = node.name
            elif isinstance(node, ast.Assign):
                name = getattr(node.targets[0], "id", "")
            else:
                continue
            if name not in loaded:
                self.drop(node)


def _read(node: ast.AST, owner: str) -> str:
    """Name of the attribute that is read of `x`, `p` or `self`, "" if there is none."""
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
        return node.attr if node.value.id == owner else ""
    return ""


def _port_of(node: ast.AST) -> str:
    """Port that a call passes a value through, "" for any other call."""
    named = isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
    return _first_word(node) if named and node.func.id == "port" else ""  # type: ignore[attr-defined]


def declared(node: ast.AST) -> ast.Call:
    """Call that declares a parameter, without the call that names its source."""
    assert isinstance(node, ast.Call)
    inner = getattr(node.func, "value", None)
    return inner if isinstance(inner, ast.Call) else node


def _first_word(node: ast.AST) -> str:
    node = declared(node)
    return str(getattr(node.args[0], "value", "")) if node.args else ""


def _without_signals(value: ast.AST) -> Iterator[ast.AST]:
    """Nodes of a value, without the signals of its ports."""
    waiting = [value]
    while waiting:
        node = waiting.pop()
        yield node
        if isinstance(node, ast.Call) and _port_of(node):
            waiting += node.args
        else:
            waiting += ast.iter_child_nodes(node)
