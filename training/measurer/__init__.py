"""The measurer: a second network that looks at each detected vehicle once more and locates its four edges.

`rendered` makes pictures with exact edges, `chain` simulates cameras and image processing, `crops` makes the examples,
`network` is the model and its likelihood; `train`, `export` and `evaluate` are programs. See README.md.
"""
