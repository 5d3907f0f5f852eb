"""Finders of anchors, objects of standard size, one file a kind: painted courts, lane dashes, crossings, bays."""
