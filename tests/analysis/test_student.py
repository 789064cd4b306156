"""Student's quantiles against the printed table (Student 1908 as in every handbook) and `scipy.stats`."""

import numpy as np
import pytest
from scipy.stats import t

from pmabench.analysis.shared import student


@pytest.mark.parametrize(("freedom", "printed"), [(1, 12.706), (2, 4.303), (5, 2.571), (10, 2.228), (30, 2.042)])
def test_the_printed_table(freedom, printed):
    assert float(student.ppf(0.975, freedom)) == pytest.approx(printed, abs=5e-4)


def test_the_same_as_scipy_for_every_degree():
    freedom = np.array([0.0, 0.5, 1.0, 1.01, 1.7, 3.7, *range(2, 310, 7), 299.5, 300.1, 301.0, 777.7, 1e4, 1e6, np.inf])
    for share in (0.3, 0.5, 0.8, 0.975, 0.99, 0.995, 0.99865, 1 - 1e-6):
        np.testing.assert_allclose(student.ppf(share, freedom), t.ppf(share, freedom), rtol=1e-11, atol=1e-15)
