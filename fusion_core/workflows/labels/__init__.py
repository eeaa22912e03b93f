"""Labels of people, of a recording:

open_store.py       the label store of a recording, beside it or where it is named
"""
