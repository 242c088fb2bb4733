"""Ranges for domain randomisation, as YAML.

They are the nominal values of the fitted parameters, their standard deviations and their
covariance.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import FileError
from pamid.base.result_file import need_result
from pamid.base.run_folder import DIAGNOSIS_FILE, FIT_FILE
from pamid.base.schemas.diagnosis_file import DiagnosisFile
from pamid.base.schemas.estimates import Interval
from pamid.base.schemas.fit_file import FitFile
from pamid.base.units import size_to_si, split_column
from pamid.estimation.intervals import NORMAL_95
from pamid.estimation.quantities import declared
from pamid.networks.correction.identified_model import Identified
from pamid.networks.correction.residual_data import REFIT_REMEDY
from pamid.rigs.simulators.body_inertia import shapes_of
from pamid.rigs.simulators.mechanism import Mechanism

DIFFERENCE = 1e-6  # of a parameter's size, for derivatives of combinations


def randomisation_yaml(model: Identified) -> bytes:
    """All fitted parameters, SI, with standard deviations and covariance.

    The standard deviation follows from the 95 % interval. The covariance is linear about the
    nominal values. FileError for a model that was not read from a run, or whose run has no
    posterior.
    """
    if model.folder is None:
        raise FileError("The model was not read from a run, so it has no intervals.")
    fit = need_result(model.folder / FIT_FILE, FitFile, also=("posterior", "cause", "rivals"))
    saved = fit.cause if model.effects else None
    if model.rivals and fit.rivals:
        saved = fit.rivals[model.chosen].model
    posterior = saved.posterior if saved else fit.posterior
    if posterior is None:
        raise FileError("The run has no posterior of this model.", REFIT_REMEDY, code="missing")
    values = dict(zip(model.assembly.keys, model.values.tolist(), strict=True))
    rows = np.zeros((len(posterior.keys), len(posterior.keys)))
    rows[np.tril_indices(len(rows))] = [x for row in posterior.covariance for x in row]
    scale = np.array(posterior.spread) * [
        values[key] if log else 1.0 for key, log in zip(posterior.keys, posterior.log, strict=True)
    ]
    covariance = (rows + np.tril(rows, -1).T) * np.outer(scale, scale)
    deviation = np.sqrt(np.diag(covariance))
    stated = dict(_stated_deviations(model, fit, model.folder))
    # correlations from the posterior, standard deviations from the intervals
    wanted = np.array([stated.get(k, s) for k, s in zip(posterior.keys, deviation, strict=True)])
    ratio = wanted / np.maximum(deviation, 1e-300)
    covariance *= np.outer(ratio, ratio)
    places = _places(model)
    rows, nominal, units = _reported(model, posterior.keys)
    covariance = rows @ covariance @ rows.T
    wanted = np.sqrt(np.diag(covariance))
    lines = ["# Nominal values and standard deviations in SI units; the covariance is in the order",
             "# of the parameters.", "parameters:"]  # fmt: skip
    for key, size in zip(nominal, wanted, strict=True):
        lines.append(f"  - name: {json.dumps(key)}")
        lines += [f"    {k}: {json.dumps(v)}" for k, v in places.get(key, {}).items()]
        lines.append(f"    unit: {json.dumps(units[key])}")
        lines.append(f"    nominal: {_number(nominal[key])}")
        lines.append(f"    standard_deviation: {_number(float(size))}")
    lines.append("covariance:")
    lines += [f"  - [{', '.join(_number(float(x)) for x in row)}]" for row in covariance]
    return ("\n".join(lines) + "\n").encode()


def _reported(
    model: Identified, keys: Sequence[str]
) -> tuple[Array, dict[str, float], dict[str, str]]:
    """Derivatives of the reported quantities by the parameters of these keys.

    Also their values and units by name, SI. The reported quantities are the parameters, with the
    rig's combinations in place of inner ones.
    """
    a, p, places = model.assembly, model.values, [model.assembly.keys[k] for k in keys]
    inner = [k for k, i in enumerate(places) if a.parameters[i].inner]
    outer = [k for k in range(len(keys)) if k not in inner]
    rows = list(np.eye(len(keys))[outer])
    values = {keys[k]: float(p[places[k]]) for k in outer}
    units = {keys[k]: a.parameters[places[k]].unit for k in outer}
    for name, measure in declared(a).items() if inner else ():
        row = np.zeros(len(keys))
        for k, i in enumerate(places):
            step = np.zeros(len(p))
            step[i] = DIFFERENCE * max(abs(float(p[i])), a.parameters[i].spread)
            row[k] = (measure(p + step) - measure(p - step)) / (2.0 * step[i])
        if row[inner].any():
            stem, unit = split_column(name)
            factor = size_to_si(1.0, unit)
            rows.append(factor * row)
            values[stem], units[stem] = factor * measure(p), unit
    return np.array(rows), values, units


def _number(value: float) -> str:
    """A number in the form of YAML 1.1: with a point, also before an exponent."""
    text = f"{value:.9g}"
    mantissa, mark, exponent = text.partition("e")
    return f"{mantissa if '.' in mantissa else mantissa + '.0'}{mark}{exponent}"


def _stated_deviations(
    model: Identified, fit: FitFile, folder: Path
) -> Iterator[tuple[str, float]]:
    """(key, standard deviation, SI) of the parameters with an interval."""
    path = folder / DIAGNOSIS_FILE
    intervals: dict[str, Interval] = dict(fit.parameters)
    if path.exists():
        diagnosis = need_result(path, DiagnosisFile)
        named = {a.label for a in model.effects}
        # intervals of the rig's parameters are those of the fit with the causes
        intervals = dict(diagnosis.parameters) if not model.rivals else {}
        for candidate in diagnosis.ranking if model.rivals else ():
            intervals |= _of_effect(candidate.effect, candidate.parameters, named)
        for cause in diagnosis.causes:
            intervals |= _of_effect(cause.effect, cause.parameters, named)
    for b in model.assembly.parameters:
        interval = intervals.get(b.full_name)
        if interval is None or interval.low is None or interval.high is None:
            continue
        size = (interval.high - interval.low) * b.factor / (2.0 * NORMAL_95)
        if np.isfinite(size) and size > 0.0:
            yield b.key, float(size)


def _of_effect(
    label: str, parameters: Mapping[str, Interval], named: Collection[str]
) -> dict[str, Interval]:
    """Intervals of an effect by full name, if the model has it."""
    return {f"{label}:{k}": value for k, value in parameters.items()} if label in named else {}


def _places(model: Identified) -> Mapping[str, Mapping[str, str]]:
    """Place of a parameter in the model file, or its effect."""
    places = {
        b.key: {"effect": b.owner} for b in model.assembly.parameters if b.owner and not b.nuisance
    }
    mechanism = getattr(model.assembly.rig, "mechanism", None)
    if isinstance(mechanism, Mechanism):
        for p in mechanism.parameters:
            places[p.parameter.name] = {
                "element": p.element, "of": p.of, "attribute": p.attribute,
            }  # fmt: skip
        for shape in shapes_of(mechanism):
            for name in (*shape.centre_names, *shape.inertia_names):
                attribute = name.removeprefix(f"{shape.body.name}_")
                places[name] = {"element": "body", "of": shape.body.name, "attribute": attribute}
    return places
