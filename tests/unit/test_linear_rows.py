"""The rows of a fit's least squares: they add up to its cost, and their derivatives are those of
differences."""

from dataclasses import replace

import numpy as np
import pytest
from small_cart import cart_evidence, record_cart

from pamid.estimation.grey_box import fit_model
from pamid.estimation.linear_rows import LinearRows, linear_rows
from pamid.estimation.problem import Fit

EVERYTHING = 10**9


@pytest.fixture(scope="module")
def fitted(tmp_path_factory) -> Fit:
    return fit_model(cart_evidence(record_cart(tmp_path_factory.mktemp("cart")))).fit


def rows_of(f: Fit, most: int = EVERYTHING) -> LinearRows:
    return linear_rows(f, most)


def test_they_add_up_to_the_cost_of_the_fit(fitted):
    away = rows_of(fitted).away
    assert away @ away == pytest.approx(fitted.cost, rel=1e-9)


def test_derivatives_are_those_of_differences(fitted):
    found, scale = rows_of(fitted), fitted.problem.scale

    def at(ds, dx):
        p, starts = fitted.p.copy(), [x.copy() for x in fitted.starts]
        free = list(fitted.problem.free)
        p[free] = scale.outside(scale.inside(p[free]) + ds)
        starts[0][1, 0] += dx
        return linear_rows(replace(fitted, p=p, starts=tuple(starts)), EVERYTHING).away

    def slope(f, h):
        return (f(h) - f(-h)) / (2.0 * h)

    n = fitted.starts[0].shape[1]
    for by, difference in (
        (found.by_parameters.sum(axis=1), slope(lambda h: at(h, 0.0), 1e-4)),
        (found.by_starts[:, n], slope(lambda h: at(0.0, h), 1e-5)),
    ):
        assert np.linalg.norm(by) > 0.0
        assert np.linalg.norm(by - difference) < 1e-4 * np.linalg.norm(by)
