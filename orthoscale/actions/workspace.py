"""Workspaces in which the mapper left several models: each has its own scale."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import EvidenceDisagrees, Incomplete, InputError, MetricAlready, OrthoscaleError, TooLittleEvidence
from ..formats.names import write_json
from ..report.result import Result
from ..requests import EstimateRequest, FixRequest
from ..sources.exchange_files import find_exchange
from ..system.outputs import Outputs
from .estimate import measured, noted
from .fix import written

if TYPE_CHECKING:
    from ..core.progress import Progress

# Errors of one model that do not affect the others.
OF_ONE = (TooLittleEvidence, EvidenceDisagrees, InputError, MetricAlready)


@dataclass(frozen=True)
class ModelOutcome:
    """The outcome for one model: its result, or why it has none; both if a file beside its copy is missing."""

    model: Path
    result: Result | None
    error: OrthoscaleError | None

    def document(self) -> dict[str, Any]:
        """As plain values, for models.json."""
        if self.result is None:
            assert self.error is not None, "it is one of the two"
            return {"model": str(self.model), "error": str(self.error), "exit_code": self.error.exit_code}
        missing = {"missing": self.error.message} if self.error else {}
        return {"model": str(self.model), **self.result.scale.document(), **missing}


def models_in(path: Path) -> list[Path]:
    """The models of the workspace `path`, in the order of their names; empty if there are not several, or for a
    file."""
    if not path.is_dir() or find_exchange(path) is not None:
        return []
    from ..sources.colmap_find import model_folders

    folders = model_folders(path)
    return folders if len(folders) > 1 else []


def estimate_all(models: list[Path], request: EstimateRequest, progress: Progress | None = None) -> list[ModelOutcome]:
    """`estimate` for each of `models`. Raises the first error if none has a scale."""
    request = replace(request, alone=len(models) == 1)

    def estimated(model: Path) -> Result:
        return noted(measured(model, request, progress))

    return _checked([_one(model, partial(estimated, model)) for model in models])


def fix_all(
    models: list[Path],
    out: Path,
    request: FixRequest,
    workspace: Path | None = None,
    progress: Progress | None = None,
) -> list[ModelOutcome]:
    """`fix` for each of `models`, into folders of their names in the folder `out`, with models.json beside them.

    A model that has too little or contradictory evidence, is damaged, or is in metres already is left out and does not
    stop the others. workspace : the folder they were found in, which is protected like the models.
    Raises the first error if none has a scale; then nothing is written. Raises Incomplete, with the outcomes, if a file
    beside a model could not be made.
    """
    with Outputs(request.overwrite, (workspace, models, request.inputs)) as outputs:
        folder = outputs.folder(out)
        # Nothing can be in a new folder.
        fresh = replace(request, overwrite=False, alone=len(models) == 1)
        outcomes = _checked(
            [_one(model, partial(written, model, folder / model.name, fresh, progress)) for model in models]
        )
        text = {outcome.model.name: outcome.document() for outcome in outcomes}
        write_json(text, folder / "models.json")
    missing = [outcome.error for outcome in outcomes if isinstance(outcome.error, Incomplete)]
    if missing:
        raise Incomplete("; ".join(error.message for error in missing), missing[0].hint, outcomes)
    return outcomes


def _one(model: Path, do: Callable[[], Result]) -> ModelOutcome:
    try:
        return ModelOutcome(model, do(), None)
    except Incomplete as error:
        return ModelOutcome(model, error.result, error)
    except OF_ONE as error:
        return ModelOutcome(model, None, error)


def _checked(outcomes: list[ModelOutcome]) -> list[ModelOutcome]:
    if all(outcome.result is None for outcome in outcomes):
        raise next(outcome.error for outcome in outcomes if outcome.error is not None)
    return outcomes
