"""Frame around every command: a JSON object or a text on stdout, errors on stderr, exit codes.

Nothing heavy is imported here, so that `pamid --help` responds at once.
"""

from __future__ import annotations

import contextlib
import errno
import inspect
import io
import json
import os
import sys
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

import click
from click.core import ParameterSource

from pamid.base.errors import PamidError, UsageError, nearest
from pamid.base.printable_text import printable, printable_json

from . import settings_files
from .signals import INTERRUPTED, was_signalled, watch_signals
from .table import ALIASES, COMMANDS, load_command
from .terminal import aside, hang_up, say, warning

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    from pamid.base.progress import ProgressLine
    from pamid.base.schemas.model import Model

Arguments = TypeVar("Arguments", bound="DataclassInstance")
PACKAGES = "pamid.packages"  # of a context: the values of --package
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)
_HELP = """Find where a grey-box model departs from its rig, which effect causes it, and how far the
gap shrinks.

To begin, run `pamid demo`, which needs no files. With your recording, run
`pamid check REC.csv`, then `pamid diagnose REC.csv --rig RIG`."""
_EPILOG = (
    "Options can also be set in pamid.toml or the environment (see `pamid config`). Exit codes: 0 "
    "done, 2 usage, 3 a file is wrong, 4 the data cannot answer, 5 not converged, 6 partly done, "
    "7 a condition of --fail-if is met."
)


@dataclass(frozen=True)
class Result:
    """Result of a command: `json` for scripts (a model of pamid.base.schemas, or its written form),
    and `text` for people. The exit code is 0, or 4 to 7 for a written result with shortcomings."""

    json: Model | dict[str, Any] = field(default_factory=dict)
    text: str = ""
    exit_code: int = 0


def command(
    name: str, record: Any, *, example: str
) -> Callable[[Callable[[Any], Result]], click.Command]:
    """Decorator for the function of a command file, which takes the record of its arguments and
    returns a `Result`.

    Options and help come from the fields and the docstring of the record; `example` is the shell
    lines at the end of the help (a test runs them). The options `--json` and `--debug` are added,
    and `--package` if the command accepts a model file.
    """
    from .generated import parameters_of, record_from

    def wrap(function: Callable[[Any], Result]) -> click.Command:
        parameters = parameters_of(record)
        if any("--rig" in p.opts and not isinstance(p.type, click.Choice) for p in parameters):
            parameters.append(_package_option())
        wrapped = _Command(
            name,
            params=[*parameters, *_standard_flags()],
            callback=lambda **values: function(record_from(record, values)),
            help=inspect.getdoc(record),
        )
        wrapped.example = example.strip()
        return wrapped

    return wrap


def reporting(arguments: Arguments, progress: ProgressLine) -> Arguments:
    """The record of arguments with what a command adds: progress, warnings and its words."""
    added = {"progress": progress, "warn": warning, "command": command_line()}
    names = {item.name for item in fields(arguments)}
    return replace(arguments, **{k: v for k, v in added.items() if k in names})


def refuse_inapplicable(record: Any, choice: str) -> None:
    """Raise UsageError for an option of the command line that does not apply to a choice.

    choice: the other option, as `--paper arm`
    """
    from pamid.api.options.record import about_fields

    for item, about in about_fields(record):
        applies = not about.applies_to or choice.rpartition(" ")[2] in about.applies_to
        if not applies and was_given(item.name):
            raise UsageError(
                f"--{item.name.replace('_', '-')} does not apply to {choice}.",
                f"It belongs to {' and '.join(about.applies_to)}.",
            )


def was_given(name: str) -> bool:
    """Whether an option of the running command stands on its line."""
    source = click.get_current_context().get_parameter_source(name)
    return source is ParameterSource.COMMANDLINE


def _standard_flags() -> list[click.Parameter]:
    return [
        click.Option([word], is_flag=True, expose_value=False, help=text)
        for word, text in (
            ("--json", "Print a single JSON object."),
            ("--debug", "Show the traceback of an error."),
        )
    ]


def _package_option() -> click.Option:
    """--package: folders of ROS packages, valid while the command runs."""

    def state(ctx: click.Context, _: click.Parameter, pairs: tuple[str, ...]) -> None:
        if pairs and not ctx.resilient_parsing:
            from pamid.rigs.simulators.model_packages import model_packages, split_package

            ctx.meta[PACKAGES] = pairs
            ctx.with_resource(model_packages(**dict(map(split_package, pairs))))

    return click.Option(
        ["--package"],
        multiple=True,
        metavar="NAME=DIR",
        expose_value=False,
        callback=state,
        help="Folder of a ROS package that a URDF or MuJoCo model names (package://NAME/...). "
        "[default: looked for near the model, then in ROS_PACKAGE_PATH]",
    )


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run `pamid` with these arguments (default: those of the process) and exit."""
    # matrices are small, so threads of BLAS cost more than they gain; jobs use the cores instead
    for library in ("OPENBLAS", "OMP", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    # The next opened file would get the number of a closed stream, and output would go into it.
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    if isinstance(sys.stdout, io.TextIOWrapper):  # escapes characters that it cannot encode
        sys.stdout.reconfigure(errors="backslashreplace")
    words = sys.argv[1:] if arguments is None else arguments
    watch_signals(partial(_print_last_words, "--json" in _flags(words)))
    code = run(words)
    # Python flushes both at exit, and would fail there without a message of ours
    for stream in (sys.stdout, sys.stderr):
        try:
            if stream is not None:
                stream.flush()
        except OSError:
            hang_up(stream)
    sys.exit(code)


def _print_last_words(as_json: bool) -> None:
    """Print, unbuffered, that the command was interrupted."""
    described, _ = _explain(KeyboardInterrupt())
    if as_json:
        os.write(1, f"{_json(described)}\n".encode())
    else:
        os.write(2, f"pamid: {described['message']}\n  {described['hint']}\n".encode())


def run(arguments: Sequence[str]) -> int:
    """Run `pamid` with these arguments and return its exit code."""
    flags = _flags(arguments)
    as_json, debug = "--json" in flags, "--debug" in flags
    stray = io.StringIO()  # in JSON mode nothing but the object may reach stdout
    try:
        with contextlib.redirect_stdout(stray) if as_json else contextlib.nullcontext():
            result = GROUP.main(
                list(arguments),
                prog_name="pamid",
                standalone_mode=False,
                auto_envvar_prefix=settings_files.ENVIRONMENT,
            )
    except BaseException as error:
        if isinstance(error, SystemExit) and not error.code:
            return 0  # click has printed the completions for a shell
        if isinstance(error, Exception) and was_signalled():
            error = KeyboardInterrupt()  # the error is only a consequence of the signal
        return _print_error(error, as_json, debug)
    try:
        if stray.getvalue() and isinstance(result, Result):
            aside(stray.getvalue().rstrip("\n"))
        if not isinstance(result, Result):  # --help and --version print by themselves
            result = Result({"schema": "pamid.text/1", "text": stray.getvalue()}, "", result or 0)
        if as_json or result.text.strip("\n"):  # help needs no package
            say(
                printable_json(_json(result.json))
                if as_json
                else printable(result.text.rstrip("\n"))
            )
    except OSError as error:
        # the result stands although the reader of a pipe has ended: `pamid score ... | head`
        return _unheard(error) or result.exit_code
    except Exception as error:
        return _print_error(error, as_json, debug)
    return result.exit_code


class _Command(click.Command):
    """A command whose help ends with an example, laid out as written."""

    example = ""

    def make_context(
        self,
        info_name: str | None,
        args: list[str],
        parent: click.Context | None = None,
        **extra: Any,
    ) -> click.Context:
        if extra.get("resilient_parsing"):  # completion in a shell needs no values
            return super().make_context(info_name, args, parent, **extra)
        # warn before parsing: an ignored file may be the reason of a missing option
        for path, why in settings_files.ignored_files().items():
            aside(f"Warning: {path} is ignored: {why}.")
        extra.setdefault("default_map", settings_files.defaults_for(self))
        context = super().make_context(info_name, args, parent, **extra)
        for sentence in settings_files.ignored_entries(context):
            aside(f"Warning: {sentence}")
        return context

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if "" in args:
            ctx.fail("An argument is empty. An unset variable of the shell may be the reason.")
        return super().parse_args(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        _IMPLIED_WORDS[:] = settings_files.implied_words(ctx)
        return super().invoke(ctx)

    def format_help(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        super().format_help(ctx, formatter)
        formatter.write(
            "\nExample:\n" + "".join(f"  {line}\n" for line in self.example.splitlines())
        )


_IMPLIED_WORDS: list[str] = []  # options of the running command that were not set on its line


def command_line() -> list[str]:
    """Words of the running command, with the options from pamid.toml and the environment.

    A run records them, so that the command can be repeated on another machine.
    """
    return [*sys.argv, *_IMPLIED_WORDS]


def require_command(name: str) -> None:
    """Raise UsageError with the nearest name unless `name` is a command."""
    if name not in COMMANDS:
        raise click.UsageError(f"There is no command {name!r}. {nearest(name, COMMANDS)}".rstrip())


def blank_context(name: str) -> click.Context:
    """Context of a command without arguments: its options at their settings."""
    parent = click.Context(GROUP, info_name="pamid", auto_envvar_prefix=settings_files.ENVIRONMENT)
    subcommand = GROUP.get_command(parent, name)
    assert subcommand is not None
    return subcommand.make_context(
        name,
        [],
        parent,
        resilient_parsing=True,
        default_map=settings_files.defaults_for(subcommand),
    )


class _LazyGroup(click.Group):
    """Finds commands in the table and imports the module of the called command."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        return load_command(cmd_name) if cmd_name in COMMANDS else None

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args:
            args = [ALIASES.get(args[0], args[0]), *args[1:]]
        if args and not args[0].startswith("-") and args[0] not in COMMANDS:
            ctx.fail(f"There is no command {args[0]!r}. {nearest(args[0], COMMANDS)}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


#: all of pamid as a single click command
GROUP = _LazyGroup(
    help=_HELP,
    epilog=_EPILOG,
    context_settings={"help_option_names": ["-h", "--help"]},
    no_args_is_help=True,
)
click.version_option(
    package_name="pamid", message="%(prog)s %(version)s", help="Print the version."
)(GROUP)
GROUP.params += _standard_flags()


def _print_error(error: BaseException, as_json: bool, debug: bool = False) -> int:
    if isinstance(error, BrokenPipeError):
        return _unheard(error)
    if debug and not isinstance(error, click.ClickException | click.Abort):
        aside(traceback.format_exc())
    described, code = _explain(error)
    if as_json:
        try:
            say(printable_json(_json(described)))
            return code
        except OSError as closed:
            _unheard(closed)  # the error is still printed to stderr
    if isinstance(error, click.exceptions.NoArgsIsHelpError):
        aside(error.format_message())
        return code
    label = "pamid: " if code == INTERRUPTED else "pamid: error: "
    coloured = sys.stderr is not None and sys.stderr.isatty() and not os.environ.get("NO_COLOR")
    with contextlib.suppress(OSError):
        click.echo(
            click.style(label, fg="red", bold=True) if coloured else label, nl=False, err=True
        )
    aside(described["message"])
    if described["hint"]:
        aside(f"  {described['hint']}")
    return code


def _unheard(error: OSError) -> int:
    """Exit code for a result that could not be printed: 3, or 0 if the reader of a pipe has ended
    (`pamid effects | head`)."""
    hang_up()
    if isinstance(error, BrokenPipeError):
        return 0
    aside(f"pamid: error: the result could not be printed: {error.strerror or error}.")
    return 3


def _explain(error: BaseException) -> tuple[dict[str, str], int]:
    """The pamid.error/1 object and the exit code of an exception."""
    if isinstance(error, click.exceptions.NoArgsIsHelpError):
        return _error("usage", "A command is missing.", "See `pamid --help`."), 2
    if isinstance(error, click.UsageError):
        where = error.ctx.command_path if error.ctx else "pamid"
        return _error("usage", error.format_message(), f"See `{where} --help`."), 2
    if isinstance(error, click.ClickException):
        return _error("file", error.format_message(), ""), 3
    if isinstance(error, KeyboardInterrupt | click.Abort):
        return _error("interrupted", "interrupted", "Finished work is kept."), INTERRUPTED
    if isinstance(error, PamidError):
        return error.as_dict(), error.exit_code
    if isinstance(error, SystemExit):
        code = error.code if isinstance(error.code, int) else 1
        return _error("exit", f"ended with code {error.code!r}", ""), code
    if isinstance(error, OSError) and error.strerror:
        return _refused(error), 3
    detail = " ".join(str(error).split())
    hint = (
        "This is a fault of pamid, or of a rig or effect file. Repeat the command with --debug "
        "for the traceback."
    )
    return _error("unexpected", f"{type(error).__name__}: {detail}".rstrip(": "), hint), 1


_MENDS = {
    **dict.fromkeys(
        (errno.ENOTDIR, errno.EEXIST),
        "A part of the path is a file, but must be a folder. Choose another path.",
    ),
    errno.EISDIR: "It is a folder, but must be a file.",
    errno.ENAMETOOLONG: "Choose a shorter name.",
    errno.ENOENT: "Check the path.",
    errno.ELOOP: "It is a link to itself.",
    **dict.fromkeys(
        (errno.EACCES, errno.EPERM), "Access is denied. Check its owner and permissions."
    ),
    **dict.fromkeys(_NO_ROOM, "Free some space and repeat the command."),
}


def _refused(error: OSError) -> dict[str, str]:
    """Error entry for a failed call to the operating system, with the file concerned."""
    name = str(error.filename or "")
    shown = name if len(name) <= 200 else f"{name[:80]}...{name[-40:]}"
    return _error(
        "disk-full" if error.errno in _NO_ROOM else "file",
        f"{shown}: {error.strerror}." if shown else f"{error.strerror}.",
        _MENDS.get(error.errno or 0, "Check the path, the file and its permissions."),
    )


def _error(code: str, message: str, hint: str) -> dict[str, str]:
    return {"schema": "pamid.error/1", "code": code, "message": message, "hint": hint}


def _json(value: Model | dict[str, Any]) -> str:
    value = value if isinstance(value, dict) else value.as_json()
    # handles NumPy's numbers, which cannot occur unless this module is loaded
    if "pamid.base.json_file" in sys.modules:
        from pamid.base.json_file import json_text

        return json_text(value, "the result").rstrip("\n")
    return json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False)


def _flags(arguments: Sequence[str]) -> set[str]:
    """Words before a bare `--`, read without click, whose parsing may fail before."""
    words = list(arguments)
    return set(words[: words.index("--")] if "--" in words else words)
