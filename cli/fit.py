"""`pamid fit`: Fit the parameters of a rig to recordings, with intervals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pamid.api.options.estimating import FitArguments
from pamid.base.errors import FileError, quoted

from . import frame
from .terminal import failed_text, progress_line

HELP_ORDER = 50
EXAMPLE = """
pamid fit rec.csv --rig one-dof --output fitted
"""


@frame.command("fit", FitArguments, example=EXAMPLE)
def command(arguments: FitArguments) -> frame.Result:
    from pamid.api.fitting import fit
    from pamid.base.json_file import read_json
    from pamid.base.run_folder import FIT_FILE
    from pamid.base.work_stages import WORK_STAGES

    stages = WORK_STAGES["fit --bootstrap" if arguments.bootstrap else "fit"]
    with progress_line("fit", stages=stages) as progress:
        model = fit.of(frame.reporting(arguments, progress))
    path = model.folder / FIT_FILE
    content = read_json(path)
    try:
        text = fit_text(content, model.folder)
    # a resumed run may have been finished by another program
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        raise FileError(
            f"{path} is damaged: entries are missing or of the wrong type "
            f"({type(error).__name__}: {error}).",
            "Repeat the run with --overwrite.",
            code="damaged",
        ) from None
    code = 5 if not model.converged else 6 if model.failed_jobs else 0
    return frame.Result(content, text, code)


def fit_text(fit: dict[str, Any], output: Path) -> str:
    """Parameters, identifiable combinations and held-out errors as a table."""
    from pamid.base.run_files import equal_periods

    lines = [f"{'parameter':34s} {'value':>12s} {'low':>12s} {'high':>12s}  word"]
    for name, p in fit["parameters"].items():
        edge = f"at its {p['at_bound']} bound" if p.get("at_bound") else ""
        word = "" if edge and p["word"] == "settled" else p["word"]
        null = p.get("null")
        within = null is not None and p["low"] <= null <= p["high"]
        nothing = f"; the interval contains {null:g} (no effect)" if within else ""
        strain = f", {p['strain']:.1f} prior sd from the data sheet" if p["strain"] > 3.0 else ""
        lines.append(
            f"{name:34s} {p['value']:12.5g} {p['low']:12.5g} {p['high']:12.5g}  "
            f"{', '.join(filter(None, (word, edge)))}{strain}{nothing}"
        )
    if not fit["parameters"]:
        lines = ["The rig has no parameters to fit; the errors are those of the unchanged model."]
    lines += tied_text(fit)
    lines += [
        f"From {fit['from']['path']}: {remark}" for remark in fit.get("from", {}).get("remarks", ())
    ]
    lines.append("")
    lines.append(
        f"{'held-out mean absolute error':34s} {'data sheet':>12s} {'refitted':>12s} "
        f"{'noise floor':>12s}"
    )
    lines += [
        f"{c:34s} {m['data_sheet']:12.4g} {m['refitted']:12.4g} {m['noise_floor']:12.4g}"
        for c, m in fit["mae"].items()
    ]
    if not fit["converged"]:
        lines.append(f"Not converged: {fit['why']}.")
    lines += [f"Note      {note}" for note in fit.get("notes") or ()]
    lines += failed_text(fit)
    follow = ["pamid train-residual", "pamid report"][
        not equal_periods(r["period_s"] for r in fit["recordings"]) :
    ]
    lines.append("Next: " + "   or   ".join(f"{command} {quoted(output)}" for command in follow))
    return "\n".join(lines)


def tied_text(fit: dict[str, Any]) -> list[str]:
    """A sentence per group of fit.json's `tied`."""
    lines = []
    for tie in fit["tied"]:
        names, known = tie["parameters"], [(n, fit["combinations"][n]) for n in tie["known"]]
        figures = [f"{n} = {c['value']:.5g} ({c['low']:.5g} .. {c['high']:.5g})" for n, c in known]
        lines.append(f"{', '.join(names[:-1])} and {names[-1]} are known only in combination:")
        lines += [f"    {figure}" for figure in figures]
    return lines
