"""Student's quantiles against the printed table (Student 1908 as in every handbook) and `scipy.stats`."""

import numpy as np
import pytest
from scipy.stats import t

from pmabench.analysis.shared import student


@pytest.mark.parametrize(("freedom", "printed"), [(1, 12.706), (2, 4.303), (5, 2.571), (10, 2.228), (30, 2.042)])
def test_the_printed_table(freedom, printed):
    assert float(student.ppf(0.975, freedom)) == pytest.approx(printed, abs=5e-4)


def test_the_same_as_scipy_for_every_degree():
    freedom = np.array([0.0, 0.5, 1.0, 3.7, 1e6, np.inf])
    np.testing.assert_array_equal(student.ppf(0.975, freedom), t.ppf(0.975, freedom))
