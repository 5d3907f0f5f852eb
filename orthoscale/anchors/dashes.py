"""Broken lane lines, by the period of their dashes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..core.anchors import Anchor, Standard, holding
from .chains import Chain, find_chains, levels
from .repeated import anchor_of
from .rules import ruled, shares_by_country, sizes, within_reach
from .strokes import find_strokes, paint_light, painted

LANE_PAINTED = 0.01  # relative 1 sigma of a line's mean period about its rule: 68 of 81 American lines are within 1.2 %
LANE_FALSE = 0.07  # six of 81 American lines are off by 3 to 11 %: painted to no rule, or two lines merged into one


POLAND = "speeds by brd.szkola.pl and droga.zut.edu.pl; lengths recalled"


def _line(
    dash: float, gap: float, where: str, source: str, countries: str, prior: float = 1.0
) -> tuple[float, Standard]:
    """Length of the dash [m] and standard."""
    name = f"dashes {dash:g} m, gaps {gap:g} m: {where}"
    known = source != POLAND
    return dash, Standard(name, dash + gap, LANE_PAINTED, source, prior, tuple(countries.split()), known)


CALIFORNIA = "48 ft from mark to mark, Orange County Register 2018 (govtech.com); 12 ft of it paint recalled"

LANE_LINES = (
    _line(3.048, 9.144, "lane and centre lines", "MUTCD 2009 3A.06: 10 ft and 30 ft", "US"),
    _line(3.6576, 10.9728, "Californian freeways", CALIFORNIA, "US", 0.15),
    _line(6, 12, "motorways", "RMS (Germany), colliseum.eu; BoMaVO (Austria), helmutobermayer.at", "DE AT"),
    _line(4, 8, "rural roads", "RMS (Germany), stroke to gap 1:2", "DE", 0.7),
    _line(3, 6, "towns", "RMS (Germany), colliseum.eu: strokes of 3 m in towns, 1:2", "DE"),
    _line(3, 3, "junctions, towns", "RMS (Germany): 1:1 at junctions; BoMaVO (Austria)", "DE AT", 0.7),
    _line(1.5, 1.5, "through junctions", "RMS (Germany), as lines of Munich show", "DE", 0.4),
    _line(6, 9, "rural roads", "BoMaVO (Austria), helmutobermayer.at", "AT"),
    _line(6, 9, "60 km/h and more", "GB 51038-2015 12.3.2 (China)", "CN"),
    _line(2, 4, "below 60 km/h", "GB 51038-2015 12.3.2 (China)", "CN"),
    _line(3, 6, "elevated and fast urban roads", "hold-in.cn on Chinese practice", "CN", 0.3),
    _line(8, 12, "expressways", "order on road signs (Japan), driveplaza.com", "JP KR", 0.7),
    _line(5, 5, "other roads", "order on road signs (Japan), bike-news.jp", "JP"),
    _line(3, 5, "towns", "road marking manual (Korea), wiki1.kr", "KR"),
    _line(5, 8, "rural roads", "road marking manual (Korea), wiki1.kr", "KR", 0.7),
    _line(10, 10, "motorways", "20 m in all, cafe.daum.net; 10 m of it paint recalled", "KR", 0.7),
    _line(2, 4, "centre lines to 40 mph", "Traffic Signs Manual 5 table 4-1, diagram 1008", "GB"),
    _line(1, 5, "lane lines to 40 mph", "Traffic Signs Manual 5 table 4-2, diagram 1005", "GB", 0.7),
    _line(3, 6, "centre lines above 40 mph", "Traffic Signs Manual 5 table 4-1, diagram 1008.1", "GB"),
    _line(2, 7, "lane lines above 40 mph", "Traffic Signs Manual 5 table 4-2, diagram 1005.1", "GB"),
    _line(4, 2, "warning to 40 mph", "Traffic Signs Manual 5 para 4.4: the inverse of 1008", "GB", 0.7),
    _line(6, 3, "warning above 40 mph", "Traffic Signs Manual 5 para 4.4: the inverse of 1008.1", "GB", 0.7),
    _line(4.5, 7.5, "above 110 km/h", "DPR 495/1992 art. 138 (Italy)", "IT"),
    _line(3, 4.5, "50 to 110 km/h", "DPR 495/1992 art. 138 (Italy)", "IT"),
    _line(3, 3, "to 50 km/h", "DPR 495/1992 art. 138 (Italy)", "IT"),
    _line(5, 12, "above 100 km/h", "Norma 8.2-IC M-1.1 (Spain)", "ES"),
    _line(3.5, 9, "60 to 100 km/h", "Norma 8.2-IC M-1.2 (Spain)", "ES"),
    _line(2, 5.5, "to 60 km/h", "Norma 8.2-IC M-1.3 (Spain)", "ES"),
    _line(3, 10, "T1", "IISR part 7 art. 113 (France): multiples of 13 m", "FR"),
    _line(1.5, 5, "T'1", "IISR part 7 art. 113 (France): multiples of 13 m", "FR", 0.7),
    _line(3, 9, "roads", "RONA (Netherlands), wegenwiki.nl; 164/1992 (Finland) 26; Sweden 1:3", "NL FI SE NO"),
    _line(1, 3, "towns", "164/1992 (Finland) 26; theoriecursus.nl", "NL FI", 0.7),
    _line(3, 7, "roads", "NZTA TCD manual part 5 table 2-28", "NZ"),
    _line(3, 9, "roads", "lists of markings in Victoria, 2018 to 2024 (services2.arcgis.com): 9 m x 3 m", "AU"),
    _line(2, 6, "to 60 km/h", "GOST R 51256, line 1.5: 1:3, dashes of 1 to 3 m", "RU BY UA KZ", 0.5),
    _line(1, 3, "to 60 km/h", "GOST R 51256, line 1.5: 1:3, dashes of 1 to 3 m", "RU BY UA KZ", 0.5),
    _line(3, 9, "above 60 km/h", "GOST R 51256, line 1.5: 1:3, dashes of 3 to 4 m", "RU BY UA KZ"),
    _line(4, 12, "above 60 km/h", "GOST R 51256, line 1.5: 1:3, dashes of 3 to 4 m", "RU BY UA KZ", 0.5),
    _line(4, 8, "P-1a, above 70 km/h", POLAND, "PL"),
    _line(2, 4, "P-1b, to 70 km/h", POLAND, "PL"),
)

PAINTED_SHARE = {standard.name: dash / standard.metres for dash, standard in LANE_LINES}  # by names of standards
ANY_SHARE = 0.12, 0.7  # limits of the share of paint where a standard does not give it

LANE_LINE_SIGMA = 0.09  # [m] one sigma of the ridge filter: lines are 0.10 to 0.15 m wide
LANE_THINNEST = 0.8  # [px] least value of that sigma
LANE_FEWEST = 5  # dashes
LANE_LENGTHS = 0.8, 1.2  # of the shortest and the longest dash of the standards: limits of a stroke's length
LANE_FILLED = 0.55  # least share of the row's places that have a dash: vehicles hide some
LANE_REGULAR = 3.5  # least `Row.regularity`: natural logarithm of the likelihood ratio of a row to chance
LANE_UNEVEN = 0.2  # of the median length: most that the lengths may scatter, one sigma
DASH_SD, DASH_DOUBT_PX = 0.06, 1.5  # of a dash's length about its rule, relative one sigma; largest error of measuring
LANE_CONTRAST = 12.0  # [grey levels] least contrast of dashes to the ground beside them
LANE_SAME_GROUND = 0.35  # of the contrast: most that the ground in the gaps may differ from that beside the dashes
LANE_ASIDE = 0.5  # [m] beside the dashes, where that ground is sampled


@dataclass(frozen=True)
class LaneDashes:
    """Finds broken lane lines (an `AnchorFinder`) of any of the `standards`."""

    standards: tuple[Standard, ...] = tuple(standard for _, standard in LANE_LINES)
    kind = "lane dashes"
    extent = 90.0
    finest = 0.10
    coarsest = 0.36

    def find(self, image: np.ndarray, gsd: float, gsd_sd: float, country: str) -> Sequence[Anchor]:
        """See `AnchorFinder.find`."""
        known = ruled(self.standards, country)
        if country and not known:  # another country's rule may fit by chance: for Banepa's lines one did, 8 % off
            return []
        standards = holding(self.standards, country) if known else split_by_country(self.standards)
        low, high = sizes(standards, gsd, gsd_sd)
        slack = low * gsd / min(standard.metres for standard in standards)
        dashes = [each.metres * share for each in standards for share in _shares(each)]
        shortest, longest = min(dashes) * LANE_LENGTHS[0] * slack / gsd, max(dashes) * LANE_LENGTHS[1] / slack / gsd
        if min(image.shape[:2]) < shortest:
            return []
        strokes = find_strokes(paint_light(image), max(LANE_LINE_SIGMA / gsd, LANE_THINNEST), shortest)
        found = []
        for chain in find_chains(strokes[strokes.length < longest], low, high, LANE_FEWEST):
            meant = within_reach(_like(standards, chain), chain.row.period, gsd, gsd_sd)
            if meant and _is_line(image, chain, gsd):
                line = anchor_of(chain, self.kind, meant, LANE_FALSE)
                found.append(line if known else replace(line, unlike=_unlike(standards, meant)))
        return found


def split_by_country(standards: Sequence[Standard]) -> list[Standard]:
    """Each of `standards` once for each country that it names; its prior is its share among that country's rules."""
    return [
        replace(standard, countries=(country,), prior=share)
        for country, shares in shares_by_country(standards).items()
        for standard, share in shares.items()
    ]


def _unlike(standards: Sequence[Standard], meant: Sequence[Standard]) -> tuple[str, ...]:
    """The countries that `standards` name but none of `meant` does."""
    like = {code for standard in meant for code in standard.countries}
    return tuple(sorted({code for standard in standards for code in standard.countries} - like))


def _shares(standard: Standard) -> tuple[float, float]:
    """The least and the greatest share of paint of a line built to `standard`."""
    share = PAINTED_SHARE.get(standard.name)
    return ANY_SHARE if share is None else (share, share)


def _like(standards: Sequence[Standard], chain: Chain) -> list[Standard]:
    """The standards with the chain's share of paint; to compare it needs no scale."""
    seen, doubt = chain.length / chain.row.period, DASH_DOUBT_PX / chain.row.period
    like = []
    for standard in standards:
        least, greatest = _shares(standard)
        if least * (1 - 2 * DASH_SD) - doubt < seen < greatest * (1 + 2 * DASH_SD) + doubt:
            like.append(standard)
    return like


def _is_line(image: np.ndarray, chain: Chain, gsd: float) -> bool:
    """Whether the dashes are equal and painted, with the same ground in the gaps as left and right of the dashes."""
    if chain.row.filled < LANE_FILLED or chain.row.regularity < LANE_REGULAR:
        return False
    if np.std(chain.strokes.length) > LANE_UNEVEN * chain.length:
        return False
    seen = levels(image, chain, LANE_ASIDE / gsd)
    paint, gap, sides = np.median(seen.paint, axis=0), np.median(seen.gap, axis=0), np.median(seen.side, axis=1)
    ground = sides.mean(0)
    contrast = float((paint - ground)[:2].mean())
    off = max(float(np.abs(gap - side)[:2].mean()) for side in sides)
    return contrast > LANE_CONTRAST and off < LANE_SAME_GROUND * contrast and painted(paint, ground)
