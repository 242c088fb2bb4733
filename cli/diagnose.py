"""`pamid diagnose`: Find where the gap lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pamid.api.options.estimating import DiagnosisArguments
from pamid.api.options.record import FilePath, figure_option, overwrite_option
from pamid.base.errors import quoted

from . import frame
from .fail_if import Condition, exit_code_of, fail_if_option
from .figures import require_png, write_figure
from .job import failed_text, finished_result, parameter_values
from .terminal import progress_line

HELP_ORDER = 80
_SETTLED = 0.95
_HOLD_HINT = (
    "(TOML next to the recording: [known] fixes a parameter, [free] releases a fixed parameter)"
)
EXAMPLE = """
pamid diagnose rec.csv --rig one-dof --output run --jobs 2
"""


@dataclass(frozen=True, kw_only=True)
class Arguments(DiagnosisArguments):
    __doc__ = DiagnosisArguments.__doc__

    figure: FilePath | None = figure_option(
        "the rig as a block diagram, with the shares of the gap and the identified effects; below "
        "it the residual over the contribution of the leading candidates"
    )
    conditions: Sequence[Condition] = fail_if_option(
        "'remainder > 0.3' (share of the gap that no cause explains, 0 without a structural gap), "
        "'probability > 0.9' (of the leading cause), or the held-out error of a channel with the "
        "causes, as 'angle_deg > 0.1'"
    )
    overwrite: bool = overwrite_option("Replace an earlier run in that folder, and the figure.")


@frame.command("diagnose", Arguments, example=EXAMPLE)
def command(arguments: Arguments) -> frame.Result:
    from pamid.api.diagnosing import diagnose

    figure = arguments.figure
    require_png(figure, arguments.overwrite or arguments.resume)
    with progress_line("diagnose") as progress:
        run = diagnose.of(frame.reporting(arguments, progress))
    content, text = finished_result(
        run.folder / "diagnosis.json", lambda content: diagnosis_text(content, run.folder)
    )
    if figure is not None:
        text, line, follow = text.rpartition("\nNext: ")  # what to do next stays the last line
        text += f"\n{write_figure(figure, run.overview_png())}{line}{follow}"
    code = exit_code_of(arguments.conditions, _figures(content), 6 if run.failed_jobs else 0)
    return frame.Result(content, text, code)


def _figures(diagnosis: dict[str, Any]) -> dict[str, float | None]:
    """Figures for --fail-if: the share that remains, the probability of the leading cause, and
    the error of every channel with the causes."""
    causes, rest = diagnosis["causes"], diagnosis["remainder"]
    gap = diagnosis["verdict"] != "no-structural-gap"
    return {
        "remainder": rest["share"] if gap and rest else 0.0,
        "probability": causes[0]["probability"] if causes else 0.0,
        **{channel: reach["mae_with_cause"] for channel, reach in diagnosis["how_far"].items()},
    }


def diagnosis_text(diagnosis: dict[str, Any], output: Path) -> str:
    """The three answers, the ranking and the next command, as text.

    If the recordings do not depend on the model, the text states only that and the errors.
    """
    if diagnosis.get("remark"):
        return "\n".join(
            [
                diagnosis["sentence"],
                "",
                *_how_far(diagnosis),
                *failed_text(diagnosis),
                f"Next: pamid report {quoted(output)}",
            ]
        )
    lines = [diagnosis["sentence"], "", *_where(diagnosis["where"]), *_which(diagnosis["causes"])]
    lines += _refitted(diagnosis["parameters"])
    lines += _free_forms(diagnosis.get("unknown") or {})
    lines += [*_left(diagnosis), *_how_far(diagnosis), *_scoring(diagnosis)]
    lines += _ranking(diagnosis)
    lines += _further(diagnosis, output)
    lines += [f"Note      {note}" for note in diagnosis.get("notes") or []]
    lines += failed_text(diagnosis)
    lines.append(f"Next: pamid report {quoted(output)}")
    return "\n".join(lines)


def _where(where: dict[str, Any]) -> list[str]:
    """Lines about the ports, the regimes in which the gap shows, and a useful further sensor."""
    from pamid.base.share_words import plain_number

    shares = [
        f"{p['port']} {100 * p['share']:.0f} %" for p in where["ports"][:4] if p["share"] >= 0.005
    ]
    lines = ["Where     " + ", ".join(shares)]
    lines += [
        f"          {100 * r['share_of_gap']:.0f} % of the gap in {100 * r['share_of_time']:.0f} % "
        f"of the time: {r['signal']} {plain_number(r['low'])} .. {plain_number(r['high'])} "
        f"{r['unit']}".rstrip()
        for r in where["regimes"][:2]
    ]
    # a further sensor separates ports, which is pointless if a port has nearly all of the gap
    if where.get("sensors") and max((p["share"] for p in where["ports"]), default=0.0) < _SETTLED:
        split = " or ".join(", ".join(g) for g in where["sensors"][0]["splits"][:2])
        lines.append(f"          measuring {where['sensors'][0]['sensor']} would separate {split}")
    return lines


def _which(causes: list[dict[str, Any]]) -> list[str]:
    """A line per cause with its parameters and the share of the gap that it removes."""
    lines = []
    for i, c in enumerate(causes):
        values = parameter_values(c["parameters"])
        lines.append(
            ("Which     " if i == 0 else "          ")
            + f"{c['effect']} ({c['family']}), {_removed(c['removes'])}: {values}"
        )
    return lines


def _refitted(parameters: dict[str, Any]) -> list[str]:
    """Parameters of the chosen model that left the data sheet, with intervals."""
    from pamid.schemas.estimates import Estimate
    from pamid.schemas.model import read
    from pamid.verdict.refitted_parameters import refitted_parameters

    texts = refitted_parameters({k: read(Estimate, v) for k, v in parameters.items()}).texts()
    texts = [*texts, _HOLD_HINT] if texts else []
    return [("Refitted  " if i == 0 else "          ") + text for i, text in enumerate(texts)]


def _removed(share: dict[str, float]) -> str:
    from pamid.base.share_words import percent_text, percents_text

    interval = percents_text(share["low"], share["high"])
    return f"{percent_text(share['share'])} of the gap ({interval})"


def _left(diagnosis: dict[str, Any]) -> list[str]:
    """Lines about the remaining error: its size, place and description."""
    from pamid.schemas.diagnosis_file import Remainder
    from pamid.schemas.model import read
    from pamid.verdict.verdict_words import advice_of, amount_of, size_of, weight_of

    if not diagnosis["remainder"]:
        return []
    rest = read(Remainder, diagnosis["remainder"])
    size = size_of(rest, with_causes=bool(diagnosis["causes"]))
    lines = [f"Left      {size}:" if size else "Left", f"          {weight_of(rest)}"]
    if diagnosis["causes"] and (advice := advice_of(rest)):
        lines.append(f"          {advice}")
    formula = rest.formula or (diagnosis["unknown"] or {}).get("formula", "")
    if rest.port:
        amount = amount_of(rest)
        lines.append(f"          at the {rest.port} port{f', {amount}' if amount else ''}")
        condition = ", with the parameters estimated again together with it"
        lines += [f"          {formula}{condition}"] if formula else []
    return lines


def _free_forms(unknown: dict[str, Any]) -> list[str]:
    """Families whose nonparametric curves fit the unnamed effect, with a few points of each."""
    lines = []
    for i, form in enumerate(unknown.get("free_forms") or []):
        curve = form["curve"]
        points = list(zip(curve["x"], curve["y"], strict=True))
        shown = ", ".join(f"{y:.3g} at {x:.3g}" for x, y in points[:: max(1, len(points) // 6)])
        lines += [
            ("Family    " if i == 0 else "       or ")
            + f"{form['family']} at the {form['port']}, {form['known_by']}: removes "
            f"{100 * form['shrinkage']:.0f} % ({100 * form['low']:.0f} .. "
            f"{100 * form['high']:.0f})",
            f"          {curve['shown']} [{curve['unit'] or '-'}] over {curve['signal']} "
            f"[{curve['signal_unit'] or '-'}]: {shown}",
        ]
    return lines


def _ranking(diagnosis: dict[str, Any]) -> list[str]:
    """Explanation of the figures, then the candidates in the order of the ranking."""
    from pamid.base.share_words import percent_text, percents_text
    from pamid.verdict.verdict_words import chance_figure

    rows = [r for r in diagnosis["ranking"] if r["removes"]][:8]
    return [
        "",
        "Share of the gap that each candidate removes by itself (95 % interval, paired), and its",
        "distance from the first in standard errors. P: how often an effect of that family was",
        "present on virtual machines with similar figures.",
        f"{'effect':36s} {'family':20s} {'share':>6s} {'95 %':>12s} {'behind':>7s} {'P':>6s}",
        *(
            f"{r['effect']:36s} {r['family']:20s} {percent_text(r['removes']['share']):>6s} "
            f"{percents_text(r['removes']['low'], r['removes']['high']):>12s} "
            f"{r['behind']:7.1f} {chance_figure(r['probability']):>6s}"
            for r in rows
        ),
    ]


def _further(diagnosis: dict[str, Any], output: Path) -> list[str]:
    """Lines about the next experiment."""
    from pamid.base.share_words import minutes_text

    lines = [""]
    n = diagnosis["next_experiment"]
    if n:
        lines.append(
            f"Measure next: {n['name']}, {minutes_text(n['minutes'])} on the rig, separates "
            f"{' and '.join(n['separates'])}; ready to run: "
            + " and ".join(
                quoted(output / name) for name in n.get("excitations") or [n["excitation"]]
            )
        )
        lines += [f"          {text}" for text in n.get("cautions", ())]
    return lines


def _scoring(diagnosis: dict[str, Any]) -> list[str]:
    """Lines about the horizon and windows of the errors, and the prediction for a new recording."""
    from pamid.base.share_words import percent_text, percents_text, plain_number

    horizon = (
        f"predicted over up to {plain_number(diagnosis['horizon_s'])} s from an estimated state"
    )
    lines = [f"          {horizon}"]
    if diagnosis["causes"]:
        lines.append("          each half of the windows scored with the model of the other half")
    if forecast := diagnosis.get("forecast"):
        interval = percents_text(forecast["low"], forecast["high"])
        lines.append(
            f"          on a new recording {percent_text(forecast['share'])} of the error would be "
            f"removed (95 % interval {interval})"
        )
    return lines


def _how_far(diagnosis: dict[str, Any]) -> list[str]:
    """Held-out errors of every channel; those over single windows where the horizon is longer."""
    lines: list[str] = []
    for c, h in diagnosis["how_far"].items():
        short = h.get("mae_refitted_short")
        over_windows = "" if short is None else f" ({short:.4g} over single windows)"
        cause = f", {h['mae_with_cause']:.4g} with the cause" if diagnosis["causes"] else ""
        lines.append(
            ("          " if lines else "How far   ")
            + f"{c}: {h['mae_data_sheet']:.4g} data sheet, {h['mae_refitted']:.4g} refitted"
            f"{over_windows}{cause} (noise floor {h['noise_floor']:.4g})"
        )
    return lines
