"""How the shipped detector was made: data, augmentation, network, training, export, evaluation.

Needs PyTorch (``pip install -e .[training]``); nothing in here is imported by the ``orthoscale`` package.
"""
