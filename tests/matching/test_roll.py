import numpy as np
import pytest

from epiprior.matching.pair import expected_roll, orientation_differences, roll_density


@pytest.mark.parametrize("roll", [-170.0, -78.0, 0.0, 3.5, 90.0, 179.5])
def test_the_peak_is_found_among_outliers(roll):
    rng = np.random.default_rng(0)
    differences = np.concatenate([rng.normal(roll, 4, 60), rng.uniform(0, 360, 200)]) % 360
    assert abs((expected_roll(differences) - roll + 180) % 360 - 180) < 4


def test_density_is_circular_normalised_and_the_sum_of_kernels_of_image_two_minus_image_one():
    differences = np.array([359.5, 0.5, 100.0])
    angles, density = roll_density(differences, 7.0)
    assert density.sum() * 0.5 == pytest.approx(1)
    kernels = np.exp((np.cos(np.radians(angles[:, None] - differences)) - 1) / np.radians(7.0) ** 2).sum(axis=1)
    np.testing.assert_allclose(density, kernels / (kernels.sum() * 0.5), atol=1e-10)
    assert orientation_differences(np.array([10.0, 350.0]), np.array([100.0, 20.0])).tolist() == [90.0, 30.0]
    assert expected_roll(np.empty(0)) == 0.0
    assert roll_density(np.empty(0))[1].sum() * 0.5 == pytest.approx(1)
