"""Render a scaled orthophoto and its vehicles as QGIS shows them; needs QGIS's own Python (python3-qgis).

    QT_QPA_PLATFORM=offscreen python3 docs/make_qgis_picture.py scaled.tif docs/pictures/qgis.png

Prints what QGIS made of the layers, one line of JSON.
"""

import json
import sys

from qgis.core import (
    QgsApplication,
    QgsMapRendererParallelJob,
    QgsMapSettings,
    QgsRasterLayer,
    QgsVectorLayer,
)
from qgis.PyQt.QtCore import QSize

SIZE = (900, 640)  # [px]
PART = 0.35  # of the orthophoto's width, its middle


def main(raster_path: str, out: str) -> None:
    """Draw the middle of `raster_path` with the vehicles of the GeoPackage beside it."""
    QgsApplication.setPrefixPath("/usr", True)
    application = QgsApplication([], False)
    application.initQgis()
    print(json.dumps(drawn(raster_path, out)))
    application.exitQgis()  # when no layer is left


def drawn(raster_path: str, out: str) -> dict:
    """What QGIS made of the layers."""
    raster = QgsRasterLayer(raster_path, "orthophoto")
    vehicles = QgsVectorLayer(f"{raster_path}.gpkg|layername=vehicles", "vehicles", "ogr")
    settings = QgsMapSettings()
    settings.setLayers([vehicles, raster])
    settings.setDestinationCrs(raster.crs())
    settings.setOutputSize(QSize(*SIZE))
    extent = raster.extent()
    extent.scale(PART)
    settings.setExtent(extent)
    job = QgsMapRendererParallelJob(settings)
    job.start()
    job.waitForFinished()
    job.renderedImage().save(out)
    first = next(vehicles.getFeatures())
    return {
        "raster": raster.isValid(),
        "units_per_pixel": raster.rasterUnitsPerPixelX(),
        "vehicles": vehicles.featureCount(),
        "style": vehicles.renderer().type(),
        "inside": raster.extent().contains(vehicles.extent()),
        "length_m": first["length_m"],
    }


if __name__ == "__main__":
    main(*sys.argv[1:])
