"""The memory budget: what it takes for an amount, and what it says."""

import pytest

from orthoscale.errors import InputError, UsageError
from orthoscale.formats.reading import read_bytes
from orthoscale.system import budget


@pytest.fixture(autouse=True)
def own_budget(monkeypatch):
    monkeypatch.setattr(budget, "_budget", budget.DEFAULT)


@pytest.mark.parametrize(
    "text, size", [("2G", 2**31), ("1500M", 1500 * 2**20), ("1.5g", 3 * 2**29), ("2 GiB", 2**31), (str(2**30), 2**30)]
)
def test_amounts(text, size):
    budget.allow(text)
    assert budget.memory() == size


@pytest.mark.parametrize("text", ["", "much", "-2G", "1e9", "inf", "100M", "2GG"])
def test_what_is_no_amount_or_too_little(text):
    with pytest.raises(UsageError, match="--memory"):
        budget.allow(text)
    assert budget.memory() == budget.DEFAULT


def test_what_needs_more_says_how_much():
    budget.require(2**30, "a picture")
    with pytest.raises(InputError, match=r"a picture needs 1\.5 GB of memory, but only 1 GB is allowed") as caught:
        budget.require(1.5 * 2**30, "a picture")
    assert caught.value.hint == "Allow more: --memory 2G"


def test_a_file_is_read_within_any_budget(tmp_path):
    """`--memory 64G` ended as a bug on a machine with less: as much was allocated for a network of 10 MB."""
    (tmp_path / "net.onnx").write_bytes(b"network")
    assert read_bytes(tmp_path / "net.onnx", "", 2**60) == b"network"
