"""Fleets: the table, its samples, files of one's own."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.simulate import car_park

import orthoscale
from orthoscale.core.pooling.proposed import proposed_class
from orthoscale.core.pooling.robust import pool
from orthoscale.core.ruler import Ruler
from orthoscale.countries import country_at
from orthoscale.errors import InputError, UsageError
from orthoscale.fleets import fleet_codes, load_fleet

RULER = Ruler(noise=(1.0, 0.6))


@pytest.mark.parametrize("code", fleet_codes())
def test_every_fleet_is_plausible_and_says_where_it_comes_from(code):
    fleet = load_fleet(code)
    assert 3.5 < fleet.mean[0] < 6 and 1.5 < fleet.mean[1] < 2.2 and 1.4 < fleet.mean[2] < 2.1
    assert (fleet.mean_sd > 0).all() and len(fleet.source) > 10
    assert sum(c.weight for c in fleet.classes) == pytest.approx(1)
    # The classes together have the mean that the fleet claims.
    assert sum(c.weight * c.mean for c in fleet.classes) == pytest.approx(fleet.mean, rel=0.01)


@pytest.mark.parametrize("code", ["US", "JP", "WORLD"])
def test_samples_have_the_fleets_moments(code):
    fleet = load_fleet(code)
    sizes = fleet.sample(np.random.default_rng(0), 40_000)
    assert sizes.mean(0) == pytest.approx(fleet.mean, rel=0.01)
    assert sizes[:, :2].std(0) == pytest.approx(fleet.sd[:2], rel=0.12)
    assert np.log(sizes[:, :2]).mean(0) == pytest.approx(fleet.log_mean, abs=0.004)


def test_classes_follow_from_the_shares_of_segments():
    document = json.loads((Path(orthoscale.__file__).parent / "data" / "fleets.json").read_text())
    known = {"mini", "small", "compact", "mid", "large", "SUV", "pickup", "van"}
    mixed = [load_fleet(code) for code, entry in document["fleets"].items() if "shares" in entry]
    assert len(mixed) >= 30
    for fleet in mixed:
        shares = document["fleets"][fleet.code]["shares"]
        assert {c.name for c in fleet.classes} <= known and fleet.shares_source
        assert sum(shares.values()) == pytest.approx(100, abs=0.6)
        pickups = sum(v for k, v in shares.items() if k.startswith("pickup")) / sum(shares.values())
        assert sum(c.weight for c in fleet.classes if c.name == "pickup") == pytest.approx(pickups)
        # The mixture's spread is the fleet's own, as far as segments of all countries can tell.
        mean = sum(c.weight * c.mean for c in fleet.classes)
        variance = sum(c.weight * (c.sd**2 + (c.mean - mean) ** 2) for c in fleet.classes)
        assert np.sqrt(variance[:2]) == pytest.approx(fleet.sd[:2], rel=0.22), fleet.code
        # Classes were moved by little to give the fleet's mean.
        segments = document["segments"]
        plain = sum(v * np.array([segments[k][a][0] for a in ("length", "width")]) for k, v in shares.items()) / 100
        assert fleet.mean[:2] == pytest.approx(plain, rel=0.04), fleet.code


def test_fleets_without_known_shares_say_so_and_are_one_wide_class():
    for code in ("WORLD", "PAPER", "R_WEU"):
        fleet = load_fleet(code)
        assert len(fleet.classes) == 1 and fleet.shares_source.startswith("unknown")
        assert fleet.mean_sd[0] / fleet.mean[0] > 0.025


def test_classes_that_boxes_cannot_tell_apart_are_merged_and_others_are_not():
    assert [round(c.mean[0], 1) for c in load_fleet("JP").told_apart] == [3.4, 4.1, 4.6]
    names = [c.name for c in load_fleet("US").told_apart]
    assert names == ["small", "compact", "mid, large", "SUV", "pickup", "van"]
    pickups = load_fleet("US").told_apart[4]
    assert pickups.mean[0] > 5.5 and pickups.weight == pytest.approx(0.2, abs=0.02)
    assert load_fleet("CN").told_apart[0].name == "mini"  # few, and yet most of some places
    for code in fleet_codes():
        fleet = replace(load_fleet(code), three_wheelers=None)
        few = fleet.told_apart
        assert sum(c.weight * c.mean for c in few) == pytest.approx(sum(c.weight * c.mean for c in fleet.classes))
        second = [
            sum(c.weight * (c.covariance + np.outer(c.mean, c.mean)) for c in each) for each in (few, fleet.classes)
        ]
        assert second[0][:2, :2] == pytest.approx(second[1][:2, :2])


def test_names_are_case_blind_and_unknown_ones_are_refused_with_the_list():
    assert load_fleet("us").code == load_fleet("US").code == "US"
    with pytest.raises(UsageError, match="ISO 3166"):
        load_fleet("atlantis")


@pytest.mark.parametrize(
    ("text", "code"),
    [("usa", "US"), ("CHE", "CH"), ("Schweiz", "CH"), ("suisse", "CH"), ("日本", "JP"), ("Côte d'Ivoire", "CI"),
     ("UK", "GB"), ("Texas", "US_TX"), ("US-ca", "US_CA"), ("tokyo", "JP_Tokyo"), ("Georgia", "GE"),
     ("hong kong", "HK"), ("Georgia, USA", "US_GA"), ("US,TX", "US_TX"), ("The Netherlands", "NL"), ("Palestine", "PS"),
     ("U.K.", "GB"), ("U.S.A.", "US"),
     ("Korea, Republic of", "KR"), ("Congo, Democratic Republic of the", "CD"),
     ("Bolivia, Plurinational State of", "BO"),
     ("Gambia, The", "GM"), ("New York, NY", "US_NY"), ("Washington, D.C.", "US_DC"), ("TX, USA", "US_TX"),
     ("Texas, United States of America", "US_TX"),
     ("DR Congo", "CD"), ("Republic of Congo", "CG"), ("Northern Ireland", "GB"), ("Mexico City", "MX_center"),
     ("turkey", "TR"), ("276", "DE"), ("deutschland", "DE")],
)  # fmt: skip
def test_a_country_resolves_by_any_of_its_names(text, code):
    assert load_fleet(text).code == code


def test_the_code_that_a_report_says_names_the_fleet():
    """That of a part in mixed case, such as JP_Tokyo, was refused."""
    document = json.loads((Path(orthoscale.__file__).parent / "data" / "fleets.json").read_text())
    codes = [code for table in ("fleets", "parts", "fallback") for code in document[table] if code != "WORLD"]
    assert len(codes) > 200 and all(load_fleet(name).code == code for code in codes for name in (code, code.lower()))


def test_every_inhabited_country_has_a_fleet():
    from babel import Locale

    nobody_drives_there = {"AQ", "BV", "CP", "GS", "HM"}
    no_country = {"CQ", "DG", "EZ", "QO", "UN", "XA", "XB", "ZZ"}  # parts of others, unions, placeholders of CLDR
    codes = {c for c in Locale("en").territories if len(c) == 2 and c.isalpha()} - nobody_drives_there - no_country
    assert len(codes) > 245 and all(load_fleet(code).mean[0] > 3.5 for code in codes)


UN_MEMBERS = (
    "AD AE AF AG AL AM AO AR AT AU AZ BA BB BD BE BF BG BH BI BJ BN BO BR BS BT BW BY BZ CA CD CF CG CH CI CL CM "
    "CN CO CR CU CV CY CZ DE DJ DK DM DO DZ EC EE EG ER ES ET FI FJ FM FR GA GB GD GE GH GM GN GQ GR GT GW GY HN "
    "HR HT HU ID IE IL IN IQ IR IS IT JM JO JP KE KG KH KI KM KN KP KR KW KZ LA LB LC LI LK LR LS LT LU LV LY MA "
    "MC MD ME MG MH MK ML MM MN MR MT MU MV MW MX MY MZ NA NE NG NI NL NO NP NR NZ OM PA PE PG PH PK PL PT PW PY "
    "QA RO RS RU RW SA SB SC SD SE SG SI SK SL SM SN SO SR SS ST SV SY SZ TD TG TH TJ TL TM TN TO TR TT TV TZ UA "
    "UG US UY UZ VC VE VN VU WS YE ZA ZM ZW "
)


def test_every_member_of_the_united_nations_resolves_by_its_name_and_its_codes():
    """The 193 since 2011, by their ISO 3166 codes."""
    from babel import Locale
    from babel.core import get_global

    english = Locale("en").territories
    three = {codes[0]: alias for alias, codes in get_global("territory_aliases").items() if len(alias) == 3}
    members = UN_MEMBERS.split()
    assert len(members) == len(set(members)) == 193
    for code in members:
        fleet = load_fleet(code)
        assert load_fleet(english[code]).mean == pytest.approx(fleet.mean), code
        if code in three and three[code].isalpha():
            assert load_fleet(three[code]).mean == pytest.approx(fleet.mean), code


def test_a_country_without_a_fleet_takes_a_neighbours_or_its_regions_less_certain_and_says_so():
    kuwait, gulf = load_fleet("Kuwait"), load_fleet("GCC")
    assert (kuwait.mean == gulf.mean).all() and "no fleet of its own" in kuwait.name and "Gulf" in kuwait.name
    assert (kuwait.mean_sd**2 - gulf.mean_sd**2)[:2] == pytest.approx([0.1**2, 0.03**2])
    iceland, region = load_fleet("IS"), load_fleet("R_WEU")
    assert (iceland.mean_sd == region.mean_sd).all() and region.mean_sd[0] > 2 * load_fleet("DE").mean_sd[0]


def test_a_misspelt_country_is_refused_with_the_nearest_names():
    with pytest.raises(UsageError, match=r"Germany \(DE\)"):
        load_fleet("Germny")
    with pytest.raises(UsageError, match=r"\(CD\).*\(CG\)"):
        load_fleet("Congo")
    with pytest.raises(UsageError, match="--registrations"):
        load_fleet("data/register.csv")
    with pytest.raises(UsageError, match=r"Germany \(DE\)"):
        load_fleet("Germny/")
    with pytest.raises(UsageError) as caught:
        load_fleet("AQ")
    assert "Did you mean" not in caught.value.hint, "it is what was asked for"


@pytest.mark.parametrize("text", ["Eurozon", "Germny", "Congo", "Antarctic", "United Nation", "Texs", "Bouvet Ilands"])
def test_what_a_hint_proposes_is_taken(text):
    """``Europe`` was answered with ``eurozone (EZ)``, of which there is no fleet either."""
    with pytest.raises(UsageError) as caught:
        load_fleet(text)
    for code in re.findall(r"\((\w+)\)", caught.value.hint):
        assert load_fleet(code).code


def test_europe_is_a_fleet():
    assert load_fleet("Europe").code == load_fleet("European Union").code == "EU"


@pytest.mark.parametrize("several", ["US,CA", "US; DE", "DE/FR", "CA,US", "US,DE"])
def test_several_countries_are_none(several):
    """``US,CA`` was taken for California."""
    with pytest.raises(UsageError, match="of one country"):
        load_fleet(several)


def test_a_country_that_is_called_as_a_state_says_so():
    assert "US_GA" in load_fleet("Georgia").name and "US_" not in load_fleet("Armenia").name


@pytest.mark.parametrize(
    ("place", "code"),
    [((120.98, 14.6), "PH"), ((7.59, 47.56), "CH"), ((-106.45, 31.7), "MX"), ((114.17, 22.3), "HK"), ((-30, 30), None),
     ((21.17, 42.66), "XK"), ((20.74, 42.21), "XK"), ((20.87, 42.89), "XK"),
     ((21.9, 43.32), "RS"), ((20.46, 44.8), "RS"), ((21.65, 42.31), "RS"),
     ((200, 0), None)],
)  # fmt: skip
def test_a_place_on_the_earth_has_a_country(place, code):
    assert country_at(*place) == code


def test_a_fleet_of_ones_own(tmp_path):
    entry = {"name": "taxis", "length": [4.8, 0.1], "width": [1.8, 0.02], "height": [1.5, 0.05],
             "mean_sd": [0.01, 0.01, 0.01], "corr_LW": 0.5, "source": "the depot"}  # fmt: skip
    path = tmp_path / "taxis.json"
    path.write_text(json.dumps(entry))
    assert load_fleet(path).mean.tolist() == [4.8, 1.8, 1.5]
    (tmp_path / "TAXIS.JSON").write_text(json.dumps(entry))
    assert load_fleet(tmp_path / "TAXIS.JSON").mean.tolist() == [4.8, 1.8, 1.5]
    del entry["mean_sd"]
    path.write_text(json.dumps(entry))
    with pytest.raises(InputError, match="mean_sd"):
        load_fleet(path)


def test_a_fleet_of_ones_own_may_be_given_by_the_shares_of_its_segments(tmp_path):
    entry = {"name": "campus", "length": [4.2, 0.4], "width": [1.75, 0.08], "height": [1.5, 0.1], "source": "counted",
             "mean_sd": [0.05, 0.02, 0.03], "shares": {"mini": 30, "compact hatch": 70}}  # fmt: skip
    path = tmp_path / "campus.json"
    path.write_text(json.dumps(entry))
    mini, compact = load_fleet(path).classes
    assert (mini.name, compact.name) == ("mini", "compact") and mini.weight == pytest.approx(0.3)
    assert 0.3 * mini.mean + 0.7 * compact.mean == pytest.approx([4.2, 1.75, 1.5])
    for name in ("campus.json", "campus: mine.json"):
        path = path.rename(tmp_path / name)
        assert load_fleet(f"{path}:mini").classes[0].weight == pytest.approx(0.7)
    entry["shares"]["rickshaw"] = 5
    path.write_text(json.dumps(entry))
    with pytest.raises(InputError, match="rickshaw"):
        load_fleet(path)


def test_a_place_of_which_nothing_is_known_is_in_a_country_of_many_vehicles():
    world = load_fleet("world")
    assert load_fleet("auto").prior == world.prior
    prior = {fleet.code: p for fleet, p in zip(world.candidates, world.prior, strict=True)}
    assert sum(prior.values()) == pytest.approx(1) and len(prior) == 84
    # USA: 20 % of the vehicles and 4 % of the people. India: 3 and 19 %. Rwanda: next to none of either.
    assert prior["US"] == pytest.approx(0.9 * (0.7 * 0.2 + 0.15 * 0.04), abs=0.01)
    assert prior["IN"] == pytest.approx(0.9 * (0.7 * 0.03 + 0.15 * 0.19), abs=0.01)
    assert prior["RW"] == pytest.approx(0.9 / 83 * 0.15, rel=0.4)


def test_what_is_unknown_does_not_depend_on_how_many_are_seen():
    world, germany = load_fleet("WORLD"), load_fleet("DE")
    assert world.log_mean_covariance[0, 0] > 3 * germany.log_mean_covariance[0, 0]


def test_the_worse_a_countrys_mix_is_known_the_less_a_place_is_held_to_it():
    """One sigma of a share of 0.2 at a place: what places differ by, and what is not known of the country."""
    from orthoscale.core.market_segments import PLACE_VEHICLES

    assert np.allclose(replace(load_fleet("KR"), shares_sd=0.0).place_vehicles, PLACE_VEHICLES)
    for code, relative in (("KR", 0.12), ("CH", 0.25), ("KE", 0.35), ("UG", 0.5)):
        assert load_fleet(code).shares_sd == relative, "by the grade of its row"
        for here, usual in zip(load_fleet(code).place_vehicles, PLACE_VEHICLES, strict=True):
            assert 0.16 / (here.vehicles + 1) == pytest.approx(0.16 / (usual.vehicles + 1) + (0.2 * relative) ** 2)
            assert here[1:] == usual[1:]
    graded = [code for code in fleet_codes() if not load_fleet(code).shares_sd]
    assert graded == ["PAPER", "WORLD"], "fleets that are no country's have no grade"


def test_at_an_odd_place_four_vehicles_of_five_are_of_any_class():
    from orthoscale.core.market_segments import PLACE_VEHICLES

    usual, odd = (kind.shares(np.array([0.03, 0.17, 0.8])) for kind in PLACE_VEHICLES)
    assert usual == pytest.approx([0.03, 0.17, 0.8])
    assert odd == pytest.approx([0.2 * 0.03 + 0.8 / 3, 0.2 * 0.17 + 0.8 / 3, 0.2 * 0.8 + 0.8 / 3])


def test_a_place_where_most_are_of_one_class():
    germany, minis = load_fleet("DE"), load_fleet("Deutschland: Mini")
    assert minis.code == "DE:mini" and minis.country == "DE" and "most are of the class mini" in minis.name
    share = {c.name: c.weight for c in minis.classes}
    assert share["mini"] == 0.7 and sum(share.values()) == pytest.approx(1)
    others = [c.weight / share[c.name] for c in germany.classes if c.name != "mini"]
    assert others == pytest.approx([others[0]] * len(others)), "the rest is as in the country"
    drawn = minis.sample(np.random.default_rng(0), 40_000)
    assert minis.mean == pytest.approx(drawn.mean(0), rel=2e-3) and minis.sd == pytest.approx(drawn.std(0), rel=0.05)
    assert minis.mean_sd[0] > 1.5 * germany.mean_sd[0], "which minis they are is not known"
    assert minis.place_vehicles[0].vehicles < germany.place_vehicles[0].vehicles, "nor how many most is"


@pytest.mark.parametrize(
    ("text", "says"),
    [("DE:tram", "mini, small, compact"), ("DE:", "mini, small, compact"), ("world:mini", "Name a country"),
     ("US_pickup:pickup", "Name a country"), ("Germny:mini", "Germany"), ("C:/register.csv", "--registrations"),
     ("DE:mini:van", "COUNTRY:CLASS"), ("DE::mini", "COUNTRY:CLASS"), ("a.json:mini:van", "COUNTRY:CLASS")],
)  # fmt: skip
def test_a_class_that_a_fleet_does_not_have_is_refused_with_those_that_it_has(text, says):
    with pytest.raises(UsageError) as caught:
        load_fleet(text)
    assert says in caught.value.hint


def test_a_lot_of_minis_is_measured_right_where_the_user_says_so():
    """By the country's fleet it comes out a tenth too large, for minis have the proportions of small cars."""
    errors = {"DE": [], "DE:mini": []}
    for seed in range(4):
        lot = car_park(np.random.default_rng(seed), load_fleet("DE"), 60, 0.12, RULER, most=("mini", 0.7))
        for name, found in errors.items():
            found.append(np.log(pool(lot, load_fleet(name), RULER, "m/px").value / 0.12))
    assert abs(np.mean(errors["DE:mini"])) < 0.03 < 0.06 < np.mean(errors["DE"])


def test_that_most_are_minis_is_proposed_to_the_user_where_it_may_be():
    said = {None: [], ("mini", 0.7): []}
    for most, lots in said.items():
        for seed in range(5):
            lot = car_park(np.random.default_rng(seed), load_fleet("DE"), 60, 0.12, RULER, most=most)
            lots += [remark.text for remark in proposed_class(lot, load_fleet("DE"), RULER)]
            for named in ("DE:mini", "world", "US_pickup"):
                assert not [r for r in proposed_class(lot, load_fleet(named), RULER) if "class mini" in r.text]
    assert not said[None] and len(said["mini", 0.7]) > 2
    assert all("of the class mini" in text and text.endswith("--fleet DE:mini") for text in said["mini", 0.7])


def test_the_proposed_class_is_named_as_the_user_named_the_fleet():
    """It was named after the stem of the fleet's file, which names no fleet."""
    ours = replace(load_fleet("DE"), code="our fleet")
    lot = car_park(np.random.default_rng(2), ours, 60, 0.12, RULER, most=("mini", 0.7))
    (remark,) = proposed_class(lot, ours, RULER, named="a/our fleet.json")
    assert remark.text.endswith("--fleet 'a/our fleet.json:mini'")


def test_three_wheelers_stand_among_the_cars_of_the_countries_that_have_them():
    for code, share in (("LK", 0.25), ("NP", 0.12), ("MZ", 0.05)):  # MZ has a region's cars and its own three-wheelers
        fleet = load_fleet(code)
        assert fleet.three_wheelers.weight == share and fleet.three_wheelers is fleet.told_apart[-1]
        assert sum(c.weight for c in fleet.told_apart) == pytest.approx(1)
        assert 2.6 < fleet.three_wheelers.mean[0] < 2.9 < min(c.mean[0] for c in fleet.classes)
    assert load_fleet("DE").three_wheelers is None and load_fleet("R_SAS").three_wheelers is None
    document = json.loads((Path(orthoscale.__file__).parent / "data" / "fleets.json").read_text())
    for code in document["three_wheelers"]["shares"]:
        assert load_fleet(code).three_wheelers is not None


def test_parts_of_a_country_have_its_vehicles_in_other_shares():
    country = load_fleet("US")
    states = [load_fleet(code) for code in ("Wyoming", "Texas", "Ohio", "New York")]
    lengths = [fleet.mean[0] for fleet in states]
    assert lengths == sorted(lengths, reverse=True) and lengths[0] > country.mean[0] > lengths[-1]
    for fleet in states:
        assert sum(c.weight for c in fleet.classes) == pytest.approx(1)
        assert sum(c.weight * c.mean for c in fleet.classes) == pytest.approx(fleet.mean)
        assert (fleet.mean_sd == country.mean_sd).all()
    # Tokyo has fewer kei cars than Japan, Okinawa more.
    kei = [min(load_fleet(code).classes, key=lambda c: c.mean[0]).weight for code in ("Tokyo", "Japan", "Okinawa")]
    assert kei == sorted(kei)
    assert load_fleet("Bangkok").mean[0] == pytest.approx(load_fleet("TH").mean[0] - 0.12, abs=0.02)


def test_errors_of_a_countrys_mean_length_and_width_go_together():
    fleet = load_fleet("DE")
    known, sure = (f.log_mean_covariance for f in (fleet, replace(fleet, mean_sd=np.zeros(3))))
    of_mean = known - sure
    sd = np.sqrt(np.diag(of_mean))
    assert sd == pytest.approx((fleet.mean_sd / fleet.mean)[:2]) and of_mean[0, 1] == pytest.approx(0.85 * sd.prod())
