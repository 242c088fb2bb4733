"""The missing term where no effect of the catalogue explains the gap: its file entry and its
description."""

from __future__ import annotations

from pamid.report import formatting
from pamid.report.formatting import percent
from pamid.report.formula import formula_text
from pamid.schemas.diagnosis_file import DiagnosisFile, Unknown


def missing_term(diagnosis: DiagnosisFile | None) -> Unknown | None:
    """Description of the missing term: the whole gap, or the remainder after the causes."""
    rest = diagnosis.remainder if diagnosis is not None else None
    if diagnosis is None or diagnosis.unknown is not None:
        return diagnosis.unknown if diagnosis is not None else None
    if rest is None or not (rest.real and diagnosis.causes):
        return None
    return Unknown(
        port=rest.port,
        formula=rest.formula,
        variables=(),
        inclusion=None,
        described=None,
        dissipative=None,
        parity="none",
        memory=None,
        free_forms=(),
    )


def nature_texts(unknown: Unknown) -> list[str]:
    """Odd or even, memory, dissipative: in words."""
    against = formatting.port_label(
        "velocity" if "velocity" in unknown.variables else (unknown.variables or ("signal",))[0]
    )
    parity = {
        "odd": f"It changes its sign with the {against}.",
        "even": f"It is alike on both sides of the {against}.",
        "mixed": f"It is neither odd nor even in the {against}.",
    }
    memory = {
        True: "Most of it is no function of these signals at the same instant: it depends on the "
        "past, or on something that is not among them.",
        False: "It follows these signals without memory.",
    }
    energy = {
        True: "It takes energy out, as friction does.",
        False: "On the whole it takes no energy out beyond what the refitted model takes.",
    }
    return [
        parity.get(unknown.parity, "") if unknown.variables else "",
        memory[unknown.memory] if unknown.memory is not None else "",
        energy[unknown.dissipative] if unknown.dissipative is not None else "",
    ]


def formula_texts(unknown: Unknown) -> list[str]:
    """The formula, how sure its terms are and how much it covers."""
    if not unknown.formula:
        return ["No function of the signals at this port describes it."]
    of = (
        f" of {formatting.join(map(formatting.port_label, unknown.variables))}"
        if unknown.variables
        else ""
    )
    at = f" at the {formatting.port_label(unknown.port)} port" if unknown.port else ""
    texts = [
        f"The missing term{at} is described best, as a function{of}, by "
        f"{formula_text(formatting.clean(unknown.formula))}, with the parameters estimated anew "
        "beside it."
    ]
    if unknown.inclusion is not None:
        texts.append(
            f"Each of its terms came up in at least {percent(unknown.inclusion)} of the fits to "
            "resampled data."
        )
    if unknown.described is not None:
        texts.append(
            f"The formula covers {percent(unknown.described)} of its variance; it is a "
            "description, not a cause."
        )
    return texts
