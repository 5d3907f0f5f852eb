"""The parts of glTF files that contain lengths."""

from __future__ import annotations

from typing import Annotated, Any

from msgspec import Meta, Struct

from .values import Count, Finite


class GltfAsset(Struct):
    """Metadata; its ``extras``, which may be anything, hold the mark of a scene in metres."""

    extras: Any = None


class GltfNode(Struct):
    """A node, by the indices of its children."""

    children: list[Count] = []


class GltfPlacedNode(GltfNode):
    """A node and its mesh, with its transform: a matrix, column by column, or its parts; the rotation is a quaternion,
    xyzw."""

    mesh: Count | None = None
    skin: Count | None = None
    matrix: Annotated[list[Finite], Meta(min_length=16, max_length=16)] | None = None
    translation: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)
    rotation: tuple[Finite, Finite, Finite, Finite] = (0.0, 0.0, 0.0, 1.0)
    scale: tuple[Finite, Finite, Finite] = (1.0, 1.0, 1.0)


class GltfScene(Struct):
    """A scene, by the indices of its root nodes."""

    nodes: list[Count] = []


class GltfPart(Struct):
    """A buffer or an image."""

    uri: str | None = None


class GltfCentre(Struct):
    """The centre in 3D Tiles, which is added to all positions after the nodes' transforms."""

    center: tuple[Finite, Finite, Finite]


class GltfView(Struct):
    """A camera's clipping distances, and the width and height it shows if it is orthographic."""

    xmag: float | None = None
    ymag: float | None = None
    znear: float | None = None
    zfar: float | None = None


class GltfCamera(Struct):
    """A camera, either orthographic or perspective."""

    orthographic: GltfView | None = None
    perspective: GltfView | None = None


class GltfLight(Struct):
    """A light and its range."""

    range: float | None = None


class GltfLights(Struct):
    """The lights of KHR_lights_punctual."""

    lights: list[GltfLight] = []


class GltfVolume(Struct):
    """The distance over which a material attenuates light."""

    attenuationDistance: float | None = None


class GltfMaterialExtensions(Struct):
    """The extensions of a material that contain lengths."""

    KHR_materials_volume: GltfVolume | None = None


class GltfMaterial(Struct):
    """The part of a material that contains lengths."""

    extensions: GltfMaterialExtensions | None = None


class GltfExtensions(Struct):
    """The extensions of a whole file that contain lengths."""

    CESIUM_RTC: GltfCentre | None = None
    KHR_lights_punctual: GltfLights | None = None


class Gltf(Struct):
    """The parts of a glTF 2.0 file's JSON that are needed to scale it."""

    asset: GltfAsset
    nodes: list[GltfNode] = []
    scenes: list[GltfScene] = []
    buffers: list[GltfPart] = []
    images: list[GltfPart] = []
    cameras: list[GltfCamera] = []
    materials: list[GltfMaterial] = []
    extensions: GltfExtensions | None = None


class GltfPrimitive(Struct):
    """A part of a mesh: the accessors of what its vertices have."""

    attributes: dict[str, Count] = {}
    extensions: dict[str, Any] = {}


class GltfMesh(Struct):
    """A mesh by its parts."""

    primitives: list[GltfPrimitive] = []


class GltfAccessor(Struct):
    """A table of numbers in a part of a buffer."""

    componentType: int
    count: Count
    bufferView: Count | None = None
    byteOffset: Count = 0
    sparse: Any = None


class GltfBufferView(Struct):
    """A part of a buffer."""

    buffer: Count
    byteOffset: Count = 0
    byteStride: Count | None = None
    extensions: dict[str, Any] = {}


class GltfGeometry(Struct):
    """The parts of a glTF 2.0 file's JSON that say where its vertices are."""

    nodes: list[GltfPlacedNode] = []
    meshes: list[GltfMesh] = []
    accessors: list[GltfAccessor] = []
    bufferViews: list[GltfBufferView] = []
    buffers: list[GltfPart] = []
    extensions: GltfExtensions | None = None
