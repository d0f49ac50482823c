"""KinCal simulator: the truth that flight software is tested against. Loads no flight code."""
