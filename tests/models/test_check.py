"""What is said of a model that cannot be used: the first slips of a newcomer."""

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


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (lambda: erosion.models.Rotating(force=_Asking()), r"in line \d+ of test_check\.py: it asks for the value"),
        (lambda: erosion.models.Rotating(force=_Asking()), r"write `jnp\.where\(condition, a, b\)` for `if`"),
        (lambda: erosion.models.Rotating(force=_Lonely()), r"_Lonely must give two numbers, \(F_x, F_y\)"),
    ],
)
def test_first_slips_are_told_with_what_to_write(model, message) -> None:
    with pytest.raises(erosion.models.ModelError, match=message):
        erosion.load_model(model())
