"""The measurer: a second network that looks at each found vehicle once more and says where its four edges are.

`rendered` makes pictures with exact edges, `chain` what a camera and those who handle its pictures do to them, `crops`
the examples, `network` the model and its likelihood; `train`, `export` and `evaluate` are programs. See README.md.
"""
