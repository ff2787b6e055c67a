"""Direct looks at a log before any dynamics: the map at rest, and the witness of stillness.

A look needs no regular step and no plant. `rows` finds readings at rest, `map` draws them over the
command and finds flat parts with their edges, `stillness` finds the longest rest of a reading.
"""
