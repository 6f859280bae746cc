"""Control points by hand: a page on this machine, both images side by side, a click in each makes a pair."""
