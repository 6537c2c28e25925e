"""Arrays of any kind that hold the same numbers give the same bits."""

import jax.numpy as jnp
import numpy as np
import pytest

import erosion

P = erosion.TABLE_1
ANGLES = np.deg2rad(np.linspace(5.0, 85.0, 12))


LAYOUTS = {
    "strided": lambda a: np.stack([a, 0 * a], 1)[:, 0],
    "reversed": lambda a: a[::-1].copy()[::-1],
    "by columns": lambda a: np.asfortranarray(a.reshape(3, 4)),
    "transposed": lambda a: a.reshape(4, 3).T,
    "of six dimensions": lambda a: a.reshape(1, 2, 1, 3, 1, 2),
    "broadcast": lambda a: np.broadcast_to(a, (4, 12)),
    "big-endian": lambda a: a.astype(">f8"),
    "long": lambda a: a.astype(np.longdouble),
    "read-only": lambda a: np.frombuffer(a.tobytes()),
    "of JAX": jnp.asarray,
    "a list": list,
    "a tuple": tuple,
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_an_array_of_any_layout_gives_the_same_bits(layout) -> None:
    given = LAYOUTS[layout](ANGLES)
    expected = [
        erosion.impact("rotating", P.replace(alpha=alpha)).volume for alpha in np.ravel(np.asarray(given, float))
    ]
    volume = erosion.impact("rotating", P.replace(alpha=given)).volume
    np.testing.assert_array_equal(volume, np.reshape(expected, np.shape(given)))


@pytest.mark.parametrize("kind", [np.float32, np.float16, np.int64, np.uint8])
def test_an_array_of_another_type_is_the_float64_of_its_numbers(kind) -> None:
    k = np.array([1, 2, 3], kind)
    volume = erosion.impact("rotating", P.replace(k=k)).volume
    np.testing.assert_array_equal(volume, erosion.impact("rotating", P.replace(k=k.astype(float))).volume)
    assert volume.dtype == np.float64


@pytest.mark.parametrize("shape", [(0,), (3, 0), (1,), ()])
def test_no_impact_and_one_have_their_shape(shape) -> None:
    assert np.shape(erosion.impact("rotating", P.replace(alpha=np.full(shape, 0.3))).volume) == shape
