"""Frozen answers, by which a rebuilt part is judged.

`answers/*.json` hold what commands answer to each example, and what `identify` answers to drawn
logs of the benchmarks and to records, beside the truth where one is known:

    python -m tests.reference --compare                 ask each case again, print what moved
    python -m tests.reference --compare --only names    a family, a case, or a pattern of either
    python -m tests.reference --write "the reason"      freeze today's answers

`--compare` prints one line for each field that moved by more than its tolerance
(`compare.TOLERANCES`), as better or worse where a truth is known. Where a verdict moved, the other
fields of its case are counted in one line. The exit code is 1 if anything moved. A change that is
meant is frozen by `--write`, and the file keeps its reason with date and commit. `--json` prints
one object. `--jobs` is the number of processes.

A family is a file of answers. Its cases are rows of `examples.py` (commands), `benches.py` (drawn
logs) or `records.py` (`../shared/records`, skipped where they are not there). A case that fails is
stored with its error and compared as well. `fields.SKIPPED` and `examples.BRIEF` list what is left
out or cut short, with the reasons.
"""
