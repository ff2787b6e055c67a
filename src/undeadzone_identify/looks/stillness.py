class Stillness: pass
def longest_stillness(*a): return None
