"""Countries' rules for zebra crossings: the period of their stripes, and the priors where no rule is known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..core.anchors import Standard
from .rules import shares_by_country

ZEBRA_PAINTED = 0.015  # relative one sigma of a crossing's period about its rule: 0.98 to 1.01 m in two Chinese towns
ZEBRA_ABOUT = 0.03  # where the rule gives a range or says "about", or where none is known


def elsewhere(rules: Sequence[Standard]) -> tuple[Standard, ...]:
    """The standards where no rule is known: the periods of `rules`, each as likely as it is among the countries that
    they name, with one vote per country. A period's sigma is that of the rules that have it (rms), at least
    ZEBRA_ABOUT."""
    countries = shares_by_country(rules)
    found = []
    for metres in sorted({rule.metres for rule in rules}):
        of_it = [
            (vote, rule.relative_sd)
            for shares in countries.values()
            for rule, vote in shares.items()
            if rule.metres == metres
        ]
        vote, sd = np.array(of_it).T
        spread = max(float(np.sqrt(np.average(sd**2, weights=vote))), ZEBRA_ABOUT)
        name = f"stripe and gap together about {metres:.2f} m"
        source = f"rules of {vote.sum():.1f} of the {len(countries)} countries above, shared where one has several"
        found.append(Standard(name, metres, spread, source, float(vote.sum()) / len(countries)))
    return tuple(found)


def _evenly(widths: Sequence[float], relative_sd: float, source: str, country: str) -> list[Standard]:
    """A rule that allows stripes and gaps from the first to the last of `widths` [m], all of which are equally
    likely."""
    return [
        Standard(
            f"stripes {width:.2f} m, gaps {width:.2f} m",
            2 * width,
            relative_sd,
            source,
            1 / len(widths),
            (country,),
        )
        for width in widths
    ]


# Where a rule gives a range, its ends and the round width between them are equally likely.
ZEBRA_RULES = (
    Standard(
        "stripes 0.50 m, gaps 0.50 m",
        1.00,
        ZEBRA_PAINTED,
        "RMS (Germany), colliseum.eu; DPR 495/1992 art. 145 (Italy), notizie.it; BoMaVO par. 16 (Austria), jusline.at",
        countries=("DE", "IT", "AT"),
    ),
    Standard(
        "stripes and gaps of about 0.50 m",
        1.00,
        ZEBRA_ABOUT,
        "ministerial order of 11 October 1976 art. 18.3 (Belgium), wegenenverkeer.be, securotheque.wallonie.be",
        countries=("BE",),
    ),
    Standard(
        "stripes 0.40 m, gaps 0.60 m",
        1.00,
        ZEBRA_PAINTED,
        "GB 5768.3 (China), hold-in.cn",
        countries=("CN",),
    ),
    *_evenly(
        (0.45, 0.50),
        ZEBRA_PAINTED,
        "order on road signs (Japan), sign 201: stripes and gaps of 45 to 50 cm; gaps of up to 90 cm, allowed since "
        "July 2024 (newsdig.tbs.co.jp), are not expected",
        "JP",
    ),
    *_evenly(
        (0.40, 0.50, 0.60), ZEBRA_ABOUT, "BABW rules of execution (Netherlands), anwb.nl: each of 0.4 to 0.6 m", "NL"
    ),
    *_evenly((0.40, 0.50), ZEBRA_ABOUT, "law 24.449 (Argentina), LEMaC at yumpu.com: 40 to 50 cm, gaps alike", "AR"),
    Standard(
        "stripes 0.50 m, gaps 0.50 m",
        1.00,
        ZEBRA_PAINTED,
        "IISR part 7 art. 118 (France): stripes of 0.50 m, 0.50 to 0.80 m apart",
        0.6,
        ("FR",),
    ),
    Standard(
        "stripes 0.50 m, gaps 0.60 to 0.80 m",
        1.20,
        0.05,
        "IISR part 7 art. 118 (France): stripes of 0.50 m, 0.50 to 0.80 m apart",
        0.4,
        ("FR",),
    ),
    Standard(
        "stripes 0.60 m, gaps 0.60 m",
        1.20,
        ZEBRA_PAINTED,
        "AS 1742 (Australia); New Zealand from 2021, Walking New Zealand 3/2021: stripes of 600 mm; National Works "
        "Agency (Jamaica), nwa.gov.jm",
        countries=("AU", "NZ", "JM"),
    ),
    Standard(
        "stripes 0.30 m, gaps 0.30 m",
        0.60,
        ZEBRA_PAINTED,
        "PM 34/2014 (Indonesia), bobo.grid.id: stripes of 30 cm, gaps alike",
        countries=("ID",),
    ),
)
ZEBRA_FREE = ("US", "CA", "GB", "IE", "MX", "CO", "BR")
"""Where the rules leave the period to the painter: MUTCD 3B.18 has bars of 12 to 24 inches, gaps of 12 to 60; TSRGD
has stripes of 500 to 715 mm; resolution 1885 of 2015 (Colombia, sojuridica.com) stripes of 40 to 50 cm, gaps of 40 to
100; CONTRAN's manual, volume IV, marking FTP-1 (Brazil) stripes of 30 to 40 cm, gaps of 30 to 80. Nothing is searched
there."""

ZEBRA_LEFT_FREE = len(ZEBRA_FREE) / len({*ZEBRA_FREE, *shares_by_country(ZEBRA_RULES)})
"""Share of the countries above whose rule leaves the period free: as probable is that where no rule is known."""

ZEBRA_STANDARDS = (*ZEBRA_RULES, *elsewhere(ZEBRA_RULES))
