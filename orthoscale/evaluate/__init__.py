"""The tables of arXiv 2603.07535 for data of a user: altitude from vehicles against the truth, photo by photo."""
