"""Numbers of the program: each defined once, by the module that owns it, and those that can be computed are."""

from __future__ import annotations

import ast
from collections import defaultdict
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import simpson
from scipy.optimize import brentq
from scipy.special import gammaln
from scipy.stats import norm

import orthoscale
from orthoscale.core.normal import ROBUST_SD, Z90, median_sd, of_median, robust_sd
from orthoscale.core.round_numbers import round_above, round_below, scale_bar
from orthoscale.sources.ground_sheet import ABOVE, BELOW, SETTLES, SPREAD

PACKAGE = Path(orthoscale.__file__).parent


@cache
def modules():
    """Every module of the package, parsed, by its path."""
    return {path.relative_to(PACKAGE).as_posix(): ast.parse(path.read_text()) for path in PACKAGE.rglob("*.py")}


def constants(tree):
    """Names in upper case that a module assigns at its top level."""
    for node in tree.body:
        if isinstance(node, ast.Assign):
            targets = node.targets
        elif isinstance(node, ast.AnnAssign) and node.value is not None:
            targets = [node.target]
        else:
            continue
        for target in targets:
            names = target.elts if isinstance(target, ast.Tuple) else [target]
            yield from (name.id for name in names if isinstance(name, ast.Name) and name.id.isupper())


def test_every_constant_is_defined_in_one_module():
    homes = defaultdict(set)
    for module, tree in modules().items():
        for name in constants(tree):
            homes[name].add(module)
    assert len(homes) > 300, "the package is not read"
    assert not {name: sorted(modules) for name, modules in homes.items() if len(modules) > 1}


def test_round_numbers_have_one_owner():
    """1, 2, 5: scale bars and the ticks of charts take theirs from core/round_numbers.py."""
    found = {
        module
        for module, tree in modules().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Tuple) and ast.unparse(node).strip("()").startswith("1, 2, 5")
    }
    assert found == {"core/round_numbers.py"}


@pytest.mark.parametrize("value", [0.003, 0.0199, 0.02, 0.5, 1, 4.99, 5, 7, 99.9, 1000, 123_456.0])
def test_round_numbers_are_next_below_and_above(value):
    known = np.multiply.outer(10.0 ** np.arange(-4, 8), [1, 2, 5]).ravel()
    assert round_below(value) == pytest.approx(known[known <= value * (1 + 1e-12)].max())
    assert round_above(value) == pytest.approx(known[known >= 0.999 * value].min())
    metres, length = scale_bar(value / 200, 1000)
    assert metres == round_below(value) and 80 < length <= 200.001 and length * value / 200 == pytest.approx(metres)


@pytest.mark.parametrize("power", range(-6, 7))
def test_what_is_a_hair_less_than_a_power_of_ten_has_a_round_number_below(power):
    """Its logarithm is rounded to a whole number, and nothing was left below."""
    value = float(np.nextafter(10.0**power, 0))
    assert round_below(value) == pytest.approx(value / 2) and round_above(value) == pytest.approx(value)


def test_the_normal_distributions_numbers_have_one_owner():
    """1.4826 and 1.645, in whatever precision, are written nowhere but in core/normal.py; nor in the training."""
    training = {str(path): ast.parse(path.read_text()) for path in (PACKAGE.parent / "training").rglob("*.py")}
    found = {
        f"{module}:{node.lineno}": node.value
        for module, tree in (modules() | training).items()
        if module != "core/normal.py"
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, float)
        and (1.48 <= node.value <= 1.483 or 1.64 <= node.value <= 1.65)
    }  # fmt: skip
    assert not found


def test_the_normal_distributions_numbers_are_right():
    assert pytest.approx(norm.ppf(0.95), abs=1e-4) == Z90
    assert pytest.approx(1 / norm.ppf(0.75), abs=1e-4) == ROBUST_SD


def test_the_robust_sigma_is_that_of_each_column_about_its_own_middle_whatever_a_few_do():
    drawn = np.random.default_rng(0).normal((5, -70), (1, 3), (40_000, 2))
    drawn[:100] = 1e9
    assert robust_sd(drawn) == pytest.approx([1, 3], rel=0.02)
    assert robust_sd(drawn[:, 1]) == robust_sd(drawn)[1] and robust_sd(np.array([4.0])) == 0


def variance_of_median(count):
    """Of so many normal values: the joint density of the middle two, or the density of the middle one, integrated."""
    middle = np.linspace(-9, 9, 1201)
    below = (count - 1) // 2  # values on either side of the middle ones
    half = np.linspace(0, 6, 401) if count % 2 == 0 else np.zeros(1)  # of the distance between the middle two
    low, high = middle[:, None] - half, middle[:, None] + half
    log = gammaln(count + 1) - 2 * gammaln(below + 1) + below * (norm.logcdf(low) + norm.logsf(high)) + norm.logpdf(low)
    density = np.exp(log + (norm.logpdf(high) if count % 2 == 0 else 0))
    density = density.sum(1) if count % 2 else simpson(density, x=half, axis=1)
    return float(density @ middle**2 / density.sum())


def test_the_variance_of_a_median_is_that_of_the_order_statistics():
    counts = np.array([*range(1, 25), 40, 41, 100, 101])
    exact = np.array([variance_of_median(count) for count in counts.tolist()])
    assert of_median(counts[:10]) == pytest.approx(exact[:10], rel=1e-5)
    assert of_median(counts) == pytest.approx(exact, rel=4e-4)
    assert float(of_median(1)) == 1.0, "one view leaves all of its noise"
    assert (np.diff(of_median(np.arange(1, 200))) < 0).all(), "no jump"
    assert float(of_median(10**6)) == pytest.approx(np.pi / 2 / 10**6, rel=1e-4), "Laplace"
    drawn = np.random.default_rng(0).standard_normal((200_000, 4))
    assert np.median(drawn, axis=1).var() == pytest.approx(float(of_median(4)), rel=0.01)


@pytest.mark.parametrize("count", [*range(2, 13), 20, 40])
def test_the_interval_of_a_median_holds_nine_times_in_ten_however_few_the_values(count):
    drawn = np.random.default_rng(count).standard_normal((8000, count))
    held = [abs(np.median(values)) < Z90 * median_sd(values) for values in drawn]
    assert np.mean(held) == pytest.approx(0.9, abs=0.015)
    assert median_sd(3 * drawn[0] + 7) == pytest.approx(3 * median_sd(drawn[0])), "in the values' unit"


def test_where_the_ground_sheet_settles_follows_from_how_it_listens():
    """Points normally distributed about the ground, the sheet's squared biweight with its two widths: where the pull
    of the points above equals that of those below, and what the median of those below is then worth."""
    z = np.linspace(-6, 6, 240_001)
    density = norm.pdf(z)

    def pull(lower):
        residual = z + lower
        width = np.where(residual > 0, ABOVE, BELOW)
        weight = np.clip(1 - (residual / width) ** 2, 0, None) ** 2
        return float((density * weight * residual).sum())

    lower = brentq(pull, 0.0, 1.0)
    assert lower == pytest.approx(SETTLES, abs=0.01)
    median_below = -lower - norm.ppf(norm.cdf(-lower) / 2)
    assert 1 / median_below == pytest.approx(SPREAD, abs=0.01)
