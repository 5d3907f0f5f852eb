"""Schemas of all JSON files that orthoscale reads: types, and the ranges of plausible values.

Lengths are in metres or pixels, as each format defines. Fields that are not named here are allowed unless a schema
forbids them. These modules are imported only when a file is read, because msgspec takes time to import.
"""
