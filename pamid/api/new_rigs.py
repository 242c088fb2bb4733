"""`pamid.new_rig`: a rig file from a recording's columns and a rig of the catalogue."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pamid.api.given import recording_given
from pamid.api.options.preparing import NewRigArguments
from pamid.api.options.record import verb
from pamid.authoring.column_match import Match, best_match
from pamid.authoring.rig_source import RigSource, class_name
from pamid.base.card import card, html_table
from pamid.base.errors import FileError
from pamid.base.files import make_folder, write_atomically
from pamid.base.units import NONE, split_column
from pamid.model.no_place import no_place_words, no_places
from pamid.model.registry import effects, rigs
from pamid.model.rig import Rig
from pamid.recording.held_signal import held_by_jumps
from pamid.schemas import new_rig_file as said

_BY = {
    "name": "by its name",
    "word": "by a word of its name",
    "unit": "by its unit alone",
    "you": "as you said",
}


@dataclass(frozen=True)
class NewRig:
    """A rig file that was written, and what the recording's columns are in it; unobserved: states
    of the example on which no recorded column depends, which the file does without."""

    path: Path
    name: str
    like: str
    text: str
    unobserved: tuple[str, ...]
    _match: Match
    _others: tuple[Match, ...]

    def to_dict(self) -> dict[str, Any]:
        """JSON object of the command."""
        match = self._match
        columns = tuple(
            said.TakenColumn(
                column=q.recorded,
                unit=_unit(q.recorded),
                role=q.role,  # type: ignore[arg-type]
                stands_for=q.wanted,
                by=q.by,  # type: ignore[arg-type]
                scaled=q.scaled,
            )
            for q in match.pairs
        )
        return said.NewRigFile(
            output=str(self.path),
            rig=self.name,
            like=self.like,
            score=round(match.score, 4),
            columns=columns,
            unrecorded=match.unrecorded,
            unused=match.unused,
            unobserved=self.unobserved,
            turned=match.exchanged_rigs,
            also=tuple(
                said.OtherMatch(rig=m.rig.name, score=round(m.score, 4)) for m in self._others
            ),
        ).as_json()

    def summary(self) -> str:
        """Role of every column, as lines of text."""
        lines = [f"{self.path}: rig {self.name!r}, after {self.like}."]
        for q in self._match.pairs:
            scaled = "; a gain stands between the two" if q.scaled else ""
            lines.append(f"  {q.recorded:<24} {q.role} {q.wanted}, {_BY[q.by]}{scaled}")
        lines += [f"  {name:<24} not recorded" for name in self._match.unrecorded]
        lines += [f"  {name:<24} not used: noted in the file" for name in self._match.unused]
        lines += [
            f"  {name:<24} state left out: no recorded column depends on it"
            for name in self.unobserved
        ]
        lines += self._directions()
        if self._others:
            others = ", ".join(m.rig.name for m in self._others)
            lines.append(f"  The columns fit {others}, too: --like NAME.")
        rig = self._match.rig()
        lines += [
            f"  It has {no_place_words(q)}." for q in no_places(rig, effects().values(), rigs())
        ]
        lines.append("  Its figures are the example's: replace those marked GUESS.")
        return "\n".join(lines)

    def _directions(self) -> list[str]:
        """Lines that state the assumed causes and effects, and how to swap them."""
        sent, read = (", ".join(self._match.columns_by_role(role)) for role in ("input", "output"))
        lines = [f"  Taken as cause: {sent or 'nothing'}; as effect: {read}."]
        if self._match.exchanged_rigs:
            lines.append(
                f"  If {read} is imposed on your bench and {sent} is what it reads, it is the "
                f"other way round: --like {' or '.join(self._match.exchanged_rigs)}."
            )
        return lines

    def __repr__(self) -> str:
        return f"<NewRig {self.path} after {self.like}>"

    def _repr_html_(self) -> str:
        rows = [(q.recorded, q.role, q.wanted) for q in self._match.pairs]
        return card(repr(self)[1:-1], html_table((("column", "role", "stands for"), rows)))


@verb(NewRigArguments)
def new_rig(arguments: NewRigArguments) -> NewRig:
    """Write a rig file for a recording: the best matching shipped rig, with the given columns.

    No file is run.

    Raises
    ------
    UsageError
        A name does not exist.
    FileError
        No rig fits, a column's name cannot be a name in Python, or the file exists (without
        overwrite).
    """
    path = Path(arguments.output)
    if path.suffix != ".py":
        raise FileError(
            f"{path}: a rig file is Python.", f"Write --output {path.with_suffix('.py')}."
        )
    if path.exists() and not arguments.overwrite:
        raise FileError(
            f"{path} exists already.",
            "Choose another --output, or --overwrite to replace it.",
            code="exists",
        )
    name = class_name(path.stem)
    given = recording_given(arguments.recording)
    held = [name for name, values in given.columns.items() if held_by_jumps(values)]
    match, others = best_match(given.columns, arguments.like, arguments.columns, held)
    source = RigSource(match, given, name, given.path.name)
    text = source.text()
    make_folder(path.parent)
    write_atomically(path, text.encode())
    kind: type[Rig] = type(name, (Rig,), {})  # its name is that of the class in the file
    return NewRig(path, kind.name, match.rig.name, text, source.unobserved, match, tuple(others))


def _unit(column: str) -> str:
    symbol = split_column(column)[1]
    return "" if symbol == NONE else symbol
