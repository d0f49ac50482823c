"""Every file that people write: what its keys mean, and what is wrong with one that cannot be used.

numbers, errors: values and messages. names, terms: the grammar of correction terms. arm, effects, model,
space, scenario, tables, simulator: one module a kind of file. files: all kinds, and their JSON Schema.
Imports nothing of kincal.
"""
