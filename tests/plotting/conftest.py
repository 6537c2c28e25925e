import pytest

import erosion


@pytest.fixture(scope="session")
def cut() -> erosion.Trajectory:
    return erosion.simulate("linearized", erosion.TABLE_1)
