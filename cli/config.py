"""`pamid config`: Show the value of every option, and where it comes from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pamid.api.options.record import argument

from . import frame, settings_files
from .table import COMMANDS

if TYPE_CHECKING:
    from pamid.base.schemas.command_files import OptionSetting

HELP_ORDER = 170
EXAMPLE = """
pamid config diagnose
"""


@dataclass(frozen=True)
class Arguments:
    """Show the options of all commands, or of these, with their values and sources.

    The command line takes precedence. The environment (PAMID_DIAGNOSE_JOBS=4) comes next, then the
    nearest pamid.toml in this folder or above it, then the default. A pamid.toml has a table per
    command, and [defaults] for all commands that have the option.

    A pamid.toml that others may have written is ignored, and so is a file in a folder above and
    outside your home. Files to run, a cluster, and permission to replace files are read only from a
    pamid.toml that you own and that lies in your home:

    \b
        [defaults]
        jobs = 4
        [diagnose]
        without = ["clock-skew"]
    """

    commands: Sequence[str] = argument(default=(), metavar="[COMMAND]...")


@frame.command("config", Arguments, example=EXAMPLE)
def command(arguments: Arguments) -> frame.Result:
    from pamid.base.schemas.command_files import AllSettings

    path, commands = settings_files.settings_file(), arguments.commands
    if path is not None:
        # checks the whole file, also the tables of other commands
        settings_files.read_settings(path)
    for name in commands:
        frame.require_command(name)
    shown = {name: _values(name) for name in commands or COMMANDS}
    ignored = {str(file): why for file, why in settings_files.ignored_files().items()}
    limited = settings_files.why_harmless_only(path) if path is not None else ""
    settings = AllSettings(
        file=None if path is None else str(path),
        commands=shown,
        ignored=ignored,
        harmless_only=limited,
    )
    lines = [f"Ignored: {file}: {why}." for file, why in ignored.items()]
    if limited:
        lines.append(
            f"Its rig and effect files, cluster, force and overwrite are ignored: {limited}."
        )
    return frame.Result(settings, _text(shown, path, bool(commands), lines))


def _values(name: str) -> dict[str, OptionSetting]:
    from pamid.base.schemas.command_files import OptionSetting

    context = frame.blank_context(name)
    return {
        option: OptionSetting(
            value=_plain(context.params.get(str(parameter.name))),
            origin=settings_files.origin_of(context, parameter),
        )
        for option, parameter in settings_files.options_of(context.command).items()
        if not parameter.hidden
    }


def _plain(value: Any) -> Any:
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    return str(value) if isinstance(value, Path) else value


def _text(
    shown: dict[str, dict[str, OptionSetting]],
    path: Path | None,
    all_of_them: bool,
    about_files: list[str],
) -> str:
    lines = [
        f"Settings: {path}"
        if path
        else f"There is no {settings_files.SETTINGS_FILE} here or above.",
        *about_files,
    ]
    for name, options in shown.items():
        listed = {
            k: v
            for k, v in options.items()
            if all_of_them or v.origin not in ("default", "required")
        }
        if not listed:
            continue
        lines += ["", f"[{name}]"]
        for option, setting in listed.items():
            value = "-" if setting.value in (None, []) else setting.value
            lines.append(f"{option:22s} {value!s:24s} {setting.origin}")
    if not all_of_them and len(lines) == 1 + len(about_files):
        lines.append("Every option has its default; `pamid config fit` lists those of fit.")
    return "\n".join(lines)
