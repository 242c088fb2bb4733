"""`pamid.new_rig`: a rig file from a recording's columns and a rig of the catalogue."""

from __future__ import annotations

from pathlib import Path

from pamid.api.authoring.column_match import best_match
from pamid.api.authoring.rig_source import RigSource, class_name
from pamid.api.given import recording_given
from pamid.api.options.preparing import NewRigArguments
from pamid.api.options.record import verb
from pamid.base.card import card, html_table
from pamid.base.errors import FileError
from pamid.base.files import make_folder, require_new, write_atomically
from pamid.base.schemas.command_files import NewRigFile, OtherMatch, TakenColumn
from pamid.base.units import split_column, unit_label
from pamid.model.no_place import no_place_words, no_places
from pamid.model.registry import catalogue_rig, effects, rigs
from pamid.model.rig import Rig
from pamid.recording.held_signal import held_by_jumps

_BY = {
    "name": "by its name",
    "word": "by a word of its name",
    "unit": "by its unit alone",
    "you": "as you stated",
}


class NewRig(NewRigFile):
    """A rig file that was written, and what the recording's columns are in it; unobserved: states
    of the example on which no recorded column depends, which the file does without."""

    @property
    def path(self) -> Path:
        return Path(self.output)

    @property
    def name(self) -> str:
        return self.rig

    @property
    def text(self) -> str:
        """Content of the file."""
        return self.path.read_text(encoding="utf-8")

    to_dict = NewRigFile.as_json

    def summary(self) -> str:
        """Role of every column, as lines of text."""
        lines = [f"{self.path}: rig {self.name!r}, after {self.like}."]
        for c in self.columns:
            scaled = "; a fitted gain converts the unit" if c.scaled else ""
            lines.append(f"  {c.column:<24} {c.role} {c.stands_for}, {_BY[c.by]}{scaled}")
        lines += [f"  {name:<24} not recorded" for name in self.unrecorded]
        lines += [f"  {name:<24} not used: noted in the file" for name in self.unused]
        lines += [
            f"  {name:<24} state left out: no recorded column depends on it"
            for name in self.unobserved
        ]
        sent, read = (
            ", ".join(c.column for c in self.columns if c.role == role)
            for role in ("input", "output")
        )
        lines.append(f"  Assumed inputs: {sent or 'none'}; outputs: {read}.")
        if self.turned:
            lines.append(
                f"  If your bench imposes {read} and measures {sent}, use "
                f"--like {' or '.join(self.turned)}."
            )
        if self.also:
            others = ", ".join(match.rig for match in self.also)
            lines.append(f"  The columns also fit {others} (--like NAME).")
        rig = catalogue_rig(self.like)
        lines += [
            f"  It has {no_place_words(q)}." for q in no_places(rig, effects().values(), rigs())
        ]
        lines.append("  Its values come from the example rig: replace the values marked GUESS.")
        return "\n".join(lines)

    def __repr__(self) -> str:
        return f"<NewRig {self.path} after {self.like}>"

    def _repr_html_(self) -> str:
        rows = [(c.column, c.role, c.stands_for) for c in self.columns]
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
    require_new([path], arguments.overwrite)
    name = class_name(path.stem)
    given = recording_given(arguments.recording)
    held = [name for name, values in given.columns.items() if held_by_jumps(values)]
    match, others = best_match(given.columns, arguments.like, arguments.columns, held)
    source = RigSource(match, given, name, given.path.name)
    make_folder(path.parent)
    write_atomically(path, source.text().encode())
    kind: type[Rig] = type(name, (Rig,), {})  # its name is that of the class in the file
    return NewRig(
        output=str(path),
        rig=kind.name,
        like=match.rig.name,
        score=round(match.score, 4),
        columns=tuple(
            TakenColumn(
                column=q.recorded,
                unit=unit_label(split_column(q.recorded)[1]),
                role=q.role,  # type: ignore[arg-type]
                stands_for=q.wanted,
                by=q.by,  # type: ignore[arg-type]
                scaled=q.scaled,
            )
            for q in match.pairs
        ),
        unrecorded=match.unrecorded,
        unused=match.unused,
        unobserved=source.unobserved,
        turned=match.exchanged_rigs,
        also=tuple(OtherMatch(rig=m.rig.name, score=round(m.score, 4)) for m in others),
    )
