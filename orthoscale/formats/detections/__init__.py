"""Detections in other programs' formats: DOTA text, COCO, GeoJSON, GeoPackage, besides our own JSON."""

from .files import FORMATS, check_name, check_pictures, load, output_of, save

__all__ = ["FORMATS", "check_name", "check_pictures", "load", "output_of", "save"]
