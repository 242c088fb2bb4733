"""`pamid train-residual`: Train a network on the residual of a fitted model."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pamid.api.options.training import TrainingArguments
from pamid.base.errors import quoted

from . import frame
from .terminal import aside, progress_line

HELP_ORDER = 60
EXAMPLE = """
pamid train-residual fitted --network elman --hidden 10 --iterations 100
pamid train-residual fitted --network anfis --inputs angle_loop_deg,velocity_loop_deg_per_s --iterations 20
pamid train-residual fitted --port joint --iterations 20
"""  # noqa: E501


@frame.command("train-residual", TrainingArguments, example=EXAMPLE)
def command(arguments: TrainingArguments) -> frame.Result:
    from pamid.api.training import most_iterations, train_residual

    with progress_line("train-residual", most_iterations(arguments)) as progress:
        result = train_residual.of(frame.reporting(arguments, progress))
    about = result.to_dict()
    text = training_text(about, result.folder)
    if result.interrupted:
        aside(text)
        raise KeyboardInterrupt
    return frame.Result(about, text, 5 if result.stuck else 0)


def training_text(about: dict[str, Any], run: Path) -> str:
    """Network, end of the training and held-out errors, as text."""
    from pamid.api.training import network_words

    t, n = about["training"], about["n_weights"]
    lines = [
        f"{network_words(about['kind'], about['sizes'])}, {n} weights: {about['target']}",
        f"inputs    {', '.join(input_['name'] for input_ in about['inputs'])}",
    ]
    lines += [f"note      {note}" for note in about["notes"]]
    way = ", plain steps as in the paper" if t.get("plain") else ""
    lines += [
        f"training  {t['iterations']} iterations{way}, {t['why']}",
        f"          MSE {t['mse']:.4g} (scaled into [-1, 1]), gradient {t['gradient']:.3g}, mu "
        f"{t['mu']:.3g}",
    ]
    if len(t["starts_mse"]) > 1:
        ends = ", ".join("diverged" if mse is None else f"{mse:.3g}" for mse in t["starts_mse"])
        lines.append(f"          MSE of every start: {ends}; number {t['start'] + 1} is kept")
    lines += [
        f"weights   {t['gamma']:.1f} of {n} determined (gamma) by all {t['samples']} samples",
        f"          {t['supported_weights']:.1f} of {n} determined by the "
        f"{t['effective_samples']:.0f} effectively independent samples",
        "seed      reproduces this network on the same kind of processor; others round differently",
    ]
    return "\n".join([*lines, "", *errors_table(about), f"Next: pamid report {quoted(run)}"])


def errors_table(about: dict[str, Any]) -> list[str]:
    """Held-out errors of the model and of the corrected ones, channel by channel."""
    at = about["enters"]["port"] if isinstance(about["enters"], dict) else "output"
    before = "with_cause" if about["on"] == "causes" else "refitted"
    columns = {"refitted": "refitted"}
    columns |= {"with_cause": "with causes"} if before == "with_cause" else {}
    columns |= {"with_output_network": "at output"} if at != "output" else {}
    columns["with_network"] = f"at {at}"
    lines = []
    for ending, title in (
        ("", "held-out mean absolute error"),
        ("_after_1_s", "... without 1 s of start-up"),
    ):
        rows = {
            channel: [errors.get(f"{name}{ending}") for name in columns]
            for channel, errors in about["mae"].items()
            if f"refitted{ending}" in errors
        }  # windows may be shorter than that
        lines += (
            [f"{title:34s}" + "".join(f" {word:>12s}" for word in columns.values())] if rows else []
        )
        lines += [
            f"{channel:34s}" + "".join(f" {'-' if e is None else f'{e:.4g}':>12s}" for e in row)
            for channel, row in rows.items()
        ]
    if at != "output":
        lines += [
            f"A correction at {at} enters the equations and changes every channel; a correction at "
            "the output changes only its channel.",
            "Its model has the parameters that were estimated together with the missing input "
            "(network.json).",
        ]
    if all(errors["with_network"] >= errors[before] for errors in about["mae"].values()):
        lines.append("This network does not reduce the held-out error.")
    return lines
