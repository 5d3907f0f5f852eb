"""Where an attempt is made, and damage to one file in it."""

from __future__ import annotations

import json
import random
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from . import damage

Rng = random.Random
Mutator = Callable[[bytes, Rng, bytes], bytes]
TEXTS = (".txt", ".out", ".nvm", ".csv", ".xml", ".vrt", ".obj", ".mtl", ".pgw", ".jgw")


@dataclass(frozen=True)
class Bench:
    """`corpus` has the valid inputs; `folder` is the attempt's own."""

    corpus: Path
    folder: Path

    def take(self, kind: str, *names: str) -> Path:
        """Copy a kind, or some of its files, into the attempt's `in/`; returns that."""
        inside = self.folder / "in"
        if not names:
            shutil.copytree(self.corpus / kind, inside, dirs_exist_ok=True)
        for name in names:
            (inside / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(self.corpus / kind / name, inside / name)
        return inside

    def answer(self, kind: str) -> float:
        """The scale that the undamaged `kind` gives."""
        return json.loads((self.corpus / "answers.json").read_text())[kind]


def harm(path: Path, rng: Rng, how: Mutator, donor: Path | None = None) -> None:
    """Damage the file at `path`."""
    path.write_bytes(how(path.read_bytes(), rng, donor.read_bytes() if donor else b""))


def how_for(path: Path) -> Mutator:
    """The damage that suits a file."""
    if path.suffix in (".json", ".geojson", ".gltf"):
        return damage.json_text
    return damage.text if path.suffix in TEXTS else damage.binary


def sim3(folder: Path) -> None:
    """A sim3.json in `folder`, as `fix` would write it."""
    text = {"scale": 5.0, "rotation_wxyz": [1, 0, 0, 0], "translation": [0, 0, 0]}
    (folder / "sim3.json").write_text(json.dumps(text))
