"""The tables of arXiv 2603.07535 for a user's data: altitude from vehicles against the truth, photo by photo."""
