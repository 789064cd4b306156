"""Covariance of a design against closed forms and against least squares drawn many times; the guards of the choice."""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np
import pytest

from pmabench.analysis.next_trial import (
    MOST_IN_CELL,
    RANDOM,
    REFERENCE,
    Aim,
    Design,
    Field,
    choose,
    fewest,
    out_of_reach,
    propose,
    scatter_like,
)


def test_means_of_trials_have_the_textbook_variance() -> None:
    """One unknown, n trials of m rows each: sigma^2 / (n m) + T / n."""
    n, m, sigma, T = 5, 12, 0.7, 0.09
    design = Design(np.zeros((1, 1)), np.array([[[float(m)]]]), sigma, np.array([[T]]), np.eye(1))
    assert np.isclose(design.variances(np.array([float(n)]))[0], sigma**2 / (n * m) + T / n)
    assert np.isclose(design.after_each(np.array([float(n - 1)]))[0, 0], sigma**2 / (n * m) + T / n)


def _rows(chance: np.random.Generator) -> list[np.ndarray]:
    """Rows of three cells that see intercept and slope differently, and unlike numbers of them."""
    return [
        np.column_stack((np.ones(n), at + 0.3 * chance.standard_normal(n)))
        for n, at in ((20, 0.0), (35, 1.0), (10, 2.5))
    ]


def test_the_covariance_is_that_of_least_squares_drawn_many_times() -> None:
    """Ordinary least squares of numpy on trials with scattered coefficients, 2000 campaigns."""
    chance = np.random.default_rng(3)
    cells, sigma, T = _rows(chance), 0.5, np.array([[0.2, 0.05], [0.05, 0.1]])
    counts = np.array([3.0, 1.0, 2.0])
    order = [cell for cell, count in enumerate(counts) for _ in range(int(count))]
    found = []
    for _ in range(2000):
        rows = [cells[cell] for cell in order]
        values = [x @ chance.multivariate_normal([1.0, 2.0], T) + sigma * chance.standard_normal(len(x)) for x in rows]
        found.append(np.linalg.lstsq(np.vstack(rows), np.concatenate(values), rcond=None)[0])
    design = Design(np.zeros((2, 2)), np.array([x.T @ x for x in cells]), sigma, T, np.eye(2))
    assert np.allclose(design.variances(counts), np.var(found, axis=0), rtol=0.08)
    for cell in range(3):
        assert np.allclose(design.after_each(counts)[cell], design.variances(counts + np.eye(3)[cell]))


def test_the_scatter_is_found_that_makes_the_intervals() -> None:
    """For means of n trials the half width is 1.96 sqrt(sigma^2 / (n m) + T / n): T follows from it."""
    n, m, sigma, T = 5.0, 12.0, 0.02, 0.09**2
    design = Design(np.zeros((1, 1)), np.array([[[m]]]), sigma, np.eye(1), np.eye(1))
    half = 1.96 * np.sqrt(sigma**2 / (n * m) + T / n)
    assert np.isclose(scatter_like(design, np.array([n]), np.array([half]), 0.02), np.sqrt(T), rtol=1e-3)
    assert scatter_like(design, np.array([n]), np.empty(0), 0.02) == 0.02


def _sweep() -> tuple[Design, Aim, Field]:
    """A straight line over pressure, by cells of four loads and three pressures; goals that ask for many trials."""
    places = tuple((load, P) for load in (1.0, 2.0, 3.0, 4.0) for P in (0.0, 1.0, 2.0))
    cells = np.array([10 * np.outer(x, x) for x in (np.array([1.0, P]) for _, P in places)])
    design = Design(1e-6 * np.eye(2), cells, 0.3, 0.01 * np.eye(2), np.array([[1.0, 0.0], [1.0, 1.0], [1.0, 2.0]]))
    aim = Aim(np.full(3, 0.1), np.full(3, 1.96), np.zeros(3))
    return design, aim, Field(places, np.full(12, 26.0), 60.0, 4, "7")


def test_choices_keep_references_random_cells_coverage_and_the_most_of_a_cell() -> None:
    design, aim, field = _sweep()
    steps = propose(design, aim, field, np.zeros(12), 0, None, most=60)
    cells = [step.choice.cell for step in steps]
    roles = [step.choice.role for step in steps]
    assert len(steps) > 24
    assert all(role == REFERENCE and cell == 4 for role, cell in zip(roles[::8], cells[::8], strict=True))
    assert roles.count(RANDOM) >= len(steps) // 10
    early = {field.places[cell] for cell in cells[:7]}
    assert {load for load, _ in early} == {1.0, 2.0, 3.0, 4.0}
    assert {P for _, P in early} == {0.0, 1.0, 2.0}
    others = [cell for cell, role in zip(cells, roles, strict=True) if role != REFERENCE]
    assert max(others.count(cell) for cell in set(others)) <= MOST_IN_CELL
    assert cells == [s.choice.cell for s in propose(design, aim, field, np.zeros(12), 0, None, most=60)]


def test_a_choice_prefers_what_narrows_and_the_load_that_is_on() -> None:
    design, aim, field = _sweep()
    counts = np.ones(12)
    first = choose(design, aim, field, counts, np.full(12, 6.0), 1, 3.0)
    assert field.places[first.cell][0] == 3.0
    assert field.places[first.cell][1] in (0.0, 2.0)  # the ends tell most of a line
    assert first.after < first.before


def test_goals_out_of_reach_are_named() -> None:
    design, aim, _ = _sweep()
    assert out_of_reach(design, aim, np.ones(12)) == []
    rest = np.array([0.0, 0.1, 0.0])
    assert out_of_reach(design, Aim(aim.goal, aim.factor, rest), np.ones(12)) == [1]


def test_few_trials_are_found_that_reach_the_goals() -> None:
    """Cells that each show one unknown alone: a variance of T / n takes n trials."""
    cells = np.array([1e6 * np.outer(x, x) for x in np.eye(3)])
    design = Design(1e-3 * np.eye(3), cells, 1.0, np.eye(3), np.eye(3))
    aim = Aim(1.96 / np.sqrt([4.0, 1.0, 3.0]) * 1.01, np.full(3, 1.96), np.zeros(3))
    assert fewest(design, aim, np.zeros(3), None).tolist() == [4.0, 1.0, 3.0]
    assert fewest(design, aim, np.array([1.0, 5.0, 0.0]), None).tolist() == [4.0, 5.0, 3.0]
    assert fewest(design, aim, np.zeros(3), 1).tolist() == [4.0, 1.0, 3.0]


@pytest.mark.parametrize("goal", [0.13, 0.16, 0.2])
def test_nearly_the_fewest_trials_of_all_designs_are_found(goal: float) -> None:
    """Against every design of a straight line, tried one by one."""
    design, aim, _ = _sweep()
    aim = Aim(np.full(3, goal), aim.factor, aim.rest)

    def reached(cells: tuple[int, ...]) -> bool:
        counts = np.bincount(np.array(cells), minlength=12).astype(float)
        return bool(aim.reached(design.variances(counts)).all())

    found = fewest(design, aim, np.zeros(12), None)
    assert aim.reached(design.variances(found)).all()
    pressures = [0, 1, 2]  # of one load: loads do not matter to this line
    best = next(n for n in range(2, 60) if any(map(reached, combinations_with_replacement(pressures, n))))
    assert found.sum() <= 1.2 * best
