"""Which country a name or a place on the Earth belongs to.

Names and codes are those of Unicode's CLDR (package Babel): ISO 3166 codes of two and three letters and numbers, and
names in English and in the country's own languages. Places are looked up in time zone polygons (package tzfpy,
OpenStreetMap's borders); the IANA table (package tzdata) gives each zone's country. Both are read on first use.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from functools import cache
from importlib import resources

# Names that people use and CLDR does not list. Values are keys of the fleet table or ISO codes.
OTHER_NAMES = {
    "america": "US",
    "england": "GB",
    "scotland": "GB",
    "wales": "GB",
    "great britain": "GB",
    "britain": "GB",
    "europe": "EU",
    "holland": "NL",
    "turkey": "TR",
    "czech republic": "CZ",
    "ivory coast": "CI",
    "swaziland": "SZ",
    "macedonia": "MK",
    "cape verde": "CV",
    "east timor": "TL",
    "burma": "MM",
    "vatican": "VA",
    "republic of korea": "KR",
    "korea": "KR",
    "uae": "AE",
    "drc": "CD",
    "congo kinshasa": "CD",
    "congo brazzaville": "CG",
    "dr congo": "CD",
    "democratic republic of congo": "CD",
    "democratic republic of the congo": "CD",
    "republic of congo": "CG",
    "republic of the congo": "CG",
    "northern ireland": "GB",
    "united states of america": "US",
    "washington d c": "US_DC",
    "palestine": "PS",
    "state of palestine": "PS",
    # Parts of Mexico, Japan and Thailand with fleets of their own; the north of Mexico has many vehicles from the USA.
    "mexico city": "MX_center",
    "ciudad de mexico": "MX_center",
    "puebla": "MX_center",
    "merida": "MX_center",
    "yucatan": "MX_center",
    "tijuana": "MX_north",
    "monterrey": "MX_north",
    "ciudad juarez": "MX_north",
    "tokyo": "JP_Tokyo",
    "okinawa": "JP_Okinawa",
    "bangkok": "TH_Bangkok",
}
# Countries and territories whose English name takes an article.
WITH_ARTICLE = "AE AX BQ BS CC CF CK DO FK FO GB GM IM IO KM KY MH MP MV NL PH PN PS SB SC TC TF UM US VG VI"
US_STATES = """AL Alabama AK Alaska AZ Arizona AR Arkansas CA California CO Colorado CT Connecticut DE Delaware FL
Florida GA Georgia HI Hawaii ID Idaho IL Illinois IN Indiana IA Iowa KS Kansas KY Kentucky LA
Louisiana ME Maine MD Maryland MA Massachusetts MI Michigan MN Minnesota MS Mississippi MO Missouri
MT Montana NE Nebraska NV Nevada NH New_Hampshire NJ New_Jersey NM New_Mexico NY New_York NC
North_Carolina ND North_Dakota OH Ohio OK Oklahoma OR Oregon PA Pennsylvania RI Rhode_Island SC
South_Carolina SD South_Dakota TN Tennessee TX Texas UT Utah VT Vermont VA Virginia WA Washington WV
West_Virginia WI Wisconsin WY Wyoming DC District_of_Columbia"""

# Its border as longitude, latitude [degrees], to some kilometres: Natural Earth 1:110 million. Kosovo has no time zone
# of its own.
KOSOVO = (
    (20.762, 42.052), (20.717, 41.847), (20.590, 41.855), (20.523, 42.218), (20.284, 42.320), (20.071, 42.589),
    (20.258, 42.813), (20.497, 42.885), (20.635, 43.217), (20.814, 43.272), (20.957, 43.131), (21.143, 43.069),
    (21.274, 42.910), (21.439, 42.863), (21.633, 42.677), (21.775, 42.683), (21.663, 42.439), (21.543, 42.320),
    (21.577, 42.245), (21.353, 42.207),
)  # fmt: skip


def country_code(text: str) -> str | None:
    """The two-letter ISO 3166 code of the country that `text` names, or the code of a part of one (``US_TX``); None if
    it names none.

    Understood are codes of two and three letters, names in English and in the country's languages, US states by name or
    as ``US-TX``, and a few cities. Case, accents and punctuation do not matter (``U.S.A.``). The beginning of a name is
    enough if it is unique ("hong kong"). A list of countries (``US,CA``) gives None; "Georgia, USA" is the state.
    """
    wanted = _plain(text).removeprefix("the ")
    if not wanted:
        return None
    parts = _parts(text)
    if len(parts) == 2 and (code := _of_two(*parts)) is not None:
        return code
    if are_several(text):
        return None
    if len(wanted) == 2 and wanted.upper() in _in_english():  # a code; to load all names would take half a second
        return wanted.upper()
    names = _names()
    if wanted in names:
        return names[wanted]
    begun = {code for name, code in names.items() if name.startswith(wanted + " ")}
    if len(begun) == 1:
        return begun.pop()
    joined = re.sub(r"\b(\w) (?=\w\b)", r"\1", wanted)  # "u s a", from U.S.A., to "usa"
    return country_code(joined) if joined != wanted else None


def are_several(text: str) -> bool:
    """Whether `text` lists several countries: at least two of its parts name one."""
    parts = _parts(text)
    return len(parts) > 1 and sum(country_code(part) is not None for part in parts) > 1


def _parts(text: str) -> list[str]:
    return [part for part in re.split(r"[,;/]", text) if _plain(part)]


def _of_two(first: str, second: str) -> str | None:
    """The code of "STATE, USA", of "STATE, code of the state", or of an inverted name: "Korea, Republic of"."""
    state, more = _states().get(_plain(first)), _plain(second)
    code = f"US_{_plain(first).upper()}"
    if country_code(second) == "US":
        foreign = _plain(first).upper() in _in_english()  # "CA, US" may be two countries
        return state or (code if code in _states().values() and not foreign else None)
    if state is not None and state == f"US_{more.upper()}":
        return state
    if (whole := _names().get(f"{more} {_plain(first)}".removeprefix("the "))) is not None:
        return whole
    return country_code(first) if re.search(r"\bof( the)?$", more) else None


def nearest_names(text: str, known: Callable[[str], bool]) -> list[str]:
    """Up to five names that begin with `text` or are spelled like it, with their codes: ``Germany (DE)``. Only names
    whose code is `known` (to the caller) are considered."""
    wanted = _plain(text)
    names = {name: code for name, code in _names().items() if known(code)}
    words = [name for name in names if len(name) > 3]  # no codes: one that differs in a letter is another country's
    begun = [name for name in words if name.startswith(wanted + " ")]
    near = dict.fromkeys([*begun, *get_close_matches(wanted, words, n=5, cutoff=0.7)])
    return [f"{_written(name, names[name])} ({names[name]})" for name in near if name != wanted][:5]


def _written(name: str, code: str) -> str:
    """A `_plain` name of the country `code` as people write it."""
    english = country_name(code)
    return english if _plain(english) == name else name.title()


def namesake(code: str) -> str | None:
    """The code of the US state that has the same name as the country `code`: ``US_GA`` for Georgia; None for none."""
    return _states().get(_plain(country_name(code)))


def country_name(code: str) -> str:
    """The English name of the country with a two-letter ISO 3166 code, or the code itself if there is none."""
    return _in_english().get(code, code)


def with_article(code: str) -> str:
    """The name of the country as it stands in an English sentence: "the Philippines"."""
    name = country_name(code)
    return f"the {name}" if code in WITH_ARTICLE.split() else name


def country_at(longitude: float, latitude: float) -> str | None:
    """The ISO 3166 code of the country at a place [degrees, WGS 84]; None at sea and for impossible coordinates."""
    if not (-180 <= longitude <= 180 and -90 <= latitude <= 90):
        return None
    from tzfpy import get_tz

    code = _country_of_zone().get(get_tz(longitude, latitude))
    return "XK" if code == "RS" and _is_kosovo(longitude, latitude) else code


def _is_kosovo(longitude: float, latitude: float) -> bool:
    """Whether a place is inside the border: a ray from it to the east crosses that an odd number of times."""
    crossed = False
    for (x0, y0), (x1, y1) in zip(KOSOVO, (*KOSOVO[1:], KOSOVO[0]), strict=True):
        if (y0 > latitude) != (y1 > latitude) and longitude < x0 + (latitude - y0) / (y1 - y0) * (x1 - x0):
            crossed = not crossed
    return crossed


def _plain(text: str) -> str:
    """`text` in lower case, without accents and punctuation."""
    bare = (c for c in unicodedata.normalize("NFKD", text.casefold()) if not unicodedata.combining(c))
    return " ".join("".join(c if c.isalnum() else " " for c in bare).split())


@cache
def _in_english() -> Mapping[str, str]:
    """English names of countries by code, and of continents by number."""
    from babel import Locale

    names: Mapping[str, str] = Locale("en").territories
    return names


@cache
def _states() -> dict[str, str]:
    """Code of a US state by its plain name."""
    words = US_STATES.split()
    return {_plain(name): f"US_{code}" for code, name in zip(words[::2], words[1::2], strict=True)}


@cache
def _names() -> dict[str, str]:
    """Two-letter code by plain name or by code."""
    from babel import Locale, UnknownLocaleError
    from babel.core import get_global
    from babel.languages import get_official_languages

    english = _in_english()
    codes = [code for code in english if len(code) == 2 and code.isalpha()]
    found = _states() | {code.replace("_", " ").lower(): code for code in _states().values()} | OTHER_NAMES
    for code in codes:
        for language in get_official_languages(code, regional=True, de_facto=True):
            try:
                own = Locale.parse(language).territories.get(code)
            except (UnknownLocaleError, ValueError):
                continue
            if own:
                found[_plain(own)] = code
    for alias, territories in get_global("territory_aliases").items():
        if len(territories) == 1 and territories[0] in english:
            found[_plain(alias)] = territories[0]
    found |= {_plain(english[code]): code for code in codes}  # a country overrides a US state of its name: Georgia
    return found | {code.lower(): code for code in codes}


@cache
def _country_of_zone() -> dict[str, str]:
    table = (resources.files("tzdata") / "zoneinfo" / "zone.tab").read_text(encoding="utf-8")
    rows = (line.split("\t") for line in table.splitlines() if not line.startswith("#"))
    return {row[2]: row[0] for row in rows}
