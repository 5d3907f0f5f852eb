"""A fleet from a register of vehicles: how many there are of each model, and how large each model is.

Sizes are those of ``data/models.json``: about 680 generations of models. A register names a model, but seldom its
generation. So a model has the mean size of its generations, with their spread as an error that does not average out
over many vehicles.
"""

from __future__ import annotations

import csv
import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from .core.market_segments import AXES
from .errors import InputError, TooLittleEvidence, shown
from .formats.reading import read_table, refuse_repeated, shipped

HEADINGS = {  # names that a column may have, in lower case without accents
    "make": ("make", "brand", "marke", "hersteller", "marque", "marca", "merk", "manufacturer", "handelsbenaming merk"),
    "model": ("model", "modell", "modelo", "modele", "modello", "type", "typ", "handelsbenaming", "name", "vehicle"),
    "count": ("count", "number", "anzahl", "nombre", "cantidad", "numero", "aantal", "vehicles", "units", "total", "n"),
}
HINT = "Expected a table with a header and the columns model and count (and make), separated by commas, ; or tabs."
# Thousands may be separated by a point, a comma, an apostrophe, an underscore or a space; a spreadsheet may add ",0".
WHOLE_COUNT = re.compile(r"(?P<figures>\d{1,3}(?:[.,' _\u00a0\u202f]\d{3})+|\d+)(?:[.,]0{1,2})?")
CLASS_WORDS = {"klasse": "class", "classe": "class", "clase": "class"}  # Mercedes' C-Klasse
LEAST_KNOWN = 0.6  # share of the vehicles whose model must be in the table
# Standard deviation between the versions of one model [m]; and of errors common to all published sizes [m]. Length,
# width and height; as in the fleet table.
VERSIONS = np.array([0.04, 0.015, 0.025])
COMMON = np.array([0.025, 0.012, 0.015])
CORRELATION = 0.6  # of length and width within a class; that of the fleet table's segments
# Words after a model's name in the table that give its generation, market or body: Corolla E120, Camry old, HR-V TW.
GENERATION = re.compile(r"old|new|mid|mx|us|kr|tw|th|tn|nz|eg|ec|ar|br|pk|in|hb|sd|i{1,3}|iv|mk\d|[a-z]\d{1,3}|v8|\d")
BODY_WORDS = {"kombi", "combi"}  # mean an estate, or a model of van if no other model is named
SERIES = {"cx", "grand", "id", "mark", "model"}  # not a model without the next word: CX-5, Grand i10, ID.4, Model 3


@dataclass(frozen=True)
class Registered:
    """entry : the fleet, as in a fleet file. vehicles : number in the register. known : share of them whose model is in
    the table of models. unknown : the other models with their shares, the most common first."""

    entry: dict[str, Any]
    vehicles: float
    known: float
    unknown: tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class Model:
    """class_ : its market segment. size, spread : (3,) mean and standard deviation over its generations [m].
    makes : those that sell it, in lower-case ASCII; empty where the table names none."""

    class_: str
    size: np.ndarray
    spread: np.ndarray
    makes: frozenset[str]


def fleet_of_register(path: Path) -> Registered:
    """The fleet in the register at `path`, a CSV file.

    Raises InputError if it is not such a table, TooLittleEvidence if less than LEAST_KNOWN of the vehicles are of
    models whose size is known.
    """
    counted = _counted(path)
    total = sum(counted.values())
    of = {name: model_called(name) for name in counted}
    unknown = sorted(((n, c / total) for n, c in counted.items() if of[n] is None), key=lambda pair: -pair[1])
    known = 1 - sum(share for _, share in unknown)
    if known < LEAST_KNOWN:
        some = ", ".join(f"{shown(name)} {100 * share:.0f} %" for name, share in unknown[:5])
        raise TooLittleEvidence(
            f"{path}: the sizes of {100 * known:.0f} % of {total:,.0f} vehicles are known, "
            f"{100 * LEAST_KNOWN:.0f} % are needed",
            f"Not known: {some}. Name models as their makers do, without engines and trims.",
        )
    pairs = [(model, counted[name]) for name, model in of.items() if model is not None]
    models, weight = [m for m, _ in pairs], np.array([c for _, c in pairs])
    mean, sd = _moments(models, weight)
    generations = np.average([m.spread for m in models], axis=0, weights=weight)
    # The vehicles of unknown models may differ from the mean as one known model does. All of a register may be of older
    # or of newer generations, so the spread over generations does not average out.
    mean_sd = np.sqrt(COMMON**2 + generations**2 + ((1 - known) * sd) ** 2 + sd**2 / weight.sum())
    entry = {
        "name": f"vehicles of {path.name}",
        "source": f"{path.name}: {total:,.0f} vehicles, of which {100 * known:.0f} % are of models of known size",
        "shares_source": f"counted: {path.name}",
        **_plain(mean, sd),
        "mean_sd": [round(float(v), 4) for v in mean_sd],
        "mixture": _mixture(models, weight),
    }
    return Registered(entry, total, known, tuple(unknown))


def _mixture(models: Sequence[Model], weight: np.ndarray) -> list[dict[str, Any]]:
    """The classes of `models`, of which there are `weight` (N,) vehicles each, as in a fleet's entry."""
    mixture = []
    for name in sorted({m.class_ for m in models}):
        own = np.array([m.class_ == name for m in models])
        sizes = _moments([m for m in models if m.class_ == name], weight[own])
        share = round(float(weight[own].sum() / weight.sum()), 5)
        mixture.append({"class": name, "weight": share, "corr_LW": CORRELATION, **_plain(*sizes)})
    return mixture


def model_called(text: str) -> Model | None:
    """The model that a register's `text` names, with or without its make and version; None if it is not in the table.

    Of the names of models in `text` the longest counts. If `text` also names a make that is in the table, the model
    must be of that make."""
    words, makes = _words(text), _makes()
    found = []
    for start in range(len(words)):
        for end in range(start + 1, len(words) + 1):
            name = "".join(words[start:end])
            said = {word for word in words[:start] + words[end:] if word in makes}
            if name not in _models() or (said and _models()[name].makes and not said & _models()[name].makes):
                continue
            after = "".join(words[end : end + 1])
            if len(makes.get(name, ())) > 1 and not said and after[:1].isalpha() and not GENERATION.fullmatch(after):
                continue  # a make here, and its model follows: Chevy Cavalier
            found.append(name)
    if not found:
        return None
    return _models()[max(found, key=lambda name: (name not in makes, name not in BODY_WORDS, len(name)))]


def _counted(path: Path) -> dict[str, float]:
    table = read_table(path, HINT)
    columns = {" ".join(_words(name)): name for name in reversed(table.fieldnames or ())}
    if not columns:
        raise InputError(f"{path}: empty", HINT)
    at = {what: next((columns[n] for n in names if n in columns), None) for what, names in HEADINGS.items()}
    model, count, make = at["model"], at["count"], at["make"]
    if model is None or count is None:
        raise InputError(f"{path}, line {table.line_num}: no column {'model' if model is None else 'count'}", HINT)
    refuse_repeated(path, table, [column for column in at.values() if column is not None], HINT)
    counted: dict[str, float] = {}
    try:
        for row in table:
            said, *name = ((row[column] or "").strip() for column in (count, make, model) if column is not None)
            if not (said or any(name)):
                continue
            if not (whole := WHOLE_COUNT.fullmatch(said)):
                raise InputError(
                    f"{path}, line {table.line_num}: {shown(said) or 'nothing'} is not a whole number of vehicles", HINT
                )
            called = " ".join(name)
            counted[called] = counted.get(called, 0.0) + float(re.sub(r"\D", "", whole["figures"]))
    except csv.Error as error:
        raise InputError(f"{path}, line {table.line_num}: {error}", HINT) from error
    if not sum(counted.values()) > 0:
        raise InputError(f"{path}: counts no vehicle", HINT)
    return counted


@cache
def _models() -> dict[str, Model]:
    """Models by name, as its words joined without spaces, since a register writes CR-V, CRV or CR V."""
    generations: dict[str, list[Sequence[Any]]] = {}
    makes: dict[str, set[str]] = {}
    for name, row in shipped("models")["models"].items():
        model = _without_generation(name)
        for called in {"".join(_words(name)), model}:
            generations.setdefault(called, []).append(row)
            makes.setdefault(called, set()).update(make for make, models in _makes().items() if model in models)
    out = {}
    for called, rows in generations.items():
        sizes = np.array([row[1:] for row in rows], float)
        out[called] = Model(rows[0][0], sizes.mean(0), sizes.std(0), frozenset(makes[called]))
    return out


@cache
def _makes() -> dict[str, set[str]]:
    """Models, without their generations, by make; all in lower-case ASCII."""
    return {"".join(_words(make)): set(models) for makes, models in shipped("models")["makes"] for make in makes}


def _without_generation(name: str) -> str:
    """The `name` of a model without its generation, as joined words: Golf5 is golf. It stays whole if only a make, a
    series or a letter would be left: Mazda2, CX-5, E W210."""
    first, *rest = words = _words(name)
    while rest and GENERATION.fullmatch(rest[-1]):
        rest.pop()
    if not rest and (numbered := re.fullmatch(r"([a-z]{4,})\d{1,2}", first)):
        first = numbered[1]
    model = "".join([first, *rest])
    return "".join(words) if len(model) == 1 or model in SERIES or model in _makes() else model


def _words(text: str) -> list[str]:
    bare = (c for c in unicodedata.normalize("NFKD", text.casefold()) if not unicodedata.combining(c))
    words = re.findall(r"[a-z0-9]+", "".join(bare))
    return [CLASS_WORDS.get(word, re.sub(r"^(\d)er$", r"\1", word)) for word in words]  # BMW's 3er is the 3 series


def _moments(models: Sequence[Model], weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    sizes = np.array([m.size for m in models])
    mean = np.average(sizes, axis=0, weights=weight)
    within = VERSIONS**2 + np.array([m.spread for m in models]) ** 2
    return mean, np.sqrt(np.average((sizes - mean) ** 2 + within, axis=0, weights=weight))


def _plain(mean: np.ndarray, sd: np.ndarray) -> dict[str, list[float]]:
    return {axis: [round(float(m), 4), round(float(s), 4)] for axis, m, s in zip(AXES, mean, sd, strict=True)}
