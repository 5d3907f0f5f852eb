"""A register of models becomes a fleet."""

import json

import pytest
from click.testing import CliRunner

from orthoscale.cli.main import cli
from orthoscale.errors import InputError, TooLittleEvidence
from orthoscale.fleets import load_fleet
from orthoscale.registrations import _makes, _models, fleet_of_register, model_called


def written(folder, text, name="register.csv"):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("text", "length"),
    [("Fiat Panda", 3.60), ("VOLKSWAGEN, VW GOLF VII", 4.17), ("Citro\u00ebn C3", 3.97), ("FORD F150", 5.62),
     ("Honda CR-V 2.0", 4.60), ("Tesla Model Y", 4.75), ("Mercedes C-Klasse", 4.65), ("BMW 3er", 4.51)],
)  # fmt: skip
def test_a_model_is_known_by_whatever_a_register_calls_it(text, length):
    assert model_called(text).size[0] == pytest.approx(length, abs=0.06)


def test_a_name_that_is_in_no_model_is_not_known():
    assert model_called("Trabant 601") is None and model_called("") is None


@pytest.mark.parametrize(
    ("text", "length"),
    [("Nissan Note", 4.06), ("Nissan Leaf", 4.46), ("Nissan Micra", 3.72), ("Nissan Navara", 5.25),
     ("Nissan Patrol", 5.1), ("Nissan X-Trail", 4.65), ("Mazda CX-5", 4.55), ("Mazda 3", 4.46), ("Hyundai i10", 3.67),
     ("Vauxhall Corsa", 3.99), ("Wuling Hongguang Mini", 2.92), ("Opel Astra Caravan", 4.25), ("Chevy Tahoe", 5.2),
     ("VW Golf Kombi", 4.17), ("VW Kombi", 4.5), ("GM Chevy C2", 3.82), ("Ram 1500", 5.93), ("Dodge Ram Quad", 5.93)],
)  # fmt: skip
def test_a_make_or_series_is_no_model(text, length):
    assert model_called(text).size[0] == pytest.approx(length, abs=0.15)


@pytest.mark.parametrize(
    "text",
    ["Nissan", "Nissan Cube", "Mazda", "Mazda MX-5", "Mazda CX-9", "Tesla Model X", "VW ID.3", "Grand", "Ford Sierra",
     "Toyota Vista", "Mercedes C", "Lincoln Mark", "Chevy Cavalier", "Ram ProMaster"],
)  # fmt: skip
def test_a_model_of_another_make_or_series_is_not_known(text):
    """The table's Sierra is GMC's, its Vista Tata's."""
    assert model_called(text) is None


def test_every_make_in_the_table_has_models_of_the_table():
    for make, models in _makes().items():
        assert models and models <= _models().keys(), make


def test_a_model_that_several_makes_sell_is_known_by_each():
    assert model_called("Renault Duster") == model_called("Dacia Duster") == model_called("Duster") is not None
    assert model_called("GMC Sierra") == model_called("Sierra") is not None


def test_a_fleet_has_the_registers_mean_and_classes(tmp_path):
    path = written(tmp_path, "Marke;Modell;Anzahl\nFiat;Panda;6 000\nFord;F-150;3000\nTrabant;601;1000\n")
    register = fleet_of_register(path)
    assert register.vehicles == 10_000 and register.known == pytest.approx(0.9)
    assert register.unknown == (("Trabant 601", 0.1),)
    length = (2 * 3.596 + 5.62) / 3
    assert register.entry["length"][0] == pytest.approx(length, abs=0.03)
    assert register.entry["length"][1] > 0.9, "two humps a long way apart"
    assert {part["class"]: part["weight"] for part in register.entry["mixture"]} == pytest.approx(
        {"mini": 2 / 3, "pickup": 1 / 3}, abs=1e-4
    )
    whole = fleet_of_register(written(tmp_path, "model,count\nPanda,6000\nF-150,3000\n", "whole.csv"))
    assert register.entry["mean_sd"][0] > whole.entry["mean_sd"][0], "what is not known counts"


def test_the_command_writes_a_fleet_that_loads_and_lists_what_it_does_not_know(tmp_path):
    path, out = written(tmp_path, "make,model,count\nVW,Polo,700\nVW,Golf,200\nX,Nobody,100\n"), tmp_path / "town.json"
    result = CliRunner().invoke(cli, ["fleets", "--registrations", str(path), "--out", str(out)])
    assert result.exception is None, result.output
    assert "90 % of models whose size is known" in result.output and "X Nobody: 10.0 %" in result.output
    fleet = load_fleet(out)
    assert fleet.mean[0] == pytest.approx(json.loads(out.read_text())["length"][0])
    assert 3.9 < fleet.mean[0] < 4.1 and "900" not in fleet.name


def test_too_little_known_is_refused_with_what_is_not(tmp_path):
    path = written(tmp_path, "model,count\nPolo,50\nNobody,50\n")
    with pytest.raises(TooLittleEvidence, match="50 % of 100"):
        fleet_of_register(path)


@pytest.mark.parametrize(
    ("text", "said"),
    [("", "empty"), ("a,b\n1,2\n", "line 1: no column model"), ("model\nGolf\n", "line 1: no column count"),
     ("model,count\nGolf,many\n", "line 2"), ("model,count\nGolf,-1\n", "line 2"),
     ("model,count\nGolf,0\n", "no vehicle"),
     ("model,count\nGolf\n", "line 2"), ("\n\na,b\n1,2\n", "line 3: no column model"),
     ("\nmodel,count\nGolf,many\n", "line 3"), ("model,count,Count\nGolf,1,2\n", "several columns count"),
     (f"model,count,{'x' * 140_000}\nGolf,1\n", "not a CSV table .field larger")],
)  # fmt: skip
def test_what_is_no_register(tmp_path, text, said):
    with pytest.raises(InputError, match=said):
        fleet_of_register(written(tmp_path, text))


@pytest.mark.parametrize("before", ["\n", "\r\n\r\n", " \n", ";;\n"])
def test_blank_lines_before_the_header_are_passed_over(tmp_path, before):
    path = tmp_path / "register.csv"
    path.write_bytes(f"{before}model;note;count\nGolf;a,b,c,d;250\n".encode())
    assert fleet_of_register(path).vehicles == 250


def test_columns_that_are_not_wanted_may_share_a_name(tmp_path):
    assert fleet_of_register(written(tmp_path, "note,model,count,note,,\na,Golf,7,b,,\n")).vehicles == 7


@pytest.mark.parametrize(
    "said, vehicles",
    [("1.234", 1234), ("1,234", 1234), ("12 345", 12345), ("1'234'567", 1234567), ("250", 250), ("250.0", 250),
     ("1.234,0", 1234)],
)  # fmt: skip
def test_thousands_may_be_set_apart(tmp_path, said, vehicles):
    """A point sets them apart where a comma marks decimals: 1.234 is not 1.234 cars."""
    path = written(tmp_path, f'model;count\nGolf;"{said}"\n')
    assert fleet_of_register(path).vehicles == vehicles


@pytest.mark.parametrize("said", ["12.5", "1.23", "-3", "nan", "", "1.2345", "1e3", "many"])
def test_what_is_no_whole_number_is_refused(tmp_path, said):
    with pytest.raises(InputError, match="line 2: .* not a whole number of vehicles"):
        fleet_of_register(written(tmp_path, f"model;count\nGolf;{said}\n"))
