"""What is known of the corpus, and how its parts are called."""

MODEL_SCALE = 5.0  # metres per unit of every reconstruction
GSD = 0.1  # of the orthophoto [m]
BOX_FORMATS = ("boxes.json", "boxes.coco.json", "boxes.geojson", "boxes.gpkg", "boxes.txt", "plain.json")
RASTERS = ("ortho.tif", "cog.tif", "strips.tif", "ortho.png", "ortho.jpg", "ortho.vrt")
MODELS = ("colmap-bin", "rig-bin", "colmap-txt", "rig-txt")
CARD = {
    "name": "tiny",
    "usable_length": [12, 90],
    "best_length": 38,
    "score": 0.5,
    "effective_height": [0.7, 0.6],
    "ruler": {"margin": [0, 0], "margin_sd": [0.7, 0.7], "noise": [2, 1.2]},
    "training": "none",
    "stride": 32,
}
