"""Options of a command from the record of its arguments: `pamid.api.options.record`."""

from __future__ import annotations

import types
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, Field
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import click
from click.shell_completion import CompletionItem

from pamid.api.options.names import entries
from pamid.api.options.record import (
    About,
    AnyPath,
    EffectName,
    FolderPath,
    Kind,
    RigName,
    about_fields,
)

_SERIES = (Sequence, Iterable, Mapping)
_PATHS: dict[str, dict[str, bool]] = {
    "path": {},
    "file": {"dir_okay": False},
    "folder": {"file_okay": False},
}
#: what a command takes for types of the Python functions, none of which is loaded for its help
_LIGHT_TYPES: dict[str, Any] = {
    "RecordingLike": AnyPath,
    "RigLike": RigName,
    "EffectLike": EffectName,
    "OpenedRun": AnyPath,
    "Run": FolderPath,
    "Settings": Mapping[str, float],
    **dict.fromkeys(("Rig", "Effect", "ShowProgress", "Warn"), Any),
}


class Catalogued(click.types.StringParamType):
    """A text for which shells complete the names of a package folder, and Python files."""

    def __init__(self, folder: str) -> None:
        self.folder = folder

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        names = [name for name in entries(self.folder) if name.startswith(incomplete)]
        return [CompletionItem(name) for name in names] or [CompletionItem(incomplete, type="file")]


def parameters_of(record: type) -> list[click.Parameter]:
    """Parameters of the command whose arguments are the fields of a record."""
    hints = get_type_hints(record, localns=_LIGHT_TYPES, include_extras=True)
    parameters: list[click.Parameter] = []
    for item, about in about_fields(record):
        if not about.python_only:
            parameters.append(_parameter(item, about, hints[item.name]))
        if about.formerly:
            parameters.append(click.Option([about.formerly], is_flag=True, hidden=True))
    return parameters


def record_from(record: Any, values: Mapping[str, Any]) -> Any:
    """The record for the values of the command line."""
    given = {}
    for item, about in about_fields(record):
        if about.python_only:
            continue
        value = not values[f"no_{item.name}"] if about.negated else values[item.name]
        if about.formerly:
            value = value or values[about.formerly.lstrip("-").replace("-", "_")]
        if about.separator:
            words = [word.strip() for word in str(value or "").split(about.separator)]
            value = tuple(word for word in words if word)
        given[item.name] = about.parse(value) if about.parse else value
    return record(**given)


def _parameter(item: Field[Any], about: About, hint: Any) -> click.Parameter:
    several, hint = _element(hint)
    several = several and not about.separator
    required = item.default is MISSING
    word = f"--{item.name.replace('_', '-')}"
    settings: dict[str, Any] = {"metavar": about.metavar, "required": required}
    if not about.positional:
        settings["help"] = about.text
    if about.negated:
        return click.Option([f"--no-{word[2:]}"], is_flag=True, help=about.text)
    if hint is bool:
        words = about.words or (f"{word}/--no-{word[2:]}" if item.default is True else word,)
        shown = item.default is True
        return click.Option(
            [*words, item.name],
            is_flag=True,
            default=item.default,
            show_default=shown,
            **settings,
            **(about.click or {}),
        )
    if get_origin(hint) is tuple:
        settings["nargs"] = len(get_args(hint))
        hint = get_args(hint)[0]
    settings["type"] = _click_type(hint, about)
    settings |= about.click or {}
    if about.positional:
        if several:
            settings["nargs"] = -1
        elif not required:
            settings["default"] = item.default
        return click.Argument([item.name], **settings)
    default: Any = item.default if about.command_default is None else about.command_default
    if several:
        settings["multiple"] = True
    elif default not in (None, ()) and not required:
        is_path = isinstance(settings["type"], click.Path)
        settings["default"] = Path(default) if is_path else default
        settings["show_default"] = default != ""
    return click.Option([*(about.words or (word,)), item.name], **settings)


def _element(hint: Any) -> tuple[bool, Any]:
    """Whether an annotation takes several values, and the annotation of each."""
    members = get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,)
    members = tuple(member for member in members if member is not type(None))
    series = [member for member in members if get_origin(member) in _SERIES]
    return (True, get_args(series[0])[0]) if series else (False, members[0])


def _click_type(hint: Any, about: About) -> Any:
    """Type of a parameter for an annotation."""
    if about.choices:
        return click.Choice(about.choices)
    if get_origin(hint) is Literal:
        return click.Choice(get_args(hint))
    if get_origin(hint) is Annotated:
        (kind,) = (mark.name for mark in hint.__metadata__ if isinstance(mark, Kind))
        paths = _PATHS.get(kind)
        return Catalogued(kind) if paths is None else click.Path(path_type=Path, **paths)
    if about.parse or about.separator or hint not in (int, float):
        return click.STRING
    least = about.least if about.above is None else about.above
    if least is None and about.most is None:
        return hint
    bounded: Any = click.IntRange if hint is int else click.FloatRange
    return bounded(least, about.most, min_open=about.above is not None)
