"""Options of a command, and arguments of a function, from one record."""

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Any, Literal

import click
import pytest
from pamid_cli.generated import Catalogued, parameters_of, record_from

from pamid.api.options.record import (
    AnyPath,
    FilePath,
    RigName,
    argument,
    in_python_only,
    option,
    parse_pairs,
    required_option,
    verb,
)
from pamid.base.errors import UsageError


@dataclass(frozen=True)
class Arguments:
    """Weigh something."""

    things: Sequence[AnyPath] = argument("Things to weigh.")
    scale: float = required_option("Scale of the weights.")
    _: KW_ONLY
    rig: RigName | None = option(None, "Rig.")
    draws: int = option(3, "Draws.", "--draw", least=1, most=9)
    span: tuple[float, float] | None = option(None, "Span in s.")
    unit: Literal["kg", "g"] = option("kg", "Unit.")
    known: Mapping[str, float] | None = option(None, "Known.", parse=parse_pairs())
    columns: Sequence[str] = option((), "Columns.", separator=",")
    output: FilePath | None = option(None, "File.", command_default="w.csv", in_python="A file.")
    check: bool = option(True, "Skip the check.", negated=True, in_python="Check first.")
    overwrite: bool = option(False, "Replace the file.", formerly="--force")
    listener: Any = in_python_only(None, "Called for every thing.")


def record_of(*words: str) -> Arguments:
    command = click.Command("weigh", params=parameters_of(Arguments))
    record = record_from(Arguments, command.make_context("weigh", list(words)).params)
    assert isinstance(record, Arguments)
    return record


def test_a_command_line_becomes_a_record():
    line = "a b --scale 2 --draw 4 --span 0 1.5 --known mass=2 --columns x,y --no-check --force"
    assert record_of(*line.split()) == Arguments(
        (Path("a"), Path("b")),  # type: ignore[arg-type]
        2.0,
        draws=4,
        span=(0.0, 1.5),
        known={"mass": 2.0},
        columns=("x", "y"),
        output=Path("w.csv"),
        check=False,
        overwrite=True,
    )


def test_defaults_are_those_of_the_record():
    record = record_of("a", "--scale", "1")
    assert record == Arguments((Path("a"),), 1.0, known={}, output=Path("w.csv"))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "words", ["a", "--scale 1", "a --scale x", "a --scale 1 --draw 10", "a --scale 1 --unit t"]
)
def test_wrong_lines_are_refused(words):
    with pytest.raises(click.UsageError):
        record_of(*words.split())


def test_a_pair_without_a_number_is_refused():
    with pytest.raises(UsageError, match="NAME=VALUE"):
        record_of("a", "--scale", "1", "--known", "mass")


def test_help_states_default_and_range():
    parameters = {p.name: p for p in parameters_of(Arguments)}
    context = click.Context(click.Command("weigh"))
    draws = parameters["draws"]
    assert isinstance(draws, click.Option) and isinstance(parameters["rig"].type, Catalogued)
    assert draws.get_help_record(context) == (
        "--draw INTEGER RANGE",
        "Draws.  [default: 3; 1<=x<=9]",
    )
    assert "listener" not in parameters


def test_a_function_takes_the_fields_of_its_record():
    @verb(Arguments)
    def weigh(arguments: Arguments) -> float:
        """Weigh.

        Returns
        -------
        float
            Weight.
        """
        return arguments.scale * len(arguments.things)

    assert weigh(["a", "b"], 2.0) == weigh.of(Arguments(["a", "b"], 2.0)) == 4.0
    with pytest.raises(TypeError, match="colour"):
        weigh(["a"], 1.0, colour="red")  # type: ignore[call-arg]
    summary, parameters = str(weigh.__doc__).split("\n\nParameters\n")
    assert summary == "Weigh." and parameters.rstrip().endswith("Weight.")
    assert "check\n    Check first.\n" in parameters and "Called for every thing." in parameters
