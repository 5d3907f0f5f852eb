"""How the shipped detector came to be: data, augmentation, network, training, export, evaluation.

Needs PyTorch (``pip install -e .[training]``); nothing in here is imported by the ``orthoscale`` package.
"""
