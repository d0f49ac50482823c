"""Answers for people and programs: sentences, text, JSON, and the curves that pages draw."""
