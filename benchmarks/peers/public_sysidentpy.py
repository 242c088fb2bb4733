"""SysIdentPy on a public benchmark: polynomial NARX by FROLS, as its quick start shows it, in free
run; the number of terms by its information criterion, degree and lags by the free run over the last
fifth of the record that is fitted.

    python public_sysidentpy.py SET FOLDER [quick]
"""

import warnings
from importlib.metadata import version

import numpy as np
from public_sets import Record, Scaled, asked, judge, read_set, rmse, tell

LONGEST = 20000  # samples: FROLS holds every candidate term of every sample


def train(fit: Record, scaled: Scaled, degree: int, lag: int):
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    model = FROLS(
        order_selection=True,
        n_info_values=20,
        ylag=lag,
        xlag=lag,
        info_criteria="aic",
        estimator=LeastSquares(),
        basis_function=Polynomial(degree=degree),
    )
    u, y = fit.u[:LONGEST], fit.y[:LONGEST]
    model.fit(X=scaled.u(u)[:, None], y=scaled.y(y)[:, None])
    return model


def run(model, scaled: Scaled, u, y0):
    first = scaled.y(y0)[: model.max_lag, None]
    return scaled.back(np.asarray(model.predict(X=scaled.u(u)[:, None], y=first)).ravel())


def main() -> None:
    warnings.simplefilter("ignore")
    one, folder, quick = asked()
    fit, tests = read_set(folder, one)
    scaled = Scaled(fit)
    edge = int(0.8 * len(fit.u))
    early = Record(fit.u[:edge], fit.y[:edge], fit.period_s)
    late = Record(fit.u[edge:], fit.y[edge:], fit.period_s)
    most = 3 if quick else 5
    best = (np.inf, 1, 2)
    for degree in (1, 2, 3):
        for lag in range(2, most + 1):
            with np.errstate(all="ignore"):
                try:
                    model = train(early, scaled, degree, lag)
                    error = rmse(late.y, run(model, scaled, late.u, late.y[: one.start]), one.start)
                except (ValueError, FloatingPointError, OverflowError):
                    continue
            best = min(best, (error, degree, lag))
    _, degree, lag = best
    with np.errstate(all="ignore"):
        model = train(fit, scaled, degree, lag)
        errors = judge(one, tests, lambda u, y0: run(model, scaled, u, y0))
    terms = len(model.final_model)
    tell(
        f"SysIdentPy {version('sysidentpy')}",
        errors,
        f"FROLS, degree {degree}, {lag} lags, {terms} terms",
    )


if __name__ == "__main__":
    main()
