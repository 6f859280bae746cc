"""2keypoints, votes, probabilities and the models behind them (paper, sections 4.4 to 4.6)."""
