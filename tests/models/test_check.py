"""What is said of a model that cannot be used: the first slips of a newcomer."""

import equinox as eqx
import jax.numpy as jnp
import pytest

import erosion


class _Asking(erosion.models.ForceLaw):
    """Asks for the value of a number, as numpy code may."""

    def __call__(self, state, tip, p):
        force = -p.stiffness * tip.depth
        if tip.depth > p.r:
            force = 2 * force
        return force, p.k * force

    def typical_ratio(self, p):
        return p.k


class _Lonely(_Asking):
    """Gives one number."""

    def __call__(self, state, tip, p):
        return -p.stiffness * tip.depth


class _Changing(_Asking):
    """Gives another force each time that it is asked."""

    calls: list = eqx.field(default_factory=list, static=True)

    def __call__(self, state, tip, p):
        self.calls.append(1)
        force = -p.stiffness * tip.depth * len(self.calls)
        return force, p.k * force


class _Rounded(_Asking):
    """Gives numbers of seven digits."""

    def __call__(self, state, tip, p):
        force = jnp.asarray(-p.stiffness * tip.depth, jnp.float32)
        return force, p.k * force


class _Constant(_Asking):
    """Gives numbers of Python."""

    def __call__(self, state, tip, p):
        return 0, -1.0


class _Silent(_Asking):
    """Raises without a word."""

    def __call__(self, state, tip, p):
        raise KeyError


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (lambda: erosion.models.Rotating(force=_Asking()), r"in line \d+ of test_check\.py: it asks for the value"),
        (lambda: erosion.models.Rotating(force=_Asking()), r"write `jnp\.where\(condition, a, b\)` for `if`"),
        (lambda: erosion.models.Rotating(force=_Lonely()), r"_Lonely must give two numbers, \(F_x, F_y\)"),
        (
            lambda: erosion.models.Rotating(force=_Changing()),
            "must give the same at each call, but its equations change",
        ),
        (
            lambda: erosion.models.Rotating(force=_Rounded()),
            "_Rounded must give numbers of type float64, but gives float32",
        ),
        (lambda: erosion.models.Rotating(force=_Silent()), r"in line \d+ of test_check\.py: KeyError\.$"),
    ],
)
def test_first_slips_are_told_with_what_to_write(model, message) -> None:
    with pytest.raises(erosion.models.ModelError, match=message):
        erosion.load_model(model())


def test_pythons_own_numbers_are_forces() -> None:
    erosion.load_model(erosion.models.Rotating(force=_Constant()))
