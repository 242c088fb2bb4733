"""Arguments of a verb as a record: the signature of its function, and the options of its command.

A field states name, type, default and help once. `verb` makes the Python function of it, and
`cli/generated.py` the command, which resolves the annotations whose types are heavy to import.
"""

from __future__ import annotations

import functools
import inspect
import os
import re
import textwrap
from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields
from typing import Annotated, Any, ParamSpec, Protocol, TypeAlias, TypeVar

from pamid.base.errors import UsageError

Parameters = ParamSpec("Parameters")
Record = TypeVar("Record")
RecordTaken = TypeVar("RecordTaken", contravariant=True)
Answer = TypeVar("Answer")
Returned = TypeVar("Returned", covariant=True)


@dataclass(frozen=True)
class Kind:
    """Kind of a text in an annotation: "path", "file" or "folder"; or the catalogue of names that a
    shell completes: "rigs", "effects" or "networks"."""

    name: str


_SECTION = r"\n\n(?=(?:Returns|Raises)\n)"
AnyPath: TypeAlias = Annotated[str | os.PathLike[str], Kind("path")]
FilePath: TypeAlias = Annotated[str | os.PathLike[str], Kind("file")]
FolderPath: TypeAlias = Annotated[str | os.PathLike[str], Kind("folder")]
RigName: TypeAlias = Annotated[str, Kind("rigs")]
EffectName: TypeAlias = Annotated[str, Kind("effects")]
NetworkName: TypeAlias = Annotated[str, Kind("networks")]


@dataclass(frozen=True)
class About:
    """About a field of a record.

    text, words      help; names on the command line (default: that of the field)
    in_python        text for the Python function, where the help does not suit
    metavar          placeholder of the value in the help
    least, most      bounds of a number
    above            bound of a number, which it must exceed
    choices          values of a text
    command_default  default of the command, where it differs
    parse            function from the text of the command line to the value
    applies_to       values of another option with which this option makes sense; (): all
    separator        between the items of a sequence that is given as a single text
    formerly         earlier name of a switch, still accepted
    negated          the switch turns the field off
    positional       argument of the command, instead of an option
    python_only      no option of the command
    click            further settings of the click parameter
    """

    text: str
    words: tuple[str, ...] = ()
    in_python: str = ""
    metavar: str | None = None
    least: float | None = None
    most: float | None = None
    above: float | None = None
    choices: tuple[str, ...] = ()
    command_default: Any = None
    parse: Callable[[Any], Any] | None = None
    applies_to: tuple[str, ...] = ()
    separator: str = ""
    formerly: str = ""
    negated: bool = False
    positional: bool = False
    python_only: bool = False
    click: Mapping[str, Any] | None = None


def option(default: Any, text: str, *words: str, **about: Any) -> Any:
    """Field of a record that is an option of the command; see `About`."""
    return field(default=default, metadata={"about": About(text, words, **about)})


def required_option(text: str, *words: str, **about: Any) -> Any:
    """Field of a record that is an option of the command and has no default."""
    return field(metadata={"about": About(text, words, **about)})


def argument(text: str = "", default: Any = MISSING, **about: Any) -> Any:
    """Field of a record that is a positional argument of the command."""
    return field(default=default, metadata={"about": About(text, positional=True, **about)})


def in_python_only(default: Any, text: str) -> Any:
    """Field of a record that is no option of the command."""
    return field(default=default, metadata={"about": About(text, python_only=True)})


def about_fields(record: Any) -> Iterator[tuple[Field[Any], About]]:
    for item in fields(record):
        yield item, item.metadata["about"]


class Verb(Protocol[Parameters, RecordTaken, Returned]):
    """Function whose arguments are the fields of a record."""

    record: Any

    def __call__(self, *args: Parameters.args, **kwargs: Parameters.kwargs) -> Returned: ...

    def of(self, record: RecordTaken) -> Returned:
        """The same, for arguments in a record."""


def verb(
    record: Callable[Parameters, Record],
) -> Callable[[Callable[[Record], Answer]], Verb[Parameters, Record, Answer]]:
    """Decorator that lets a function of a record take the fields of that record as arguments.

    Signature and docstring list them with the texts of their options.
    """

    def wrap(function: Callable[[Record], Answer]) -> Verb[Parameters, Record, Answer]:
        @functools.wraps(function)
        def called(*args: Parameters.args, **kwargs: Parameters.kwargs) -> Answer:
            return function(record(*args, **kwargs))

        of_record: Any = called
        of_record.record, of_record.of = record, function
        of_record.__signature__ = inspect.signature(record).replace(
            return_annotation=function.__annotations__["return"]
        )
        summary, rest = re.split(_SECTION, inspect.getdoc(function) or "", maxsplit=1)
        lines = [summary, "", "Parameters", "----------"]
        for item, about in about_fields(record):
            words = textwrap.fill(about.in_python or about.text, 90)
            lines += [item.name, textwrap.indent(words, "    ")]
        of_record.__doc__ = "\n".join([*lines, "", rest])
        verb_of_record: Verb[Parameters, Record, Answer] = of_record
        return verb_of_record

    return wrap


def parse_pairs(hint: str = "For example inertia_kg_m2=0.0896.") -> Callable[[Any], dict[str, Any]]:
    """Function from ("inertia_kg_m2=0.0896", ...) to a table of numbers; hint: for the error."""

    def parse(pairs: tuple[str, ...]) -> dict[str, Any]:
        table = {}
        for pair in pairs:
            name, _, value = pair.partition("=")
            try:
                table[name.strip()] = float(value)
            except ValueError:
                raise UsageError(f"{pair!r} is not NAME=VALUE with a number.", hint) from None
        return table

    return parse


def known_option(text: str) -> Any:
    return option(None, text, "--known", metavar="NAME=VALUE", parse=parse_pairs())


def noise_option(text: str) -> Any:
    """The --noise option: default, none or a factor."""
    return option(1.0, text, command_default="default", parse=_noise_factor)


def _noise_factor(text: str) -> float:
    names: Mapping[str, float] = {"default": 1.0, "none": 0.0}
    try:
        factor = names[text] if text in names else float(text)
    except ValueError:
        factor = -1.0
    if factor < 0.0:
        raise UsageError(f"--noise {text!r}: it takes default, none or a factor of at least 0.")
    return factor


def which_option(text: str) -> Any:
    """The --which option; text: its first sentence."""
    return option(
        "best",
        f"{text} cause: with the causes of the diagnosis. network: as the network was trained, "
        "with the network. refitted: the fitted rig alone. best: causes and network if the network "
        "was trained with the causes, else the first of cause, network and refitted that the run "
        "has.",
    )


def seed_option(text: str, default: int = 0, **about: Any) -> Any:
    return option(default, text, least=0, **about)


def jobs_option(text: str = "Processes to use.", default: int | None = 2, **about: Any) -> Any:
    return option(default, text, least=1, most=256, **about)


def cluster_option() -> Any:
    return option(
        None,
        "Run the jobs on the Dask cluster of this scheduler instead, with the same results. "
        "Scheduler and workers must be trusted: jobs and results are pickled, so everybody who can "
        "reach the scheduler can run code on the workers and on this machine. For TLS give "
        "tls://HOST:8786, with certificates from Dask's configuration or "
        "DASK_DISTRIBUTED__COMM__TLS__CA_FILE, ..__CLIENT__CERT, ..__CLIENT__KEY. "
        "(pip install 'pamid[cluster]')",
        metavar="tcp://HOST:8786",
    )


def run_output_option(name: str) -> Any:
    """The --output option of a command that creates a run folder; name: default of the command."""
    about = "Run folder. Default: a temporary folder, which `save` copies."
    return option(None, "Run folder to create.", command_default=name, in_python=about)
