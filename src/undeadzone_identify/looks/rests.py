class FreePlay: pass
def free_play_between_rests(*a): return None
