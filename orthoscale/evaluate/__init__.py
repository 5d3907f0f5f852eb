"""The tables of arXiv 2603.07535 on data that a user has: altitude by vehicles against the truth, photo by photo."""
