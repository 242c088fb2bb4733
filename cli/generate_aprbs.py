"""`pamid generate-aprbs`: Generate an excitation of many kinds (also called `pamid excite`)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pamid.api.options.exciting import ExcitationArguments
from pamid.base.errors import FileError, UsageError, quoted
from pamid.base.files import make_folder, require_new

from . import frame
from .figures import require_png_name
from .hints import rig_words, unused, why_not_driven

if TYPE_CHECKING:
    from pamid.api.planned_excitation import PlannedExcitation

HELP_ORDER = 10
EXAMPLE = """
pamid generate-aprbs --rig one-dof --duration 200 --amplitude 40 --hold 0.4 1.6 --seed 1 --output excitation.csv
pamid generate-aprbs --experiment gravity-test --rig two-link --release 60 0 --clamped 1 --output gravity.csv
pamid generate-aprbs --signal multisine --loop open --amplitude 0.5 --band 0.1 5 --duration 60 --output sines.mat
"""  # noqa: E501


@frame.command("generate-aprbs", ExcitationArguments, example=EXAMPLE)
def command(arguments: ExcitationArguments) -> frame.Result:
    from pamid.api.planned_excitation import planned_excitation, with_rig_defaults
    from pamid.simulation.excitation.writers import format_of

    experiment, signal = arguments.experiment, arguments.signal
    if experiment != "aprbs" and frame.was_given("signal"):
        raise UsageError(
            f"--signal does not apply to --experiment {experiment}.", "Leave out either of the two."
        )
    frame.refuse_inapplicable(
        ExcitationArguments,
        f"--experiment {experiment}"
        if experiment != "aprbs"
        else f"--{'signal' if frame.was_given('signal') else 'experiment'} {signal}",
    )
    output = Path(arguments.output)
    note, sidecar = output.with_suffix(".json"), output.with_suffix(".toml")
    if output in (note, sidecar):
        raise FileError(
            f"{output}: an excitation is a CSV file.",
            f"Write --output {quoted(output.with_suffix('.csv'))}.",
        )
    form = format_of(output, arguments.form)
    require_png_name(arguments.figure)
    arguments = with_rig_defaults(arguments)
    planned = planned_excitation(arguments)
    figure = Path(arguments.figure) if arguments.figure else None
    require_new(
        (output, note, *([sidecar] if planned.meta else []), *([figure] if figure else [])),
        arguments.overwrite,
    )
    return _write(output, form, figure, planned, arguments)


def _write(
    output: Path,
    form: str,
    figure: Path | None,
    planned: PlannedExcitation,
    arguments: ExcitationArguments,
) -> frame.Result:
    from pamid.simulation.excitation.writers import FORMATS, write_excitation

    period, samples = arguments.period_s, planned.about["samples"]
    follow = FORMATS[form].heed
    if form == "csv" and (why := why_not_driven(arguments.rig, output, planned.columns)):
        follow = f"send it to your rig. To simulate it, give a suitable rig with --rig: {why}."
    elif form == "csv":
        follow = (
            f"pamid simulate {rig_words(arguments.rig)} --excitation {quoted(output)} "
            f"--output {quoted(unused('rec.csv', [output]))}"
        )
    pictures = {}
    if figure is not None:
        from pamid.report.excitation_figure import ExcitedColumn, richness_picture

        pictures[figure] = richness_picture(
            [ExcitedColumn(period_s=period, **column) for column in planned.shown]
        )
        make_folder(figure.parent)
    about = write_excitation(
        output,
        planned.columns,
        period,
        {"rig": arguments.rig, **planned.about},
        form=form,
        meta=planned.meta,
        others=pictures,
    )
    seed = f", seed {arguments.seed}" if "seed" in about else ""
    first = f"{output}: {samples} samples of {', '.join(planned.columns)} at {period:g} s{seed}."
    sidecar = output.with_suffix(".toml")
    left = [f"  {sidecar} exists and is not changed. Its entries apply to this excitation as well."]
    lines = [
        first,
        *planned.sentences,
        *([f"  Picture: {figure}."] if figure else []),
        *(left if sidecar.exists() and not planned.meta else []),
    ]
    return frame.Result(about, "\n".join([*lines, f"Next: {follow}"]))
