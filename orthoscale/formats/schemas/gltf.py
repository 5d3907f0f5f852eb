"""What of glTF files carries lengths."""

from __future__ import annotations

from typing import Any

from msgspec import Struct

from .values import Count, Finite


class GltfAsset(Struct):
    """Metadata, in whose ``extras``, which may be anything, a scene in metres is marked."""

    extras: Any = None


class GltfNode(Struct):
    """Indices of the nodes below it."""

    children: list[Count] = []


class GltfScene(Struct):
    """Indices of the nodes at the top."""

    nodes: list[Count] = []


class GltfPart(Struct):
    """A buffer or an image."""

    uri: str | None = None


class GltfCentre(Struct):
    """What is added to all positions, after the nodes' transforms: of 3D Tiles."""

    center: tuple[Finite, Finite, Finite]


class GltfView(Struct):
    """How far a camera sees, and how much of the scene where it has no perspective."""

    xmag: float | None = None
    ymag: float | None = None
    znear: float | None = None
    zfar: float | None = None


class GltfCamera(Struct):
    """A camera of one of the two kinds."""

    orthographic: GltfView | None = None
    perspective: GltfView | None = None


class GltfLight(Struct):
    """How far it shines."""

    range: float | None = None


class GltfLights(Struct):
    """Those of KHR_lights_punctual."""

    lights: list[GltfLight] = []


class GltfVolume(Struct):
    """How far light goes in a material."""

    attenuationDistance: float | None = None


class GltfMaterialExtensions(Struct):
    """Those of a material that have a length."""

    KHR_materials_volume: GltfVolume | None = None


class GltfMaterial(Struct):
    """A material, as far as it has lengths."""

    extensions: GltfMaterialExtensions | None = None


class GltfExtensions(Struct):
    """Those of a whole scene that have a length."""

    CESIUM_RTC: GltfCentre | None = None
    KHR_lights_punctual: GltfLights | None = None


class Gltf(Struct):
    """The JSON of a glTF 2.0 scene, as far as scaling it needs."""

    asset: GltfAsset
    nodes: list[GltfNode] = []
    scenes: list[GltfScene] = []
    buffers: list[GltfPart] = []
    images: list[GltfPart] = []
    cameras: list[GltfCamera] = []
    materials: list[GltfMaterial] = []
    extensions: GltfExtensions | None = None
