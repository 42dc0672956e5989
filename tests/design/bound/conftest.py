"""The arms and limits for which the bound is tested."""

import pytest

from tests.shared.bound_cases import CASES


@pytest.fixture(scope="module", params=list(CASES))
def case(request: pytest.FixtureRequest) -> str:
    return str(request.param)
