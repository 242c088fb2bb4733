"""Settings from `pamid.toml`: options that a project wants otherwise than pamid's defaults.

The nearest `pamid.toml`, in the working folder or above it, holds a table per command and
`[defaults]` for every command that has the option. What is said on the command line goes first,
then the environment (PAMID_DIAGNOSE_JOBS), then this file, then the default; `pamid config` shows
where every value comes from.

Nobody but the user decides what pamid does, so a file is not believed because it lies there:

- One that somebody else may have written is as if it were not there: it or its folder belongs to
  another user than this one or root, or others may write it, its folder or a folder above (a group
  of the user alone does not count; a sticky folder such as /tmp is no place for one, its private
  subfolders are).
- Outside the user's home only the working folder's own file counts, none of a folder above.
- What runs code (the path of a rig or effect file), an address (`cluster`) and leave to replace
  files (`force`, `overwrite`) are taken only from a file that the user owns, in the user's home.

What is not taken is said in a sentence on stderr. The command line and the environment always
count.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from .names import OPTIONS, suggest
from .table import COMMANDS, every_command

SETTINGS_FILE = "pamid.toml"
SHARED_TABLE = "defaults"
ENVIRONMENT = "PAMID"
_OURS = ("json", "debug", "help")
_RISKY = ("cluster", "force", "overwrite")  # with paths of code; see above


class SettingsError(click.ClickException):
    """Something in pamid.toml is wrong; `hint` says how to mend it."""

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(f"{message} {hint}".rstrip())


def settings_file(folder: Path | None = None) -> Path | None:
    """The pamid.toml that holds for a folder (default: the working folder), or None."""
    return next((path for path, why in _found(folder) if not why), None)


def ignored_files(folder: Path | None = None) -> dict[Path, str]:
    """Those that would hold for the folder if they were to be believed, and why they are not."""
    reasons = {}
    for path, why in _found(folder):
        if not why:
            break
        reasons[path] = why
    return reasons


def _found(folder: Path | None) -> Iterator[tuple[Path, str]]:
    """Every pamid.toml here and above, the nearest first, and why it is ignored ("" if it is
    not)."""
    try:
        here = (folder or Path.cwd()).resolve()
    except FileNotFoundError:  # somebody removed the working folder
        return
    for place in (here, *here.parents):
        path = place / SETTINGS_FILE
        if path.is_file():
            yield path, _why_ignored(path, place == here)


def _why_ignored(path: Path, nearest: bool) -> str:
    from pamid.base.trust import why_shared, within_home

    if not nearest and not within_home(path):
        return "it lies above the working folder and outside your home"
    return why_shared(path)


def why_harmless_only(path: Path) -> str:
    """Why code, addresses and leave to replace files are not taken from this file; "" where they
    are."""
    from pamid.base.trust import is_own, within_home

    if not within_home(path):
        return "the file lies outside your home"
    return "" if is_own(path) else "the file is not yours"


def read_settings(path: Path) -> dict[str, dict[str, Any]]:
    """Tables of the file, by command. SettingsError for what cannot be read, is no TOML, or
    names no command."""
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
                f"{path}: [{name}] is no command.", _nearest(name, (SHARED_TABLE, *COMMANDS))
            )
        if not isinstance(table, dict):
            raise SettingsError(
                f"{path}: {name} stands outside a table.",
                f"Write it below [{SHARED_TABLE}] or a command.",
            )
    return tables


def defaults_for(command: click.Command) -> dict[str, Any]:
    """Values of pamid.toml for the options of this command, by parameter, checked; {} where there
    is no file."""
    path = settings_file()
    if path is None:
        return {}
    tables, options = read_settings(path), options_of(command)
    _require_known(path, tables.get(SHARED_TABLE, {}))
    own = tables.get(str(command.name), {})
    chosen: dict[str, Any] = {}
    for table, entries in ((SHARED_TABLE, tables.get(SHARED_TABLE, {})), (command.name, own)):
        for key, value in entries.items():
            if key in options:
                checked = _checked(f"{path}: [{table}] {key}", command, options[key], value)
                if not (is_risky(options[key], checked) and why_harmless_only(path)):
                    chosen[str(options[key].name)] = checked
            elif table != SHARED_TABLE:
                raise SettingsError(
                    f"{path}: [{table}] {key}: no such option.", _nearest(key, options)
                )
    return chosen


def not_taken(context: click.Context) -> list[str]:
    """A sentence for every entry of this command that is not taken from the settings, unless it was
    said elsewhere."""
    path, command = settings_file(), context.command
    why = why_harmless_only(path) if path else ""
    if path is None or not why:
        return []
    tables, options = read_settings(path), options_of(command)
    return [
        f"{path}: [{table}] {key} is not taken, because {why}: say --{key} yourself."
        for table in (SHARED_TABLE, str(command.name))
        for key, value in tables.get(table, {}).items()
        if key in options
        and is_risky(options[key], value)
        and context.get_parameter_source(str(options[key].name)) is ParameterSource.DEFAULT
    ]


def is_risky(option: click.Option, value: Any) -> bool:
    """Would this value run a file, send work to an address, or replace files?"""
    if option.name in _RISKY:
        return bool(value)
    if option.name not in OPTIONS:
        return False
    from pamid.base.trust import is_code

    return any(is_code(str(one)) for one in (value if isinstance(value, list) else [value]))


def options_of(command: click.Command) -> dict[str, click.Option]:
    """Options by the name they have in pamid.toml: `--held-out` is held-out."""
    options = {}
    for option in command.params:
        if isinstance(option, click.Option) and option.name not in _OURS:
            options[max(option.opts, key=len).lstrip("-")] = option
    return options


def said_elsewhere(context: click.Context) -> list[str]:
    """Words that would give, on the command line, what came from the environment or pamid.toml."""
    words: list[str] = []
    for name, option in options_of(context.command).items():
        if context.get_parameter_source(str(option.name)) in (
            ParameterSource.ENVIRONMENT,
            ParameterSource.DEFAULT_MAP,
        ):
            words += _words(name, option, context.params.get(str(option.name)))
    return words


def origin_of(context: click.Context, option: click.Option) -> str:
    """Where the value of an option comes from, in words."""
    source = context.get_parameter_source(str(option.name))
    if source is ParameterSource.ENVIRONMENT:
        return f"environment, {context.auto_envvar_prefix}_{str(option.name).upper()}"
    if source is ParameterSource.DEFAULT_MAP:
        path = settings_file()
        own = read_settings(path).get(str(context.command.name), {}) if path else {}
        name = max(option.opts, key=len).lstrip("-")
        return f"{path} [{context.command.name if name in own else SHARED_TABLE}]"
    return "required" if option.required else "default"


def _words(name: str, option: click.Option, value: Any) -> list[str]:
    if option.is_flag:
        return [f"--{name}"] if value else []
    values = value if option.multiple else [value]
    return [
        word
        for item in values
        for word in (f"--{name}", *map(str, item if isinstance(item, tuple | list) else (item,)))
    ]


def _require_known(path: Path, shared: Mapping[str, Any]) -> None:
    """Raise unless every name in [defaults] is an option of some command."""
    if not shared:
        return
    known = {name for command in every_command() for name in options_of(command)}
    for key in shared:
        if key not in known:
            raise SettingsError(
                f"{path}: [{SHARED_TABLE}] {key}: no command has this option.", _nearest(key, known)
            )


def _checked(place: str, command: click.Command, option: click.Option, value: Any) -> Any:
    for one in value if isinstance(value, list) else [value]:
        if not isinstance(one, str | bool | int | float):
            what = (
                "a table"
                if isinstance(one, dict)
                else "a list"
                if isinstance(one, list)
                else f"the date {one}"
            )
            raise SettingsError(f"{place}: {what}, where a value is wanted.")
        if one == "" or isinstance(one, float) and not math.isfinite(one):
            raise SettingsError(
                f"{place}: {one!r} is no value for it.", "Leave the line out for the default."
            )
    if option.multiple and not isinstance(value, list):
        value = [value]
    truths = [
        one for one in (value if isinstance(value, list) else [value]) if isinstance(one, bool)
    ]
    if option.is_flag and not isinstance(value, bool):
        raise SettingsError(f"{place}: {value!r} is neither true nor false.")
    if truths and not option.is_flag:
        raise SettingsError(
            f"{place}: {str(truths[0]).lower()}, where a name or a number is wanted."
        )
    if not option.multiple and isinstance(value, list) and option.nargs == 1:
        raise SettingsError(f"{place}: a list, where one value is wanted.")
    try:
        option.type_cast_value(click.Context(command), value)
    except click.BadParameter as error:
        raise SettingsError(f"{place}: {error.message}") from None
    except (TypeError, ValueError, OverflowError):
        raise SettingsError(f"{place}: {value!r:.60} is no value for it.") from None
    return value


def _nearest(name: str, names: Sequence[str] | Mapping[str, Any] | set[str]) -> str:
    return suggest(name, names) or f"There are: {', '.join(sorted(names))}."
