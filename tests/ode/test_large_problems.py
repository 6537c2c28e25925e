"""Right-hand sides that are large programs: against an independent solver, with derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from scipy.integrate import solve_ivp

from erosion import ode
from erosion.lanes import flatten


def bodies(count):
    """Bodies that attract each other, softened by ε."""
    random, masses = np.random.default_rng(1), np.linspace(0.5, 1.5, count)

    def field(t, y, args):
        apart = y["q"][None] - y["q"][:, None]
        pull = ((apart**2).sum(-1) + args["eps"]) ** -1.5
        return {"q": y["v"], "v": (masses[None, :, None] * pull[..., None] * apart).sum(1)}

    y0 = {"q": random.normal(size=(count, 3)), "v": 0.3 * random.normal(size=(count, 3))}
    return ode.Problem(y0=y0, vector_field=field), {"eps": 0.1}, 1.0


def oscillators(count):
    """Kuramoto's, each coupled to all others."""
    random = np.random.default_rng(2)
    frequencies = random.normal(size=count)

    def field(t, y, args):
        return frequencies + args["coupling"] / count * jnp.sin(y[None, :] - y[:, None]).sum(1)

    return ode.Problem(y0=random.uniform(-3, 3, count), vector_field=field), {"coupling": 1.5}, 5.0


def brusselator(count):
    """A reaction with diffusion in one dimension, on a grid: stiff."""
    x = np.arange(1, count + 1) / (count + 1)

    def spread(at_ends, w):
        padded = jnp.concatenate([jnp.full(1, at_ends), w, jnp.full(1, at_ends)])
        return padded[2:] - 2 * w + padded[:-2]

    def field(t, y, args):
        u, v = y["u"], y["v"]
        rate = args["diffusion"] * (count + 1) ** 2
        return {"u": 1 + u * u * v - 4 * u + rate * spread(1.0, u), "v": 3 * u - u * u * v + rate * spread(3.0, v)}

    y0 = {"u": 1 + np.sin(2 * np.pi * x), "v": np.full(count, 3.0)}
    return ode.Problem(y0=y0, vector_field=field), {"diffusion": 0.02}, 1.0


def mechanism(count):
    """Reactions of two species to two others, at random, by the law of mass action."""
    random = np.random.default_rng(3)
    reactions = [(random.choice(count, 2), random.choice(count, 2), random.uniform(0.1, 2)) for _ in range(2 * count)]

    def field(t, y, args):
        rates = [0.0] * count
        for before, after, factor in reactions:
            speed = factor * args["k"] * y[before[0]] * y[before[1]]
            for i in before:
                rates[i] = rates[i] - speed
            for i in after:
                rates[i] = rates[i] + speed
        return rates

    return ode.Problem(y0=list(random.uniform(0.2, 1, count)), vector_field=field), {"k": 1.0}, 2.0


def reference(problem, args, t1, order, *, stiff):
    """The state at t1 and its derivatives by the one argument, by scipy."""
    flat, unravel = ravel_pytree(jax.tree.map(jnp.asarray, problem.y0))
    (name, number), n = *args.items(), flat.size

    def field(state, number):
        return ravel_pytree(problem.vector_field(0.0, unravel(state), {name: number}))[0]

    def first(state, tangent, number):
        return jax.jvp(field, (state, number), (tangent, 1.0))[1]

    def rates(t, rows):
        state, *tangents = rows.reshape(order + 1, n)
        parts = [field(state, number)]
        parts += [first(state, tangent, number) for tangent in tangents[:1]]
        if order == 2:
            parts.append(jax.jvp(first, (state, tangents[0], number), (*tangents, 1.0))[1])
        return jnp.concatenate(parts)

    start = np.concatenate([flat, np.zeros(order * n)])
    options = {"method": "Radau", "jac": jax.jit(jax.jacfwd(rates, 1))} if stiff else {"method": "DOP853"}
    end = solve_ivp(jax.jit(rates), (0.0, t1), start, rtol=1e-12, atol=1e-13, **options)
    return end.y[:, -1].reshape(order + 1, n)


# Of more than `flatten.WHOLE` operations; the 18 numbers of six bodies are an array that stays in memory.
_LARGE = {
    "6 bodies": (bodies, 6, 1),
    "brusselator on 24 points": (brusselator, 24, 1),
}
_SMALL = {
    "16 oscillators": (oscillators, 16, 1),
    "brusselator on 4 points": (brusselator, 4, 1),
    "4 species": (mechanism, 4, 2),
}


@pytest.mark.parametrize("name", [*_SMALL, *_LARGE])
def test_large_problems(name, monkeypatch):
    """A small one is compiled as if it were large."""
    if name in _SMALL:
        monkeypatch.setattr(flatten, "WHOLE", -1)
    make, count, order = (_SMALL | _LARGE)[name]
    problem, args, t1 = make(count)
    (wrt,) = args
    end = ode.solve(problem, args, t1=t1, wrt=wrt, derivatives=order, rtol=1e-11)
    found = [end.y, *(end.along(*[wrt] * (i + 1)).y for i in range(order))]
    expected = reference(problem, args, t1, order, stiff=make is brusselator)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(ravel_pytree(one)[0], other, rtol=0, atol=1e-9 * np.abs(other).max())
