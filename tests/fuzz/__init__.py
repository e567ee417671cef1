"""Damaged and strange files through the command line, from a stored corpus.

``corpus`` holds small files of every kind that OpenEXR knows; `tests.fuzz.make_corpus` made those
whose names begin with no ``mutant_``. A mutant that once broke a rule stays there as
``mutant_WHAT.exr``.
"""
