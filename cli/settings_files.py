"""Settings from `pamid.toml`: values of a project in place of pamid's defaults.

The nearest `pamid.toml` in the working folder or above it has a table per command, and
`[defaults]` for every command that has the option. The command line takes precedence over the
environment (PAMID_DIAGNOSE_JOBS), the environment over this file, and the file over the default.
`pamid config` shows the source of every value.

A downloaded folder must not decide what pamid does, so a file is trusted only by its owner and
place:

- A file that somebody else may have written is ignored. That is so where it or its folder belongs
  to a user other than this user or root, or where others may write to it, its folder or a folder
  above. A group of the user alone does not count. A file in a sticky folder such as /tmp is
  ignored, a file in a private subfolder of it is not.
- Outside the user's home only the file of the working folder counts.
- Three kinds of entries are read only from a file that the user owns, in the user's home: code to
  run (the path of a rig or effect file), an address (`cluster`), and permission to replace files
  (`force`, `overwrite`).

A sentence on stderr names every entry that is ignored. The command line and the environment always
count.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from pamid.base.errors import nearest
from pamid.base.trust import is_code, is_users_file, why_shared, within_home

from .generated import Catalogued
from .table import COMMANDS, every_command

SETTINGS_FILE = "pamid.toml"
SHARED_TABLE = "defaults"
ENVIRONMENT = "PAMID"
_OURS = ("json", "debug", "help")
_RISKY = ("cluster", "force", "overwrite")  # with paths of code; see above


class SettingsError(click.ClickException):
    """A mistake in pamid.toml; `hint` is the remedy."""

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(f"{message} {hint}".rstrip())


def settings_file() -> Path | None:
    """The pamid.toml that applies in the working folder, or None."""
    return next((path for path, why in _candidate_files() if not why), None)


def ignored_files() -> dict[Path, str]:
    """Files nearer than the file that applies, which are not trusted, with the reason."""
    return dict(itertools.takewhile(lambda candidate: candidate[1], _candidate_files()))


def _candidate_files() -> Iterator[tuple[Path, str]]:
    """Every pamid.toml in the working folder and above, nearest first, and why it is ignored, or
    ""."""
    try:
        start = Path.cwd().resolve()
    except FileNotFoundError:  # somebody removed the working folder
        return
    for place in (start, *start.parents):
        path = place / SETTINGS_FILE
        if path.is_file() and place != start and not within_home(path):
            yield path, "it lies above the working folder and outside your home"
        elif path.is_file():
            yield path, why_shared(path)


def why_harmless_only(path: Path) -> str:
    """Reason to ignore code, addresses and permission to replace files in this file, or ""."""
    if not within_home(path):
        return "the file lies outside your home"
    return "" if is_users_file(path) else "the file is not yours"


def read_settings(path: Path) -> dict[str, dict[str, Any]]:
    """Tables of the file, by command.

    Raises SettingsError if the file cannot be read, is not TOML, or names an unknown command.
    """
    return _read(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=4)
def _read(path: Path, _stamp: int) -> dict[str, dict[str, Any]]:
    from pamid.base.errors import FileError
    from pamid.base.toml_file import read_toml

    try:
        tables = read_toml(path)
    except FileError as error:
        raise SettingsError(error.message, error.hint) from error
    for name, table in tables.items():
        if name not in (SHARED_TABLE, *COMMANDS):
            raise SettingsError(
                f"{path}: there is no command [{name}].", _nearest(name, (SHARED_TABLE, *COMMANDS))
            )
        if not isinstance(table, dict):
            raise SettingsError(
                f"{path}: {name} is not in a table.",
                f"Write it below [{SHARED_TABLE}] or below a command.",
            )
    return tables


@dataclass(frozen=True)
class Entry:
    """An entry of pamid.toml for an option of a command; ignored: why it is not trusted, or ""."""

    path: Path
    table: str
    key: str
    option: click.Option
    value: Any
    ignored: str


def entries_for(command: click.Command) -> list[Entry]:
    """Checked entries of pamid.toml for the options of this command; later ones take precedence."""
    path = settings_file()
    if path is None:
        return []
    tables, options, why = read_settings(path), options_of(command), why_harmless_only(path)
    shared = tables.get(SHARED_TABLE, {})
    known = {name for other in every_command() for name in options_of(other)} if shared else set()
    for key in shared:
        if key not in known:
            raise SettingsError(
                f"{path}: [{SHARED_TABLE}] {key}: no command has this option.", _nearest(key, known)
            )
    entries = []
    for table in (SHARED_TABLE, str(command.name)):
        for key, value in tables.get(table, {}).items():
            if key in options:
                checked = _checked(f"{path}: [{table}] {key}", command, options[key], value)
                ignored = why if is_risky(options[key], checked) else ""
                entries.append(Entry(path, table, key, options[key], checked, ignored))
            elif table != SHARED_TABLE:
                raise SettingsError(
                    f"{path}: [{table}] {key}: no such option.", _nearest(key, options)
                )
    return entries


def defaults_for(command: click.Command) -> dict[str, Any]:
    """Values of pamid.toml for the options of this command, by parameter; {} without a file."""
    return {str(e.option.name): e.value for e in entries_for(command) if not e.ignored}


def ignored_entries(context: click.Context) -> list[str]:
    """A sentence per ignored entry of this command in pamid.toml that is not set elsewhere."""
    return [
        f"{e.path}: [{e.table}] {e.key} is ignored, because {e.ignored}. Give --{e.key} on the "
        "command line."
        for e in entries_for(context.command)
        if e.ignored and context.get_parameter_source(str(e.option.name)) is ParameterSource.DEFAULT
    ]


def is_risky(option: click.Option, value: Any) -> bool:
    """Would this value run a file, send work to an address, or replace files?"""
    if option.name in _RISKY:
        return bool(value)
    if not isinstance(option.type, Catalogued):
        return False
    return any(is_code(str(item)) for item in (value if isinstance(value, list) else [value]))


def options_of(command: click.Command) -> dict[str, click.Option]:
    """Options by their name in pamid.toml: `--held-out` is held-out."""
    options = {}
    for option in command.params:
        if isinstance(option, click.Option) and option.name not in _OURS:
            options[max(option.opts, key=len).lstrip("-")] = option
    return options


def implied_words(context: click.Context) -> list[str]:
    """Words of a command line for the values that came from the environment or pamid.toml."""
    words: list[str] = []
    for name, option in options_of(context.command).items():
        value = context.params.get(str(option.name))
        if context.get_parameter_source(str(option.name)) not in (
            ParameterSource.ENVIRONMENT,
            ParameterSource.DEFAULT_MAP,
        ):
            continue
        if option.is_flag:
            words += [f"--{name}"] if value else []
            continue
        for item in (value or ()) if option.multiple else [value]:
            parts = item if isinstance(item, tuple | list) else (item,)
            words += [f"--{name}", *map(str, parts)]
    return words


def origin_of(context: click.Context, option: click.Option) -> str:
    """Source of an option's value, in words."""
    source = context.get_parameter_source(str(option.name))
    if source is ParameterSource.ENVIRONMENT:
        return f"environment, {context.auto_envvar_prefix}_{str(option.name).upper()}"
    if source is ParameterSource.DEFAULT_MAP:
        entry = [e for e in entries_for(context.command) if e.option is option][-1]
        return f"{entry.path} [{entry.table}]"
    return "required" if option.required else "default"


def _checked(place: str, command: click.Command, option: click.Option, value: Any) -> Any:
    items = value if isinstance(value, list) else [value]
    for item in items:
        if not isinstance(item, str | bool | int | float):
            kind = (
                "a table"
                if isinstance(item, dict)
                else "a list"
                if isinstance(item, list)
                else f"the date {item}"
            )
            raise SettingsError(f"{place}: this is {kind}, but must be a single value.")
        if item == "" or isinstance(item, float) and not math.isfinite(item):
            raise SettingsError(
                f"{place}: {item!r} is not a valid value.", "Delete the line to use the default."
            )
    if option.multiple and not isinstance(value, list):
        value = [value]
    booleans = [item for item in items if isinstance(item, bool)]
    if option.is_flag and not isinstance(value, bool):
        raise SettingsError(f"{place}: {value!r} is neither true nor false.")
    if booleans and not option.is_flag:
        raise SettingsError(
            f"{place}: this is {str(booleans[0]).lower()}, but must be a name or a number."
        )
    if not option.multiple and isinstance(value, list) and option.nargs == 1:
        raise SettingsError(f"{place}: this is a list, but must be a single value.")
    try:
        option.type_cast_value(click.Context(command), value)
    except click.BadParameter as error:
        raise SettingsError(f"{place}: {error.message}") from None
    except (TypeError, ValueError, OverflowError):
        raise SettingsError(f"{place}: {value!r:.60} is not a valid value.") from None
    return value


def _nearest(name: str, names: Sequence[str] | Mapping[str, Any] | set[str]) -> str:
    return nearest(name, names) or f"There are: {', '.join(sorted(names))}."
