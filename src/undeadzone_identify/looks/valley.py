class Valley: pass
def gap_of_valleys(*a): return None
