"""Levenberg-Marquardt with JAX in float64, the Jacobian in one of three forms.

    python jax_lm.py RECORD outside|inside|by-hand

outside: jacfwd through jax.lax.scan, input part of the layer as one product before the scan, output
after it. inside:  jacfwd through a scan that does everything, four samples per turn: far less is
stored. by-hand: no automatic differentiation: the carried sensitivities written out, J'J summed
over chunks. Compilation is not counted.
"""

import sys
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from measuring import HIDDEN, INPUTS, Record, Stamps, peak_mb, record, tell

jax.config.update("jax_enable_x64", True)
STEPS, CHUNK, UNROLL = 5, 1024, 4
Sums = tuple[Any, Any]  # J'J, J'e
Simulation = Callable[[Any], Any]


def layers(w: Any) -> tuple[Any, Any, Any, Any, Any]:
    units = w[: -HIDDEN - 1].reshape(HIDDEN, HIDDEN + INPUTS + 1)
    return units[:, :HIDDEN], units[:, HIDDEN:-1], units[:, -1], w[-HIDDEN - 1 : -1], w[-1]


def outside(u: Any) -> Simulation:
    def output(w: Any) -> Any:
        context, entering, bias, out, out_bias = layers(w)

        def step(x: Any, drive: Any) -> tuple[Any, Any]:
            x = jnp.tanh(context @ x + drive)
            return x, x

        states = jax.lax.scan(step, jnp.zeros(HIDDEN), u @ entering.T + bias)[1]
        return states @ out + out_bias

    return output


def inside(u: Any) -> Simulation:
    def output(w: Any) -> Any:
        context, entering, bias, out, out_bias = layers(w)

        def step(x: Any, now: Any) -> tuple[Any, Any]:
            x = jnp.tanh(context @ x + entering @ now + bias)
            return x, x @ out + out_bias

        return jax.lax.scan(step, jnp.zeros(HIDDEN), u, unroll=UNROLL)[1]

    return output


def differentiated(output: Simulation, target: Any) -> Callable[[Any], Sums]:
    def sums(w: Any) -> Sums:
        jacobian, error = jax.jacfwd(output)(w), target - output(w)
        return jacobian.T @ jacobian, jacobian.T @ error

    return sums


def by_hand(u: Any, target: Any) -> Callable[[Any], Sums]:
    wide, one = HIDDEN + INPUTS + 1, jnp.ones(1)
    n = HIDDEN * (wide + 1) + 1
    whole = len(u) // CHUNK * CHUNK
    own = jnp.repeat(jnp.eye(HIDDEN), wide, axis=1)  # which weights enter which unit

    def sums(w: Any) -> Sums:
        context, entering, bias, out, out_bias = layers(w)

        def step(carry: Any, now: Any) -> tuple[Any, Any]:
            x, s = carry
            seen = jnp.tile(jnp.concatenate([x, now, one]), HIDDEN)
            x = jnp.tanh(context @ x + entering @ now + bias)
            s = (1.0 - x * x)[:, None] * (context @ s + own * seen)
            return (x, s), (x @ out + out_bias, jnp.concatenate([out @ s, x, one]))

        def chunk(carry: Any, part: Any) -> tuple[Any, None]:
            state, jtj, jte = carry
            state, (y, jacobian) = jax.lax.scan(step, state, part[0], unroll=UNROLL)
            return (state, jtj + jacobian.T @ jacobian, jte + jacobian.T @ (part[1] - y)), None

        start = (jnp.zeros(HIDDEN), jnp.zeros((HIDDEN, HIDDEN * wide)))
        carry = (start, jnp.zeros((n, n)), jnp.zeros(n))
        parts = u[:whole].reshape(-1, CHUNK, INPUTS), target[:whole].reshape(-1, CHUNK)
        carry, _ = jax.lax.scan(chunk, carry, parts)
        if whole < len(u):
            carry, _ = chunk(carry, (u[whole:], target[whole:]))
        return carry[1], carry[2]

    return sums


def climb(
    given: Record, sums: Callable[[Any], Sums], sse: Callable[[Any], Any]
) -> dict[str, float]:
    """Plain Levenberg-Marquardt with pamid's schedule of mu; seconds of a step."""
    w, mu, stamps = given.weights, 0.005, Stamps()
    best = float(sse(w))
    for k in range(STEPS + 1):
        jtj, jte = (np.asarray(part) for part in sums(w))
        stamps()
        if k == STEPS:
            break
        while True:
            tried = w + np.linalg.solve(jtj + mu * np.eye(len(w)), jte)
            found = float(sse(tried))
            if found < best:
                w, best, mu = tried, found, 0.1 * mu
                break
            mu *= 10.0
    return stamps.step


def main() -> None:
    given, form = record(), sys.argv[2]
    u, target = jnp.asarray(given.u), jnp.asarray(given.target)
    output = {"outside": outside, "inside": inside, "by-hand": outside}[form](u)
    sums = jax.jit(by_hand(u, target) if form == "by-hand" else differentiated(output, target))
    sse = jax.jit(lambda w: jnp.sum((target - output(w)) ** 2))
    jte = np.asarray(sums(given.weights)[1])  # compiles
    sse(given.weights).block_until_ready()
    tell(jte, **climb(given, sums, sse), peak_mb=peak_mb(), version=f"jax {jax.__version__}")


if __name__ == "__main__":
    main()
