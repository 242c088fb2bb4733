"""ANFIS: first-order Takagi-Sugeno rules on a grid of membership sets, a static network linear in
its consequents.

Equations (Jang 1993, IEEE Trans. Systems, Man, and Cybernetics 23(3)), for inputs x_k scaled into
[-1, 1]
    layer 1  membership, per input k and set i: exp(-t^2/2) with t = (x_k - centre)/width
    layer 2  firing: product of a membership per input, for every combination of sets
    layer 3  firing normalised: all rules sum to 1
    layer 4  rule: firing (bias + sum_k slope_k (x_k - grid_k)/spacing)
    layer 5  output y: sum over rules
A product over a full grid normalises input by input: the share of a rule is the product of its
sets' shares, each a softmax of log memberships, which never comes to 0/0. Inputs beyond [-1, 1]
count as its edge.

Weights are a flat vector. Premises first: for input k, for set i: centre, log width, as deviations
from the untouched grid. Then the consequents: for rule r (the last input's set running fastest)
bias, slope_1 .. slope_m. All zero is the untouched grid with output zero.

Deviations are bent by limit tanh(deviation/limit): a centre stays within 0.45 spacings of its
place, so sets keep their order; widths stay within a factor of 4.5, so none collapses. Near zero
they are the weight. The place a rule's slope is counted from does not move with its centre: the
output stays linear in the consequents with features that are well conditioned, and the derivative
by a centre goes through the firing alone.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from itertools import product
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pamid.base.arrays import Array
from pamid.base.errors import DataError, UsageError, nearest
from pamid.engine.symbolic.memory_cells import Cell
from pamid.engine.symbolic.vocabulary import ZERO, Expr, clip, exp
from pamid.networks.bayes import Evidence
from pamid.networks.network import CHUNK, Network, Records, Rows
from pamid.networks.onnx_nodes import OnnxNodes, affine
from pamid.networks.training_problem import TrainingOptions, TrainingProblem

SHAPES = ("gaussian",)
PER_SET = 2  # weights of a set
LIMITS = (0.45, 1.5)  # of centre (spacings), log width
# Spacings. The customary 0.42, neighbours crossing at half height, starts 3 to 14 times further
# off: error of the first least squares on four smooth functions of two inputs, 5 x 5 rules.
WIDTH_IN_SPACINGS = 0.6
MOST_CONSEQUENTS = 5000
MOST_RULES, MOST_SETS = 64, 5  # default without a number of sets
START = 0.05  # standard deviation of a random start's premises
CONSEQUENT_RIDGE = 1e-6  # of a start's least squares, per sample


class Sets(NamedTuple):
    """Membership sets, each (inputs, sets): place and width in scaled units.

    `bend` (inputs, sets, 2) is the derivative of centre/spacing and log width by its weight.
    """

    centre: Array
    width: Array
    bend: Array


@dataclass(frozen=True)
class Anfis(Network):
    """An ANFIS' sizes; weights are passed to every verb as a flat float64 vector (layout:
    module).

    `inputs` m, `sets` membership sets per input, `shape` that of the sets, which is
    stored with them. sets^m rules.
    """

    kind: ClassVar[str] = "anfis"
    size_options: ClassVar[dict[str, tuple[int, int, str, str]]] = {
        "sets": (
            2,
            20,
            "Membership sets on every input",
            "the most, up to 5, that make no more than 64 rules",
        )
    }
    inputs: int = 2
    sets: int = 5
    shape: str = "gaussian"

    def __post_init__(self) -> None:
        self.require_sizes(inputs=1, sets=2)
        if self.shape not in SHAPES:
            hint = nearest(str(self.shape), SHAPES) or f"Shapes: {', '.join(SHAPES)}."
            raise DataError(f"Anfis: unknown shape {self.shape!r}.", hint)
        if (
            # On logarithms: the power itself may be an integer of thousands of digits.
            self.inputs * math.log(self.sets) + math.log(self.inputs + 1)
            > math.log(MOST_CONSEQUENTS) + 1e-9
        ):
            raise DataError(
                f"Anfis: {self.sets} sets on each of {self.inputs} inputs make "
                f"{self.sets}^{self.inputs} rules of "
                f"{self.inputs + 1} consequents, more than {MOST_CONSEQUENTS}.",
                "Use fewer inputs or sets: the number of rules is sets to the power of inputs.",
            )

    @classmethod
    def sized(
        cls, inputs: int, period_s: float, samples: int | None = None, **sizes: int
    ) -> Network:
        if sizes:
            return cls(inputs, sizes["sets"])
        if 2**inputs > MOST_RULES:
            raise UsageError(
                f"An ANFIS of {inputs} inputs has at least {2**inputs} rules, more than "
                f"{MOST_RULES}.",
                "Name fewer with --inputs, or use --sets 2.",
            )
        # A grid that is too coarse only costs accuracy. A grid that is too fine has rules without
        # data.
        grids = (sets for sets in range(2, MOST_SETS + 1) if sets**inputs <= MOST_RULES)
        return cls(inputs, max(grids))

    def words(self) -> str:
        return f"anfis {'x'.join([str(self.sets)] * self.inputs)} = {self.rules} rules"

    @property
    def premises(self) -> int:
        return self.inputs * self.sets * PER_SET

    @property
    def rules(self) -> int:
        return int(self.sets**self.inputs)

    @property
    def n_weights(self) -> int:
        return self.premises + self.rules * (self.inputs + 1)

    @property
    def linear(self) -> slice:
        """The consequents: simulate(w, u) == features(w, u) @ w[linear]."""
        return slice(self.premises, self.n_weights)

    @property
    def spacing(self) -> float:
        return 2.0 / (self.sets - 1)

    def initial(self, seed: int) -> Array:
        """Random start without data: premises a little off the grid, consequents zero."""
        weights = np.zeros(self.n_weights)
        # The grid itself would be a start as well, but the same for every seed.
        weights[: self.premises] = START * np.random.default_rng(seed).standard_normal(
            self.premises
        )
        return weights

    def start(self, records: Records, washout: int, seed: int) -> Array:
        """The same premises with least-squares consequents: the first guess of alpha needs weights
        to go by."""
        problem = TrainingProblem(self, tuple(records), TrainingOptions(washout=washout))
        return problem.projected(
            self.initial(seed), Evidence(0.0, CONSEQUENT_RIDGE * problem.samples, 1.0)
        )[0]

    def membership(self, weights: ArrayLike) -> Sets:
        """The membership sets that the weights stand for; DataError when there are not `n_weights`
        of them."""
        deviation = self.flat(weights)[: self.premises].reshape(self.inputs, self.sets, PER_SET)
        limits = np.array(LIMITS)
        # A smooth limit needs no bounds in the optimiser, and its slope at zero is 1.
        bent = np.tanh(deviation / limits)
        moved = limits * bent
        return Sets(
            centre=self._grid + self.spacing * moved[..., 0],
            width=self.spacing * WIDTH_IN_SPACINGS * np.exp(moved[..., 1]),
            bend=1.0 - bent * bent,
        )

    def simulate(self, weights: ArrayLike, inputs: ArrayLike) -> Array:
        """Output y (N,) for inputs (N, m); each sample by itself."""
        consequents, y = self.consequents(weights), np.empty(len(np.asarray(inputs)))
        with np.errstate(all="ignore"):
            for rows, x, _, firing in self._fired(weights, inputs):
                y[rows] = np.sum(firing * self._rule_outputs(consequents, x), axis=0)
        return y

    def features(self, weights: ArrayLike, inputs: ArrayLike) -> Array:
        """dy/d(consequents) (N, rules (m + 1)); depends on the premises only."""
        columns = np.empty((self.rules, self.inputs + 1, len(np.asarray(inputs))))
        for rows, x, _, firing in self._fired(weights, inputs):
            self._fill(columns[:, :, rows], firing, x)
        return columns.reshape(-1, columns.shape[2]).T

    def expression(self, weights: ArrayLike, inputs: Sequence[Expr]) -> Expr:
        """The output as an equation of the inputs, to be held within [-1, 1]: no sum of memberships
        vanishes there."""
        sets, rows = self.membership(weights), iter(self.consequents(weights).tolist())
        members = [
            [
                exp(-0.5 * ((x - c) * (1.0 / w)) ** 2)
                for c, w in zip(sets.centre[k], sets.width[k], strict=True)
            ]
            for k, x in enumerate(inputs)
        ]
        places = [[(x - g) * (1.0 / self.spacing) for g in self._grid.tolist()] for x in inputs]

        def fired(k: int, rule: tuple[int, ...]) -> Expr:
            """Sum over the sets of inputs k, k + 1, .. with those of the inputs before them
            given."""
            if k < self.inputs:
                return sum(
                    (members[k][i] * fired(k + 1, (*rule, i)) for i in range(self.sets)), start=ZERO
                )
            bias, *slopes = next(rows)  # rules come in the order of the weights
            return sum(
                (s * places[j][i] for j, (s, i) in enumerate(zip(slopes, rule, strict=True))),
                start=ZERO + bias,
            )

        return fired(0, ()) / reduce(lambda a, b: a * b, (sum(m, start=ZERO) for m in members))

    def equations(
        self, weights: ArrayLike, inputs: Sequence[Expr], name: str
    ) -> tuple[Expr, tuple[Cell, ...]]:
        """Nothing is remembered."""
        return self.expression(weights, [clip(x, -1.0, 1.0) for x in inputs]), ()

    def onnx_nodes(
        self, g: OnnxNodes, weights: Array, given: str, memory: str, first: str
    ) -> tuple[str, str]:
        sets = self.membership(weights)
        inside = g.add("Max", g.add("Min", given, g.number(1.0)), g.number(-1.0))
        away = g.add("Sub", g.add("Reshape", inside, g.index(-1, 1)), g.array(sets.centre))
        scaled = g.add("Mul", away, g.array(1.0 / sets.width))
        squares = g.add("Mul", scaled, scaled)
        members = g.add("Exp", g.add("Mul", squares, g.number(-0.5)))
        shares = g.add("Div", members, g.add("ReduceSum", members, g.index(1), keepdims=1))
        each = g.parts(g.add("Reshape", shares, g.index(-1)), [self.sets] * self.inputs)

        def crossed(a: str, b: str) -> str:
            column = g.add("Reshape", a, g.index(-1, 1))
            return g.add("Reshape", g.add("Mul", column, b), g.index(-1))

        # Rows times columns, input by input: the set of the last input then runs fastest, as in the
        # weights.
        firing = reduce(crossed, each)
        slopes, constants = self.planes(self.consequents(weights))
        rules = affine(g, slopes, inside, g.array(constants))
        return g.add("ReduceSum", g.add("Mul", firing, rules), g.index(0), keepdims=1), memory

    def sweep(self, weights: ArrayLike, inputs: ArrayLike) -> Iterator[Rows]:
        """(first sample, y (n,), dy/dw (n, n_weights)) chunk by chunk, exact."""
        consequents = self.consequents(weights)
        for rows, x, known, firing in self._fired(weights, inputs):
            n = x.shape[1]
            with np.errstate(all="ignore"):
                parts = firing * self._rule_outputs(consequents, x)
                y = parts.sum(axis=0)
                jacobian = np.empty((self.n_weights, n))
                premise = jacobian[: self.premises].reshape(self.inputs, self.sets, PER_SET, n)
                grid = parts.reshape(*(self.sets,) * self.inputs, n)
                for k, (shares, slopes) in enumerate(known):
                    # Sums over the other axes of the grid replace a loop over all rules for every
                    # set.
                    others = tuple(j for j in range(self.inputs) if j != k)
                    # y = sum over rules of share x plane, the shares a softmax: dy/d log m_i is
                    # the contribution of the rules with set i, less their share of y
                    by_log = grid.sum(axis=others) - shares * y  # dy/d log membership, (sets, n)
                    np.multiply(slopes, by_log[:, None, :], out=premise[k])
                self._fill(
                    jacobian[self.premises :].reshape(self.rules, self.inputs + 1, n), firing, x
                )
            yield rows.start, y, jacobian.T

    def _fired(
        self, weights: ArrayLike, inputs: ArrayLike
    ) -> Iterator[tuple[slice, Array, list[tuple[Array, Array]], Array]]:
        """Chunk by chunk its samples, their inputs (m, n), the memberships of each input as of
        `_shares`, and the firing of the rules (rules, n), the last input's set running fastest."""
        sets, u = self.membership(weights), self.table(inputs)
        for start in range(0, len(u), CHUNK):
            # Samples run along the last axis, so that every operation on a set is a contiguous
            # vector.
            x = np.ascontiguousarray(u[start : start + CHUNK].T)
            # wild trial weights may overflow: the caller judges the outcome
            with np.errstate(all="ignore"):
                known = [self._shares(sets, k, x[k]) for k in range(self.inputs)]
                firing = reduce(
                    lambda a, b: (a[:, None, :] * b).reshape(-1, b.shape[1]),
                    [shares for shares, _ in known],
                )
            yield slice(start, start + x.shape[1]), x, known, firing

    def _shares(self, sets: Sets, k: int, x: Array) -> tuple[Array, Array]:
        """Normalised memberships of input k (sets, n), d log membership/d weight (sets, 2, n)."""
        width = sets.width[k, :, None]
        t = (x - sets.centre[k, :, None]) / width
        squared = t * t
        log_member = -0.5 * squared
        slopes = np.stack([self.spacing * (t / width), squared], axis=1)
        slopes *= sets.bend[k, :, :, None]
        # the softmax does not change with a constant: the largest is made exp(0)
        shares = np.exp(log_member - log_member.max(axis=0))
        return shares / shares.sum(axis=0), slopes

    def _fill(self, rows: Array, firing: Array, x: Array) -> None:
        """Write dy/d(consequents) for x (m, n) into rows (rules, m + 1, n): firing, and firing
        times each place."""
        rows[:, 0] = firing
        for k in range(self.inputs):
            away = (x[k] - self._grid[:, None]) / self.spacing
            np.multiply(firing, away[self._rule_sets[:, k]], out=rows[:, k + 1])

    def planes(self, consequents: Array) -> tuple[Array, Array]:
        """Every rule's linear function of the inputs: slopes (rules, m) and constants (rules,),
        from its consequents (rules, m + 1)."""
        slopes = consequents[:, 1:] / self.spacing
        return slopes, consequents[:, 0] - np.sum(slopes * self._grid[self._rule_sets], axis=1)

    def _rule_outputs(self, consequents: Array, x: Array) -> Array:
        """Every rule's linear function (rules, n) of x (m, n)."""
        slopes, constant = self.planes(consequents)
        return slopes @ x + constant[:, None]

    @cached_property
    def _grid(self) -> Array:
        return np.linspace(-1.0, 1.0, self.sets)

    @cached_property
    def _rule_sets(self) -> NDArray[np.intp]:
        """The set of every input in each rule (rules, m)."""
        return np.array(list(product(range(self.sets), repeat=self.inputs)))

    def consequents(self, weights: ArrayLike) -> Array:
        """Consequents (rules, m + 1), in the order of the module."""
        return self.flat(weights)[self.linear].reshape(self.rules, self.inputs + 1)

    def table(self, inputs: ArrayLike) -> Array:
        """Held within [-1, 1]: the outermost rules' planes would lead far away from all data."""
        return np.clip(super().table(inputs), -1.0, 1.0)
