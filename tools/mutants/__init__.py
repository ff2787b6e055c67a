"""Do the tests notice a wrong sign? `make mutants` changes one operator at a time and runs them.

`python -m tools.mutants map` runs the tests once and notes which test runs which line, and at what
cost. `python -m tools.mutants run --count 300` changes random places and runs the tests that cover
each, the cheapest first; what they do not notice survives. `python -m tools.mutants again` tries
what survived in a copy of the source, on all tests of the room, slow ones too. `python -m
tools.mutants survivors` lists it.
"""
