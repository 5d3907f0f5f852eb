"""Finders of anchors, objects of standard size, by kind: painted courts, lane dashes, crossings, parking bays and
others."""
