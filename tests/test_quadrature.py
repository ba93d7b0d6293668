"""Adaptive integration: the error told of a kink, wherever it lies between the points that are seen."""

from __future__ import annotations

import numpy as np
import pytest

from psfcli.image.quadrature import Rule, integrate_adaptively

SLICES = 16
PLACES = 2000


def integrated(place: np.ndarray, power: float, tolerance: float, at_once: int = 1024) -> Rule:
    """(place - x)^power to the left of each ``place``, nothing to its right, over (0, 1); a group for each."""

    def functions(x: np.ndarray, group: np.ndarray) -> np.ndarray:
        return np.where(x < place[group], np.abs(place[group] - x) ** power, 0.0)[:, None]

    edges = np.linspace(0.0, 1.0, SLICES + 1)
    left, right = np.tile(edges[:-1], place.size), np.tile(edges[1:], place.size)
    group = np.repeat(np.arange(place.size), SLICES)
    return integrate_adaptively(functions, left, right, group, np.full(place.size, tolerance), at_once=at_once)


@pytest.mark.parametrize("tolerance", [1e-2, 1e-3, 1e-5])
@pytest.mark.parametrize("power", [0.0, 0.2, 1.0 / 3.0, 0.5, 0.8])
def test_a_kink_errs_by_no_more_than_told_wherever_it_lies(power, tolerance):
    place = np.random.default_rng(5).random(PLACES)
    rule = integrated(place, power, tolerance)
    error = np.abs(rule.integral[:, 0] - place ** (1.0 + power) / (1.0 + power))
    assert np.all(rule.error <= tolerance)
    assert np.all(error <= tolerance)
    # 2.5 times, as the rule says; nobody is promised more than 3
    assert np.max(error / rule.error) < 2.6
    # and it is a kink's error that is told, not a bound of all errors
    assert np.median(rule.error / np.maximum(error, 1e-16)) < 50.0


def test_a_group_is_the_same_whatever_is_integrated_beside_it():
    place = np.random.default_rng(6).random(40)
    together = integrated(place, 0.5, 1e-4)
    for n in (0, 17, 39):
        alone = integrated(place[n : n + 1], 0.5, 1e-4, at_once=64)
        assert together.integral[n] == alone.integral[0]
        assert together.error[n] == alone.error[0]


def test_a_smooth_function_is_halved_no_further_than_it_must_be():
    def functions(x: np.ndarray, group: np.ndarray) -> np.ndarray:
        del group
        return np.stack([np.exp(np.sin(7.0 * x)), np.cos(9.0 * x)], axis=1)

    edges = np.linspace(0.0, 1.0, SLICES + 1)
    first = np.zeros(SLICES, dtype=np.intp)
    rule = integrate_adaptively(functions, edges[:-1], edges[1:], first, np.array([1e-3]), at_once=64)
    truth = integrate_adaptively(functions, edges[:-1], edges[1:], first, np.array([1e-12]), at_once=64)
    assert rule.left.size == SLICES
    assert np.max(np.abs(rule.integral - truth.integral)) <= rule.error[0] <= 1e-3
