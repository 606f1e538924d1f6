"""Quantiles are those of the library that is too slow to start."""

import pytest
from scipy.stats import chi2, t

from incremental_mapper.quantiles import chi_squared, student_t


@pytest.mark.parametrize('probability', [0.5, 0.95, 0.9999])
@pytest.mark.parametrize('freedom', [1, 3, 40.0])
def test_quantiles_are_those_of_the_distributions(probability, freedom):
    assert chi_squared(probability, freedom) == pytest.approx(chi2.ppf(probability, freedom))
    assert student_t(probability, freedom) == pytest.approx(t.ppf(probability, freedom))
