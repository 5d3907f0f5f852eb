"""Files of other photogrammetry programs that cannot be opened here: what to do with each instead."""

from __future__ import annotations

from pathlib import Path

METASHAPE = (
    "Metashape's own files are not read. From 2.2 on: File, Export, Export Cameras, type Colmap; before: type Bundler. "
    "Give the folder with sparse/ and images/, or the .out with --images."
)
REALITYSCAN = (
    "Projects of RealityCapture and RealityScan are not read. Export the registration as COLMAP or Bundler, and give "
    "that with --images."
)
PIX4D = "Projects of Pix4D are not read: give the orthophoto that it made."
OPENMVG = "OpenMVG's own files are not read: `openMVG_main_openMVG2Colmap -i sfm_data.bin -o model`, then give model."
MESHROOM = (
    "Meshroom's own files are not read: `aliceVision_exportColmap` makes a COLMAP model of them; give its folder."
)
OPENMVS = "OpenMVS's own files are not read: give the COLMAP, OpenMVG or OpenSfM model that they were made from."
GEOMETRY = (
    "Clouds, meshes and splats show no vehicles. Run `orthoscale fix` on the model that they were made from, then "
    "`orthoscale apply OUT/sim3.json {name} --out FOLDER`."
)
PACKED = (
    "Clouds, meshes and splats show no vehicles. As PLY, LAS or GLB, `orthoscale apply` takes them to a model's scale."
)
VIDEO = "Videos are not read: reconstruct the frames with COLMAP and give the model; or give an orthophoto."
VIDEOS = (".mp4", ".mov", ".avi", ".mkv", ".mts", ".webm")
DATABASE = "A database of COLMAP holds no model: give the folder that `colmap mapper` wrote, such as sparse/0."
ARCHIVE = "Archives are not read: unpack it, and give the file or folder inside."
CAMERAS = "It has neither picture sizes nor points: give the model that it was made from, or the orthophoto."
SIM3 = "It is the result of `orthoscale fix`, for `orthoscale apply`: give the model itself."
BY_ENDING = {
    **dict.fromkeys((".psx", ".psz"), METASHAPE),
    **dict.fromkeys((".rcproj", ".rsproj"), REALITYSCAN),
    **dict.fromkeys((".p4d", ".p4dx"), PIX4D),
    **dict.fromkeys((".sfm", ".abc", ".mg"), MESHROOM),
    ".mvs": OPENMVS,
    ".db": DATABASE,
    **dict.fromkeys((".zip", ".7z", ".rar", ".tar", ".tgz", ".gz", ".bz2", ".xz", ".zst", ".kmz"), ARCHIVE),
    **dict.fromkeys(VIDEOS, VIDEO),
    **dict.fromkeys(
        (".las", ".laz", ".ply", ".obj", ".glb", ".gltf", ".stl", ".off", ".pcd", ".pts", ".splat"), GEOMETRY
    ),
    **dict.fromkeys((".e57", ".fbx", ".ksplat", ".spz"), PACKED),
}
BY_NAME = {"sfm_data.bin": OPENMVG, "sfm_data.json": OPENMVG, "sim3.json": SIM3, "cameras.json": CAMERAS}
BY_KEY = {"sfm_data_version": OPENMVG, "featuresFolders": MESHROOM}  # by a key of the JSON
BY_ROOT = {b"<document": METASHAPE, b"<BlocksExchange": METASHAPE}  # by the root element of the XML
XML_HEAD = 4096  # [bytes] at the start of a file in which its root element is looked for
PROJECTS = (".psx", ".psz", ".rcproj", ".rsproj", ".p4d", ".p4dx", ".mg")


def what_instead(path: Path) -> str:
    """What to do with the file `path` instead of opening it as a picture; '' if unknown."""
    if hint := BY_NAME.get(path.name, BY_ENDING.get(path.suffix.lower(), "")):
        return hint.format(name=path.name)
    if path.suffix.lower() == ".xml":
        with path.open("rb") as file:
            head = file.read(XML_HEAD)
        return next((hint for root, hint in BY_ROOT.items() if root in head), "")
    return ""


def project_in(folder: Path) -> str:
    """The same for another program's project that lies in `folder`, or whose files these are (Metashape's
    NAME.files)."""
    if folder.suffix == ".files":
        return METASHAPE
    names = sorted(place for place in folder.iterdir() if place.name in BY_NAME or place.suffix.lower() in PROJECTS)
    return next((hint for place in names if (hint := what_instead(place))), "")
